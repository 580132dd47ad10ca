"""One contract for every strategy, what patterns cover, and what learning is worth."""

from __future__ import annotations

import dataclasses
import math
import re
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError
from search_world import WORLDS, Line, World, attempt_at, goal_for, run_search

from runtime.belief import disc_mass, gaussian, isotropic
from runtime.errors import InputError
from runtime.messages import Gaussian, Miss, Outcome, Place, Proposal, SearchGoal, Seat, Waypoint
from runtime.plugin import Search, Strategy
from strategies.covers import Force, plan_covers, sweep
from strategies.hybrid import Hybrid
from strategies.linear import Linear
from strategies.meta import Meta
from strategies.patterns import lattice, spiral_by_arc
from strategies.spiral import Spiral

MM = 1e-3
TOLERANCE = 1e-12  # [m]


@dataclass(frozen=True)
class Shaken:
    """A user's strategy: random positions about the believed mean, from the goal's seed."""

    spread: float = 0.4e-3  # [m]

    def search(self, goal: SearchGoal) -> Search:
        draw = np.random.default_rng(goal.seed)
        centre = np.array([goal.prior.x, goal.prior.y]) if goal.prior.known else np.zeros(2)
        for _ in range(400):
            x, y = centre + self.spread * draw.standard_normal(2)
            if math.hypot(x, y) <= max(goal.search_radius, math.hypot(*centre)):
                yield Proposal(float(x), float(y))


PAPERS = {"linear": Linear, "spiral": Spiral, "hybrid": Hybrid, "meta": Meta}


def installed() -> dict[str, type]:
    """Strategies by entry point, or the paper's four if the package is not installed."""
    found = {point.name: point.load() for point in entry_points(group="palpate.strategies")}
    return found or PAPERS


def readme() -> type:
    """The strategy that the README shows."""
    text = (Path(__file__).parent.parent / "README.md").read_text(encoding="utf-8")
    shown = re.search(r"```python\n(# my_package/rings\.py\n.*?)```", text, re.DOTALL)
    assert shown is not None
    module = ModuleType("rings")
    sys.modules["rings"] = module
    exec(shown[1], module.__dict__)
    rings: type = module.__dict__["Rings"]
    return rings


ALL: dict[str, Callable[[], Strategy]] = {**installed(), "shaken": Shaken, "readme": readme()}
VARIANTS: dict[str, Callable[[], Strategy]] = {
    "linear-literal": lambda: Linear(variant="literal", start="pooled"),
    "spiral-literal": lambda: Spiral(variant="literal", start="posterior"),
    "hybrid-literal": lambda: Hybrid(variant="literal"),
    "hybrid-algorithm": lambda: Hybrid(description="algorithm", start="nominal"),
    "hybrid-equations": lambda: Hybrid(description="equations"),
    "hybrid-equations-literal": lambda: Hybrid(description="equations", variant="literal"),
    "meta-literal": lambda: Meta(variant="literal"),
    "meta-centre": lambda: Meta(variant="literal", repel="centre", update="mle"),
    "meta-hinge": lambda: Meta(repel="hinge", steps=40),
    "meta-mle": lambda: Meta(update="mle", start="pooled"),
    "meta-posterior": lambda: Meta(start="posterior"),
}
ENDLESS = {"hybrid-algorithm-literal": lambda: Hybrid(description="algorithm", variant="literal")}
EVERY = {**ALL, **VARIANTS, **ENDLESS}
every_strategy = pytest.mark.parametrize("make", EVERY.values(), ids=EVERY)
finders = pytest.mark.parametrize(
    "make", [m for n, m in ALL.items() if n != "linear"], ids=[n for n in ALL if n != "linear"]
)


def seat(hole: str, x: float, y: float, board: int = 1) -> Seat:
    return Seat("old", board, hole, x, y, x + 2e-5, y - 1e-5)


def proposals(strategy: Strategy, goal: SearchGoal, limit: int | None = None) -> list[Proposal]:
    """What a search proposes while nothing is found."""
    return list(steps(strategy, goal, limit))


def steps(strategy: Strategy, goal: SearchGoal, limit: int | None = None) -> Iterator[Proposal]:
    search = strategy.search(goal)
    try:
        proposal = next(search)
        for number in range(1, (limit or goal.max_attempts) + 1):
            yield proposal
            proposal = search.send(attempt_at(goal, number, proposal.x, proposal.y, Outcome.BLOCKED))
    except StopIteration:
        return
    finally:
        search.close()


