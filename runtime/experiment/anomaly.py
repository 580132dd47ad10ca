"""The paper's Fig. 11: how the four methods fare at the hole whose parts scatter more."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from runtime.experiment.assumptions import assumptions
from runtime.experiment.estimates import Estimate, mean_over_seeds
from runtime.experiment.matched import MATCHED, Matched
from runtime.experiment.palette import looks
from runtime.experiment.paper import ABNORMAL_HOLE, BOARDS, METHODS
from runtime.experiment.study import Choices, Findings, Picture, Results, Table, listed
from runtime.experiment.tables import Row, rows_of, trials_of
from runtime.experiment.trial import Trial
from runtime.plugin import SearchRecord

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

FLAT = 0.1  # share of its time by which the line may change and be called flat
PLACES = (f"hole {ABNORMAL_HOLE}", "others")


@dataclass(frozen=True)
class Curve:
    """One method at the abnormal hole, or at the others: seconds for each component, and how many went in."""

    component: str
    method: str
    place: str
    row: Row
    clock: Callable[[int], float]  # from attempts to the time of a part [s]

    @property
    def boards(self) -> range:
        """Numbers of the boards."""
        return range(1, self.row.times.shape[1] + 1)

    def times_by_seed(self) -> list[list[float]]:
        """Time of each part [s], seed by seed."""
        return [[self.clock(search.attempts) for search in seed] for seed in self._searches(())]

    def time(self, *boards: int) -> Estimate:
        """Time for each part [s], on these boards; on all if none is named."""
        return mean_over_seeds([[self.clock(search.attempts) for search in seed] for seed in self._searches(boards)])

    def share(self, *boards: int) -> Estimate:
        """Share of the components that were inserted."""
        return mean_over_seeds([[float(search.seated) for search in seed] for seed in self._searches(boards)])

    def attempts(self) -> Estimate:
        """Attempts for each search."""
        return mean_over_seeds([[float(search.attempts) for search in seed] for seed in self._searches(())])

    def _searches(self, boards: Sequence[int]) -> list[list[SearchRecord]]:
        abnormal = self.place == PLACES[0]
        return [
            [
                search
                for search in seed
                if (search.hole == str(ABNORMAL_HOLE)) == abnormal and (not boards or search.board in boards)
            ]
            for seed in self.row.records
        ]


class Anomaly:
    """Hole 7 against the others, board by board."""

    name = "anomaly"
    summary = "the paper's Fig. 11: hole 7, whose parts scatter more, against the others"
    defaults = Choices(seeds=100, boards=BOARDS, physics=False, components=("igbt",))

    def work(self, chosen: Choices) -> Sequence[Trial]:
        """The same trials as those of the tables."""
        return [trial for component in chosen.components for trial in trials_of(MATCHED[component], chosen)]

    def findings(self, chosen: Choices, results: Results) -> Findings:
        """By method and by board."""
        curves = [curve for name in chosen.components for curve in _curves(MATCHED[name], chosen, results)]
        picture = Picture(
            "holes",
            f"Seconds for each component and share inserted, at hole {ABNORMAL_HOLE} (solid) and at the others "
            f"(dashed); bands: standard error over {chosen.seeds} seeds",
            lambda figure: _draw(figure, curves, chosen.components),
            (11.0, 1.2 + 4.4 * len(chosen.components)),
        )
        tables = {matched.component: number for number, matched in enumerate(MATCHED.values(), 1)}
        return Findings(
            tables=(_summary(curves), _boards(curves)),
            figures=(picture,),
            verdict=tuple(sentence for name in chosen.components for sentence in _verdict(curves, name)),
            assumptions=tuple(item for name in chosen.components for item in assumptions(MATCHED[name], tables[name])),
        )


def _curves(matched: Matched, chosen: Choices, results: Results) -> Iterator[Curve]:
    for row in rows_of(matched, chosen, results):
        seconds = matched.clock.per_attempt(row.method)

        def clock(attempts: int, seconds: float = seconds) -> float:
            return matched.clock.part + seconds * attempts

        for place in PLACES:
            yield Curve(matched.component, row.method, place, row, clock)


def _summary(curves: Sequence[Curve]) -> Table:
    return Table(
        "",
        f"Hole {ABNORMAL_HOLE} and the others, ± standard error over seeds; failures count with the time they took",
        ("component", "method", "where", "s for each part", "first board", "last board", "attempts", "share inserted"),
        tuple(
            (
                curve.component,
                curve.method,
                curve.place,
                curve.time(),
                curve.time(curve.boards[0]),
                curve.time(curve.boards[-1]),
                curve.attempts(),
                curve.share(),
            )
            for curve in curves
        ),
    )


def _boards(curves: Sequence[Curve]) -> Table:
    return Table(
        "boards",
        "The same board by board",
        ("component", "method", "where", "board", "time_s", "inserted"),
        tuple(
            (curve.component, curve.method, curve.place, board, curve.time(board), curve.share(board))
            for curve in curves
            for board in curve.boards
        ),
        shown=False,
    )


def _verdict(curves: Sequence[Curve], component: str) -> Iterator[str]:
    there = [curve for curve in curves if curve.component == component]
    abnormal = {curve.method: curve for curve in there if curve.place == PLACES[0]}
    others = {curve.method: curve for curve in there if curve.place == PLACES[1]}
    boards = abnormal["meta"].boards
    yield f"{component}. {_harder(abnormal, others)}"
    fastest = min(abnormal.values(), key=lambda curve: curve.time(boards[-1]).value)
    yield (
        f"{component}. {'Reproduced' if fastest.method == 'meta' else 'Not reproduced'}: meta is the fastest there; on "
        f"the last board {listed(f'{name} {curve.time(boards[-1])}' for name, curve in abnormal.items())} s."
    )
    if len(boards) > 1:
        half = len(boards) // 2
        early, late = (abnormal["linear"].time(*part) for part in (boards[:half], boards[half:]))
        flat, share = abs(late.value - early.value) <= FLAT * early.value, abnormal["linear"].share()
        yield (
            f"{component}. {'Reproduced' if flat else 'Not reproduced'}: line search stays slow there, {early} s on "
            f"the first half of the boards, {late} s on the second; it inserts {share.value:.0%} of those parts and "
            "gives up the others."
        )
    if len(boards) > 1:
        spiral = abnormal["spiral"]
        ours, theirs = spiral.time(boards[0]), spiral.time(boards[-1])
        faster = ours.value - theirs.value > 2 * np.hypot(np.nan_to_num(ours.error), np.nan_to_num(theirs.error))
        yield (
            f"{component}. {'Reproduced' if faster else 'Not reproduced'}: the spiral gets faster there too, {ours} to "
            f"{theirs} s; it inserts {spiral.share().value:.0%} of those parts."
        )
    yield (
        f"{component}. Cannot be decided: how far this agrees with Fig. 11, which the paper's source does not contain "
        "and its text does not quote; how much more that hole's parts scatter; how many of them were inserted."
    )


def _harder(abnormal: Mapping[str, Curve], others: Mapping[str, Curve]) -> str:
    """For whom the abnormal hole takes longer, by pairs of seeds."""
    words: dict[str, list[str]] = {"longer": [], "no longer": []}
    for name, curve in abnormal.items():
        pairs = zip(curve.times_by_seed(), others[name].times_by_seed(), strict=True)
        by = mean_over_seeds([[float(np.mean(here) - np.mean(there))] for here, there in pairs])
        words["longer" if by.value > 2 * by.error else "no longer"].append(f"{name} by {by} s")
    told = "; ".join(f"{how} for {listed(names)}" for how, names in words.items() if names)
    return (
        f"Hole {ABNORMAL_HOLE} takes {told}. A pattern with gaps misses some holes on every board, and parts that "
        "scatter come within it at times; only where nearly all is found does scatter cost attempts. The paper says "
        "that the hole is abnormal, not that it takes longer."
    )


def _draw(figure: Canvas, curves: Sequence[Curve], components: Sequence[str]) -> None:
    look = looks(METHODS)
    grid: Any = figure.subplots(
        2 * len(components),
        len(METHODS),
        sharex=True,
        sharey="row",
        squeeze=False,
        height_ratios=(2.0, 1.0) * len(components),
    )
    for line, component in enumerate(components):
        for column, method in enumerate(METHODS):
            times, shares = grid[2 * line][column], grid[2 * line + 1][column]
            for curve in curves:
                if (curve.component, curve.method) != (component, method):
                    continue
                solid = curve.place == PLACES[0]
                style: dict[str, Any] = {
                    "color": look[method].colour if solid else "#555555",
                    "linestyle": "-" if solid else "--",
                    "marker": "o" if solid else "s",
                    "markersize": 4,
                }
                _band(times, curve.boards, [curve.time(board) for board in curve.boards], 1.0, style)
                _band(shares, curve.boards, [curve.share(board) for board in curve.boards], 100.0, style)
            times.set_title(f"{method}, {component}", fontsize=10)
            times.set_ylim(0, None)
            shares.set_ylim(0, 104)
            shares.xaxis.get_major_locator().set_params(integer=True)
        grid[2 * line][0].set_ylabel("s for each component")
        grid[2 * line + 1][0].set_ylabel("inserted [%]")
    for axes in grid[-1]:
        axes.set_xlabel("board")
    from matplotlib.lines import Line2D

    black: dict[str, Any] = {"color": "black", "markersize": 4}
    keys = [
        Line2D([], [], linestyle="-", marker="o", label=PLACES[0], **black),
        Line2D([], [], linestyle="--", marker="s", label=PLACES[1], **black),
    ]
    figure.legend(handles=keys, loc="outside lower center", ncols=2)


def _band(axes: Any, boards: range, estimates: Sequence[Estimate], scale: float, style: dict[str, Any]) -> None:
    mean = scale * np.array([estimate.value for estimate in estimates])
    error = scale * np.nan_to_num([estimate.error for estimate in estimates])
    axes.plot(boards, mean, **style)
    axes.fill_between(boards, mean - error, mean + error, color=style["color"], alpha=0.2, linewidth=0)


STUDY = Anomaly()
