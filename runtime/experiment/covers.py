"""The paper's Fig. 12: the covers that meta search tries, with and without the term that keeps them apart."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from runtime.assembly import goal_for
from runtime.cell import SearchLimits, Tolerances
from runtime.config import Cell
from runtime.experiment.contenders import Contender
from runtime.experiment.matched import REPULSION
from runtime.experiment.palette import COLOURS
from runtime.experiment.study import Assumption, Choices, Findings, Picture, Results, Table, Work
from runtime.experiment.worlds import GRID
from runtime.messages import Belief, Gaussian, header

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

Array = NDArray[np.float64]

COUNT = 12
COMPONENT = "capacitor"  # whose feasible area is a disc, as covers are
BELIEF = Gaussian(0.0, 0.0, (0.6e-3) ** 2, 0.5 * 0.6e-3 * 0.35e-3, (0.35e-3) ** 2)
STEPS = 2000  # of ascent: to rest, where there is any
REACH = 2.5e-3  # [m] beyond which no cover may lie
GRID_STEP = 4e-6  # [m] of the quadrature of the union's mass
GATHERED = 0.1  # [feasible radii] covers nearer than this to each other have collapsed


@dataclass(frozen=True)
class Rule:
    """One way to keep covers apart, or not."""

    key: str
    name: str
    settings: dict[str, Any]


WITHOUT = Rule("none", "without repulsion", {"repulsion": "0 m^-2"})
WITH = Rule("pairs", f"corrected (pairs), lambda {1e-6 * REPULSION:g} per mm²", {"repulsion": f"{REPULSION:g} m^-2"})
_EQ_45: dict[str, Any] = {"variant": "literal"}
_EQ_46: dict[str, Any] = {"variant": "literal", "repel": "centre"}
RULES = (
    WITHOUT,
    Rule("eq45-weak", "Eq. 45 as printed, lambda 0.01 per mm²", {**_EQ_45, "repulsion": "1e4 m^-2"}),
    Rule("eq45-strong", "Eq. 45 as printed, lambda 0.1 per mm²", {**_EQ_45, "repulsion": "1e5 m^-2"}),
    Rule("eq46-weak", "Eq. 46 as printed, lambda 0.01 per mm²", {**_EQ_46, "repulsion": "1e4 m^-2"}),
    Rule("eq46-strong", "Eq. 46 as printed, lambda 1 per mm²", {**_EQ_46, "repulsion": "1e6 m^-2"}),
    Rule("hinge", "Eq. 45, sign mended (hinge), lambda 1 per mm²", {"repel": "hinge", "repulsion": "1e6 m^-2"}),
    WITH,
)


@dataclass(frozen=True)
class Layout:
    """Where the covers came to lie."""

    rule: Rule
    centres: Array  # (n, 2) [m]
    radius: float  # [m]
    masses: Array  # (n,) of each disc

    @property
    def nearest(self) -> float:
        """Smallest distance [m] between two covers."""
        return float(self._distances().min())

    @property
    def farthest(self) -> float:
        """Distance [m] of the farthest cover from the mean."""
        return float(np.hypot(*self.centres.T).max())

    @property
    def different(self) -> int:
        """Covers that are left when those that have collapsed into one count once."""
        left: list[Array] = []
        for centre in self.centres:
            if all(np.hypot(*(centre - other)) > GATHERED * self.radius for other in left):
                left.append(centre)
        return len(left)

    @property
    def union(self) -> float:
        """Probability that the hole lies in any of the covers, by the midpoint rule."""
        low, high = self.centres.min(axis=0) - self.radius, self.centres.max(axis=0) + self.radius
        x, y = (np.arange(a + GRID_STEP / 2, b, GRID_STEP) for a, b in zip(low, high, strict=True))
        covered = np.zeros((len(y), len(x)), dtype=bool)
        for cx, cy in self.centres:
            covered |= (x - cx) ** 2 + (y[:, None] - cy) ** 2 <= self.radius**2
        return float(density(x, y)[covered].sum() * GRID_STEP**2)

    def _distances(self) -> Array:
        first, second = np.triu_indices(len(self.centres), 1)
        return np.asarray(np.hypot(*(self.centres[first] - self.centres[second]).T))


def density(x: Array, y: Array) -> Array:
    """The belief's density [1/m^2] at all (y, x), shape (len(y), len(x))."""
    covariance = np.array([[BELIEF.xx, BELIEF.xy], [BELIEF.xy, BELIEF.yy]])
    inverse = np.linalg.inv(covariance)
    squared = inverse[0, 0] * x**2 + 2 * inverse[0, 1] * y[:, None] * x + inverse[1, 1] * y[:, None] ** 2
    return np.asarray(np.exp(-squared / 2) / (2 * math.pi * math.sqrt(np.linalg.det(covariance))))


def layout(rule: Rule) -> Layout:
    """What meta search proposes first for a hole of which this much is believed."""
    settings = {"start": "posterior", "covers": COUNT, "steps": STEPS, **rule.settings}
    strategy = Contender(rule.key, "meta", settings).make()
    cell = Cell(board=GRID, component=COMPONENT, boards=1, seed=0, search=SearchLimits(REACH), tolerances=Tolerances())
    belief = Belief(header(0), GRID.type, GRID.holes[0].name, 0, BELIEF, [], [])
    goal = goal_for(cell, GRID.holes[0], belief, board=1, search=1, now=0)
    proposals = list(islice(strategy.search(goal), COUNT))
    return Layout(
        rule,
        np.array([(proposal.x, proposal.y) for proposal in proposals]),
        goal.feasible_radius,
        np.array([proposal.probability for proposal in proposals]),
    )