def same(one: list[Proposal], other: list[Proposal]) -> bool:
    return repr(one) == repr(other)  # not-a-numbers included


offsets = st.floats(-1.0, 1.0).map(lambda value: value * MM)
goals = st.builds(
    goal_for,
    hole=st.sampled_from(["h1", "h2", "h3"]),
    board=st.integers(1, 5),
    feasible_radius=st.floats(0.1, 0.4).map(lambda value: value * MM),
    search_radius=st.floats(0.5, 2.5).map(lambda value: value * MM),
    max_attempts=st.integers(1, 40),
    seed=st.integers(0, 2**63),
    prior=st.one_of(
        st.just(Gaussian()),
        st.builds(lambda x, y, w: isotropic((x, y), w * MM), offsets, offsets, st.floats(0.05, 0.8)),
    ),
    seats=st.lists(st.builds(seat, st.sampled_from(["h1", "h2"]), offsets, offsets, st.integers(1, 4)), max_size=6),
    component=st.sampled_from(["igbt", "capacitor", "unheard of"]),
    misses=st.lists(
        st.builds(
            lambda board, hole, points: Miss(board, hole, [Waypoint(x, y) for x, y in points]),
            st.integers(1, 5),
            st.sampled_from(["h1", "h2", "h3"]),
            st.lists(st.tuples(offsets, offsets), min_size=1, max_size=3),
        ),
        max_size=4,
    ),
    layout=st.sampled_from([[], [Place("h1", 0.3, 0.0), Place("h2", 0.33, 0.0), Place("h3", 0.3, 0.03)]]),
)


@every_strategy
def test_is_a_strategy_with_frozen_settings(make: Callable[[], Strategy]) -> None:
    strategy = make()
    assert isinstance(strategy, Strategy)
    assert type(strategy).__doc__
    for setting in dataclasses.fields(strategy):
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(strategy, setting.name, getattr(strategy, setting.name))


@pytest.mark.parametrize(
    ("cls", "given_as", "expected"),
    [
        (Linear, {"stride": "0.2 mm", "angle": "30 deg"}, Linear(stride=2e-4, angle=math.pi / 6)),
        (Spiral, {"radius": "1 mm", "start": "pooled"}, Spiral(radius=1e-3, start="pooled")),
        (Spiral, {"turns": 4.0, "step": "58 deg"}, Spiral(turns=4.0, step=math.radians(58))),
        (Hybrid, {"description": "algorithm", "cycles": 8}, Hybrid(description="algorithm", cycles=8)),
        (Meta, {"repulsion": "5 mm^-2", "update": "mle"}, Meta(repulsion=5e6, update="mle")),
        (Meta, {"unit": "30 um", "step": "0.5 mm", "steps": 300}, Meta(unit=3e-5, step=5e-4, steps=300)),
    ],
)
def test_settings_are_written_with_units(cls: type, given_as: dict[str, object], expected: Strategy) -> None:
    read = TypeAdapter(cls).validate_python(given_as)
    assert dataclasses.asdict(read) == pytest.approx(dataclasses.asdict(expected))


@pytest.mark.parametrize(
    ("cls", "wrong"),
    [
        (Linear, {"stride": 0.2}),
        (Linear, {"stride": "0 mm"}),
        (Spiral, {"radius": "3 deg"}),
        (Spiral, {"pitch": 0.0}),
        (Spiral, {"turns": 0.0}),
        (Hybrid, {"description": "both"}),
        (Meta, {"covers": 0}),
        (Meta, {"steps": 0}),
        (Meta, {"unit": "0 mm"}),
        (Meta, {"covariance_penalty": 0.0}),
        (Meta, {"repulsion": "-1 mm^-2"}),
        (Meta, {"start": "guess"}),
    ],
)
def test_settings_out_of_range_are_refused(cls: type, wrong: dict[str, object]) -> None:
    with pytest.raises(ValidationError, match=next(iter(wrong))):
        TypeAdapter(cls).validate_python(wrong)


@every_strategy
@settings(max_examples=12, deadline=None)
@given(goal=goals)
def test_is_pure_finite_and_within_bounds(make: Callable[[], Strategy], goal: SearchGoal) -> None:
    first = proposals(make(), goal)
    strategy = make()
    interleaved, other = [], steps(strategy, dataclasses.replace(goal, hole="h3", seed=goal.seed ^ 1))
    for proposal in steps(strategy, goal):
        interleaved.append(proposal)
        next(other, None)
    other.close()  # type: ignore[attr-defined]
    assert same(first, interleaved)
    assert same(first, proposals(strategy, goal))

    assert 1 <= len(first) <= goal.max_attempts
    learnt = [math.hypot(goal.prior.x, goal.prior.y), *(math.hypot(s.seated_x, s.seated_y) for s in goal.seats)]
    learnt += [math.hypot(s.x, s.y) for s in goal.seats]
    bound = goal.search_radius
    if max(learnt) > bound:  # only what was learnt outside may lead outside
        bound = max(learnt) + 2 * goal.feasible_radius
    for proposal in first:
        for point in (proposal, *proposal.path):
            assert math.hypot(point.x, point.y) <= bound + TOLERANCE
        assert math.isnan(proposal.probability) or 0 <= proposal.probability <= 1


@every_strategy
def test_survives_being_closed_at_any_time(make: Callable[[], Strategy]) -> None:
    strategy, goal = make(), goal_for()
    strategy.search(goal).close()
    whole = proposals(strategy, goal)
    for length in (1, 2):
        assert same(proposals(strategy, goal, length), whole[:length])
    search = strategy.search(goal)
    next(search)
    search.close()
    assert list(search) == []
    assert same(proposals(strategy, goal), whole)


@pytest.mark.parametrize("make", [*installed().values(), *VARIANTS.values()])
def test_ends_by_itself(make: Callable[[], Strategy]) -> None:
    goal = goal_for(max_attempts=20_000, feasible_radius=0.25 * MM)
    assert len(proposals(make(), goal)) < goal.max_attempts


@pytest.mark.parametrize("make", [*PAPERS.values(), *VARIANTS.values()])
def test_says_what_it_believes(make: Callable[[], Strategy]) -> None:
    goal = goal_for(feasible_radius=0.25 * MM)
    tried = proposals(make(), goal)
    assert all(0 <= proposal.probability <= 1 and proposal.belief.known for proposal in tried)
    for proposal in tried[:40:7]:
        expected = disc_mass(proposal.belief, (proposal.x, proposal.y), goal.feasible_radius)[0]
        assert proposal.probability == pytest.approx(expected)


@pytest.mark.parametrize("make", [*installed().values()])
@pytest.mark.parametrize("change", [{"feasible_radius": 0.0}, {"feasible_radius": math.nan}, {"search_radius": -1.0}])
def test_a_goal_without_lengths_is_refused(make: Callable[[], Strategy], change: dict[str, float]) -> None:
    with pytest.raises(InputError, match=f"search 1: {next(iter(change))} must be a positive length"):
        next(make().search(goal_for(**change)))


@finders
def test_finds_nearly_all_holes(make: Callable[[], Strategy]) -> None:
    """The cell's own tolerances, for strategies without memory of other boards: at most one part in twenty fails."""
    insertions = [i for seed in range(3) for i in Line(dataclasses.replace(WORLDS["cell"], boards=4), seed).run(make())]
    assert np.mean([insertion.seated for insertion in insertions]) >= 0.95


def test_a_line_finds_what_lies_on_it_and_misses_what_does_not() -> None:
    goal = goal_for()
    assert run_search(Linear(angle=0.0), goal, (1.3 * MM, 0.1 * MM), goal.feasible_radius)[1]
    tried, found = run_search(Linear(angle=0.0), goal, (0.3 * MM, 0.3 * MM), goal.feasible_radius)
    assert not found
    assert len(tried) == 13  # +-6 strides of 0.3 mm within 2 mm


@pytest.mark.parametrize(
    "make",
    [Spiral, Hybrid, Meta, lambda: Hybrid(description="algorithm"), lambda: Meta(update="mle", covers=3, steps=5)],
    ids=["spiral", "hybrid", "meta", "hybrid-algorithm", "meta-mle"],
)
@settings(max_examples=25, deadline=None)
@given(
    feasible=st.floats(0.15, 0.4).map(lambda value: value * MM),
    search=st.floats(0.5, 2.0).map(lambda value: value * MM),
    start=st.tuples(offsets, offsets),
    distance=st.floats(0.0, 1.0),
    angle=st.floats(0.0, 2 * math.pi),
)
def test_whole_search_radius_is_searched(
    make: Callable[[], Strategy],
    feasible: float,
    search: float,
    start: tuple[float, float],
    distance: float,
    angle: float,
) -> None:
    """Wherever the hole is, from wherever the search starts: up to one feasible radius from the rim."""
    goal = goal_for(max_attempts=20_000, feasible_radius=feasible, search_radius=search, seats=[seat("h1", *start)] * 3)
    away = distance * (search - feasible)
    assert run_search(make(), goal, (away * math.cos(angle), away * math.sin(angle)), feasible)[1]