class Covers:
    """Where covers come to lie under each rule. Nothing in it is random."""

    name = "covers"
    summary = "the paper's Fig. 12: covers collapse without repulsion; what each rule for it does"
    defaults = Choices()

    def work(self, chosen: Choices) -> Sequence[Work[Any]]:  # noqa: ARG002 - there is nothing to choose
        """None: a few seconds of arithmetic."""
        return ()

    def findings(self, chosen: Choices, results: Results) -> Findings:  # noqa: ARG002
        """Distances and masses, and pictures like the paper's."""
        layouts = {rule.key: layout(rule) for rule in RULES}
        pair = [layouts[WITHOUT.key], layouts[WITH.key]]
        rest = [one for key, one in layouts.items() if key != WITHOUT.key]
        return Findings(
            tables=(_table(list(layouts.values())),),
            figures=(
                Picture(
                    "fig12",
                    f"{COUNT} covers of the feasible radius on the contours (1, 2, 3 sigma) of what is believed: left "
                    "without repulsion, all in one place; right with the corrected one",
                    lambda figure: _draw(figure, pair, 1, 1.9e-3),
                    (9.0, 4.6),
                ),
                Picture(
                    "rules",
                    f"The same with every rule, {1e3 * REACH:g} mm about nominal (dotted) as the farthest a cover "
                    "may go",
                    lambda figure: _draw(figure, rest, 2, 2.9e-3),
                    (11.0, 7.6),
                ),
            ),
            verdict=tuple(_verdict(layouts)),
            assumptions=(
                Assumption(
                    "what is believed",
                    "a normal of 0.6 x 0.35 mm, correlation 0.5",
                    "chosen: Fig. 12 has no scale and is not in the paper's source",
                ),
                Assumption("number of covers", str(COUNT), "chosen: not stated"),
                Assumption("radius of a cover", f"{1e3 * pair[0].radius:g} mm", "the capacitor's feasible area"),
                Assumption("ascent", f"{STEPS} steps, each as long as is stable", "chosen: not stated"),
                Assumption("unit in which Eq. 45 takes a length from an area", "1 mm", "chosen: not stated"),
            ),
        )


def _table(layouts: Sequence[Layout]) -> Table:
    return Table(
        "",
        f"{COUNT} covers on one normal distribution. F of Eq. 47 is the sum; what the search gains is the union",
        (
            "rule",
            "smallest distance, mm",
            "farthest from the mean, mm",
            "different covers",
            "sum of masses",
            "mass of their union",
        ),
        tuple(
            (
                one.rule.name,
                round(1e3 * one.nearest, 6),
                round(1e3 * one.farthest, 6),
                one.different,
                float(one.masses.sum()),
                one.union,
            )
            for one in layouts
        ),
    )


def _verdict(layouts: Mapping[str, Layout]) -> Iterator[str]:
    without, repelled = layouts[WITHOUT.key], layouts[WITH.key]
    collapsed = without.different == 1
    yield (
        f"{'Reproduced' if collapsed else 'Not reproduced'}: without repulsion the covers collapse, to "
        f"{without.different} different of {COUNT}; their masses add up to {without.masses.sum():.2f}, of which they "
        f"hold {without.union:.2f}. Eq. 47 rewards that: it counts overlaps as often as there are covers."
    )
    yield (
        f"Reproduced with a corrected rule: {repelled.rule.name} leaves {repelled.different} different covers, which "
        f"hold {repelled.union:.2f}."
    )
    printed = [one for key, one in layouts.items() if key.startswith("eq4")]
    best = max(printed, key=lambda one: one.union)
    useful = best.union > 1.5 * without.union
    yield (
        f"{'Reproduced' if useful else 'Not reproduced'}: that Eqs. 45-46 as printed do so. "
        + "; ".join(f"{one.rule.name}: {one.different} different, union {one.union:.2f}" for one in printed)
        + ". With a small lambda covers gather, with a large one they flee as far as they may."
    )
    yield (
        "Cannot be decided: with what lambda, unit, number of covers and steps of ascent the paper drew its figure; it "
        "states none of them."
    )


def _draw(figure: Canvas, layouts: Sequence[Layout], rows: int, half: float) -> None:
    from matplotlib.patches import Circle

    columns = math.ceil(len(layouts) / rows)
    grid: Any = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    axis = np.linspace(-half, half, 301)
    peak = float(density(np.zeros(1), np.zeros(1))[0, 0])
    levels = [peak * math.exp(-(sigma**2) / 2) for sigma in (3, 2, 1)]
    for axes in grid.ravel()[len(layouts) :]:
        axes.set_axis_off()
    for axes, one in zip(grid.ravel(), layouts, strict=False):
        axes.contour(1e3 * axis, 1e3 * axis, density(axis, axis), levels=levels, colors="#7F7F7F", linewidths=1)
        for centre in one.centres:
            place = 1e3 * centre
            axes.add_patch(Circle(place, 1e3 * one.radius, facecolor=COLOURS[5], edgecolor=COLOURS[0], alpha=0.35))
        axes.plot(*(1e3 * one.centres.T), ".", color=COLOURS[1], markersize=5)
        if half > REACH:
            axes.add_patch(Circle((0, 0), 1e3 * REACH, fill=False, edgecolor="black", linestyle=":"))
        title = f"{one.rule.name}\n{one.different} different; union {one.union:.2f}, sum"
        axes.set_title(f"{title} {one.masses.sum():.2f}", fontsize=9)
        axes.set(aspect="equal", xlim=(-1e3 * half, 1e3 * half), ylim=(-1e3 * half, 1e3 * half))
        axes.grid(visible=False)
        axes.label_outer()
    figure.supxlabel("x [mm]", fontsize=10)
    figure.supylabel("y [mm]", fontsize=10)


STUDY = Covers()