def test_meta_learns_from_board_to_board() -> None:
    runs = [Line(World(boards=6, holes=6), seed).run(Meta()) for seed in range(6)]
    attempts = np.array([[insertion.attempts for insertion in run] for run in runs]).reshape(6, 6, 6)
    first, later = attempts[:, 0].mean(), attempts[:, 3:].mean()
    assert later < 0.7 * first


# Patterns and starts.


@given(st.floats(0.1, 1.0), st.floats(1.5, 6.0))
def test_even_spiral_leaves_no_gap(radius: float, size: float) -> None:
    reach = size * radius
    points = np.array(list(spiral_by_arc(1.5 * radius, 1.2 * radius, reach + radius)))
    draw = np.random.default_rng(1)
    distance, angle = reach * np.sqrt(draw.random(400)), 2 * math.pi * draw.random(400)
    holes = np.stack([distance * np.cos(angle), distance * np.sin(angle)], axis=1)
    assert np.linalg.norm(holes[:, None] - points, axis=2).min(axis=1).max() < radius


def test_spiral_of_constant_angle_leaves_gaps() -> None:
    goal = goal_for(max_attempts=5000)
    literal, even = Spiral(variant="literal", step=math.pi / 3), Spiral()
    hole = (1.7 * MM * math.cos(math.pi / 6), 1.7 * MM * math.sin(math.pi / 6))  # between two rays
    assert not run_search(literal, goal, hole, goal.feasible_radius)[1]
    assert run_search(even, goal, hole, goal.feasible_radius)[1]


@given(st.floats(0.2, 1.0), st.floats(0.5, 3.0))
def test_lattice_is_even_and_sorted(spacing: float, radius: float) -> None:
    points = np.array(lattice(spacing, radius))
    assert points[0] == pytest.approx([0, 0])
    away = np.linalg.norm(points, axis=1)
    assert (np.diff(away) > -1e-5 * spacing).all()
    assert away.max() <= radius
    gaps = np.linalg.norm(points[:, None] - points, axis=2) + 9 * np.eye(len(points))
    if len(points) > 1:
        assert gaps.min() == pytest.approx(spacing)


SEATS = [seat("h1", 0.6 * MM, 0.0), seat("h2", 0.0, 0.4 * MM), seat("h1", 0.2 * MM, 0.0, board=2)]


@pytest.mark.parametrize("make", [Linear, Spiral, Hybrid])
def test_start_says_whose_insertions_count(make: Callable[..., Strategy]) -> None:
    goal = goal_for(seats=SEATS, prior=isotropic((-0.3 * MM, 0.1 * MM), 0.3 * MM))

    def first(**settings: str) -> tuple[float, float]:
        proposal = proposals(make(**settings), goal, 1)[0]
        return proposal.x, proposal.y

    assert first(start="nominal") == (0.0, 0.0)
    assert first(start="hole") == pytest.approx((0.42 * MM, -0.01 * MM))  # seated
    assert first(start="hole", variant="literal") == pytest.approx((0.4 * MM, 0.0))  # candidates
    assert first(start="pooled", variant="literal") == pytest.approx((0.8 / 3 * MM, 0.4 / 3 * MM))
    assert first(start="posterior") == pytest.approx((-0.3 * MM, 0.1 * MM))
    nothing = dataclasses.replace(goal, seats=[], prior=Gaussian())
    for start in ("hole", "pooled", "nominal", "posterior"):
        assert proposals(make(start=start), nothing, 1)[0].x == 0.0


@pytest.mark.parametrize(
    ("base", "change"),
    [
        (Linear(), {"stride": 0.2 * MM}),
        (Linear(), {"angle": 1.0}),
        (Linear(), {"cycles": 3}),
        (Linear(stride=0.5 * MM), {"variant": "literal"}),
        (Spiral(), {"radius": 0.7 * MM}),
        (Spiral(), {"turns": 5.0}),
        (Spiral(), {"pitch": 1.0}),
        (Spiral(), {"arc": 1.0}),
        (Spiral(), {"variant": "literal"}),
        (Spiral(variant="literal"), {"step": 1.0}),
        (Hybrid(), {"description": "algorithm"}),
        (Hybrid(), {"description": "equations"}),
        (Hybrid(description="algorithm"), {"description": "equations"}),
        (Hybrid(variant="literal"), {"description": "algorithm"}),
        (Hybrid(variant="literal"), {"description": "equations"}),
        (Hybrid(description="algorithm", cycles=3, radius=0.5 * MM), {"variant": "literal"}),
        (Hybrid(description="equations"), {"variant": "literal"}),
        (Hybrid(description="equations"), {"step": 1.0}),
        (Hybrid(), {"stride": 0.2 * MM}),
        (Hybrid(), {"angle": 1.0}),
        (Hybrid(), {"cycles": 3}),
        (Hybrid(), {"radius": 0.7 * MM}),
        (Hybrid(), {"pitch": 1.0}),
        (Hybrid(), {"arc": 1.0}),
        (Hybrid(), {"variant": "literal"}),
        (Hybrid(variant="literal"), {"step": 1.0}),
        (Meta(), {"start": "pooled"}),
        (Meta(), {"start": "nominal"}),
        (Meta(), {"start": "posterior"}),
        (Meta(), {"prior_width": 0.3 * MM}),
        (Meta(), {"mean_count": 1.0}),
        (Meta(), {"covariance_count": 9.0}),
        (Meta(variant="literal", start="pooled"), {"mean_penalty": 5.0}),
        (Meta(variant="literal", start="pooled"), {"covariance_penalty": 20.0}),
        (Meta(start="pooled"), {"update": "mle"}),
        (Meta(), {"repel": "hinge"}),
        (Meta(variant="literal"), {"repel": "centre"}),
        (Meta(variant="literal", repulsion=1e5), {"unit": 10 * MM}),
        (Meta(), {"steps": 60}),
        (Meta(), {"step": 0.1 * MM}),
        (Meta(), {"covers": 12}),
        (Meta(), {"repulsion": 1e6}),
        (Meta(), {"variant": "literal"}),
    ],
    ids=lambda value: value if isinstance(value, str) else str(value)[:60],
)
def test_every_setting_matters(base: Strategy, change: dict[str, object]) -> None:
    goal = goal_for(seats=SEATS)
    changed = dataclasses.replace(base, **change)  # type: ignore[type-var]
    assert not same(proposals(base, goal), proposals(changed, goal))


# Meta.


def test_meta_believes_what_the_paper_says() -> None:
    fresh = Meta().belief(goal_for())
    assert fresh == isotropic((0, 0), 0.5 * MM)  # Algorithm 2: N(m0, I) with its unit stated
    goal = goal_for(seats=SEATS)
    literal = Meta(update="mle", start="pooled", variant="literal").belief(goal)
    points = np.array([(s.x, s.y) for s in SEATS])
    assert (literal.x, literal.y) == pytest.approx(tuple(points.mean(axis=0)))
    assert literal.xx == pytest.approx(points[:, 0].var())
    assert Meta(update="mle").belief(goal) == fresh  # two seats of this hole are too few
    assert Meta(start="posterior").belief(goal) == goal.prior
    first = proposals(Meta(prior_width=0.2 * MM), goal_for(), 1)[0]
    assert math.hypot(first.x, first.y) < 0.08 * MM  # the most probable cover, nearly at the mean


@pytest.mark.parametrize("width", [0.15, 0.3, 0.5, 0.8])
def test_covers_keep_apart_and_collapse_without_repulsion(width: float) -> None:
    """The paper's Fig. 12, in numbers."""
    belief, radius = isotropic((0.2 * MM, -0.1 * MM), width * MM), 0.2 * MM

    def closest(repulsion: float, force: Force = "overlap") -> float:
        centres, _ = plan_covers(belief, radius, 12, repulsion, 2 * MM, force)
        gaps = np.linalg.norm(centres[:, None] - centres, axis=2) + np.eye(len(centres))
        return float(gaps.min()) / radius

    assert closest(1e9) > 1.9  # as good as no overlap
    assert closest(2e7) > 0.7  # the default lets them overlap a little: discs that only touch leave gaps
    if width >= 0.3:  # narrower beliefs have no slope where the outer covers begin
        assert closest(0.0) < 0.02
        assert closest(1e6, "eq_45") < 0.02


def test_literal_covers_flee_when_repulsion_is_strong() -> None:
    """Eq. 45 as printed rewards distance without bound: the covers end on the rim of what is allowed."""
    centres, _ = plan_covers(isotropic((0, 0), 0.5 * MM), 0.2 * MM, 12, 1e8, 2 * MM, "eq_45")
    assert (np.linalg.norm(centres, axis=1) > 1.9 * MM).sum() >= 6


@given(st.floats(0.1, 0.8), st.floats(0.1, 0.8), st.floats(-0.9, 0.9), st.floats(0.1, 0.3), st.integers(1, 25))
@settings(max_examples=25, deadline=None)
def test_covers_are_sorted_by_probability(
    wide: float, narrow: float, correlation: float, radius: float, number: int
) -> None:
    cross = correlation * wide * narrow
    belief = gaussian((0.3 * MM, 0), np.array([[wide**2, cross], [cross, narrow**2]]) * MM**2)
    centres, probabilities = plan_covers(belief, radius * MM, number, 2e7, 2 * MM)
    assert centres.shape == (number, 2)
    assert (np.diff(probabilities) <= 0).all()
    assert probabilities == pytest.approx(disc_mass(belief, centres, radius * MM))
    assert (np.linalg.norm(centres, axis=1) <= 2 * MM).all()


@pytest.mark.parametrize(
    ("wide", "narrow", "share"),
    [(0.4, 0.4, 1.1), (0.8, 0.15, 0.75)],  # of the spiral's attempts: a round belief gives no edge, a slender one does
)
def test_covers_follow_the_shape_of_the_belief(wide: float, narrow: float, share: float) -> None:
    turn = np.array([[1, -1], [1, 1]]) / math.sqrt(2)
    belief = gaussian((0, 0), turn @ np.diag([wide**2, narrow**2]) @ turn.T * MM**2)
    goal = goal_for(max_attempts=2000, prior=belief, search_radius=2.5 * MM)
    draw = np.random.default_rng(5)
    holes = draw.standard_normal((400, 2)) * (wide * MM, narrow * MM) @ turn.T

    def mean_attempts(strategy: Strategy) -> float:
        tried = np.array([(p.x, p.y) for p in proposals(strategy, goal)])
        hits = np.linalg.norm(holes[:, None] - tried, axis=2) < goal.feasible_radius
        return float(np.where(hits.any(axis=1), hits.argmax(axis=1) + 1, len(tried)).mean())

    assert mean_attempts(Meta(start="posterior")) < share * mean_attempts(Spiral(start="posterior"))


def test_sweep_covers_what_the_covers_left_and_repeats_nothing() -> None:
    covers = [(0.1 * MM * i, 0.0) for i in range(10)]
    radius, reach = 0.25 * MM, 1.5 * MM
    points = list(sweep((0.2 * MM, 0.0), covers, radius, reach))
    draw = np.random.default_rng(2)
    distance, angle = (reach - radius) * np.sqrt(draw.random(2000)), 2 * math.pi * draw.random(2000)
    holes = np.stack([distance * np.cos(angle), distance * np.sin(angle)], axis=1)
    everything = np.array(covers + points)
    assert (np.linalg.norm(holes[:, None] - everything, axis=2).min(axis=1) < radius / 2).all()
    assert len(set(points)) == len(points) <= 2 * (1.7 / 0.25) ** 2 + 2 * (1.7 / 0.125) ** 2
    assert (np.linalg.norm(points, axis=1) <= reach).all()
    near = [math.hypot(x - 0.2 * MM, y) for x, y in points]
    assert np.mean(near[:20]) < np.mean(near[20:40]) < np.mean(near[-20:])


def test_a_mean_learnt_outside_leads_the_search_there() -> None:
    away = [seat("h1", 2.6 * MM, 0.0, board=board) for board in range(1, 5)]
    for strategy in (Linear(), Spiral(), Meta()):
        tried = proposals(strategy, goal_for(seats=away))
        assert math.hypot(tried[0].x - 2.6 * MM, tried[0].y) < 0.2 * MM
        assert max(math.hypot(p.x, p.y) for p in tried) <= 2.62 * MM + 2 * 0.2 * MM + TOLERANCE
