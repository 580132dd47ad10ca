"""Worlds that a strategy's model does not know of: does the learner ever do worse than the tuned spiral?"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from runtime.experiment.contenders import contender
from runtime.experiment.palette import looks
from runtime.experiment.score import Row, attempts_ratio, rows_of, seconds_ratio
from runtime.experiment.study import Choices, Findings, Picture, Results, Table, aim, listed
from runtime.experiment.trial import Trial, trials
from runtime.experiment.worlds import WORLDS, world

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

YARDSTICK = "spiral"  # the tuned spiral: about the mean of the hole's seats, without gaps
AIMED_AT = "bayes"
AT_MOST = 1.25  # times the yardstick's attempts
REALISTIC, OFF = "realistic", "off-"


class Robustness:
    """Strategies in worlds that are not as they believe."""

    name = "robustness"
    summary = "worlds that no strategy's model knows of: heavy tails, drift, moved holes, wrong boards"
    defaults = Choices(
        seeds=60,
        boards=10,
        physics=False,
        strategies=(YARDSTICK, "meta", AIMED_AT, "bayes-slide"),
        worlds=(REALISTIC, *(name for name in WORLDS if name.startswith(OFF))),
        components=("igbt",),
    )

    def work(self, chosen: Choices) -> list[Trial]:
        """Every strategy in every world; the yardstick too, chosen or not."""
        return [
            trial
            for name in chosen.worlds
            for component in chosen.components
            for strategy in _strategies(chosen)
            for trial in trials(chosen, world(name), component, contender(strategy))
        ]

    def findings(self, chosen: Choices, results: Results) -> Findings:
        """One table, one figure, and whether the aim holds in each world."""
        rows = rows_of(chosen, results, _strategies(chosen))
        yardsticks = {(row.world, row.component): row for row in rows if row.strategy == YARDSTICK}
        picture = Picture(
            "spiral",
            f"Seconds at the hole in multiples of the tuned spiral's, ± standard error; shaded: more than {AT_MOST:g}",
            lambda figure: _draw(figure, rows, yardsticks, chosen),
            (4.0 + 4.0 * len(chosen.components), 1.8 + 0.42 * len(chosen.worlds)),
        )
        return Findings(
            tables=(_table(rows, yardsticks),), figures=(picture,), verdict=tuple(_verdict(rows, yardsticks))
        )


def _strategies(chosen: Choices) -> tuple[str, ...]:
    """Those chosen, and the yardstick in any case."""
    return tuple(dict.fromkeys((YARDSTICK, *chosen.strategies)))


Yardsticks = dict[tuple[str, str], Row]


def _hopeless(row: Row) -> bool:
    """Whether no hole was within the search radius."""
    return row.score.within == 0


def _table(rows: Sequence[Row], yardsticks: Yardsticks) -> Table:
    return Table(
        "",
        "Attempts for each search, ± standard error over seeds. A search that failed counts with the attempts it used",
        (
            "world",
            "component",
            "strategy",
            "attempts",
            "p95",
            "x spiral",
            "attempts per part inserted",
            "s at the hole",
            "x spiral's s",
            "searches",
            "failed",
            "within R",
            "unsolved within R",
        ),
        tuple(
            (
                row.world,
                row.component,
                row.strategy,
                row.score.attempts,
                row.score.attempts_p95,
                attempts_ratio(row, yardsticks[row.world, row.component]),
                row.score.attempts_per_part,
                row.score.search_time,
                seconds_ratio(row, yardsticks[row.world, row.component]),
                row.score.searches,
                row.score.failed,
                row.score.within,
                row.score.unsolved,
            )
            for row in rows
        ),
    )


def _verdict(rows: Sequence[Row], yardsticks: Yardsticks) -> Iterator[str]:
    for row in rows:
        if not row.strategy.startswith(AIMED_AT) or _hopeless(row):
            continue
        spiral = yardsticks[row.world, row.component]
        if row.strategy == AIMED_AT:
            ratio, what = attempts_ratio(row, spiral), "attempts"
        else:  # a slide tries many places at once; its seconds compare, its attempts do not
            ratio, what = seconds_ratio(row, spiral), "seconds at the hole"
        told = f"{row.world}, {row.component}: {what} of {row.strategy} in multiples of the spiral's"
        yield (
            f"{aim(told, ratio, AT_MOST)} Left unsolved within R: {row.score.unsolved} of {row.score.within}, "
            f"by the spiral {spiral.score.unsolved}."
        )
    for place, yardstick in yardsticks.items():
        if _hopeless(yardstick):
            there = [row for row in rows if (row.world, row.component) == place]
            told = listed(
                f"{row.strategy} {row.score.attempts} attempts and {row.score.search_time} s" for row in there
            )
            lucky = listed(
                f"{row.strategy} {row.score.searches - row.score.failed}" for row in there if row.score.success_rate
            )
            found = f"of {yardstick.score.searches} parts were inserted: {lucky}" if lucky else "nobody inserts a part"
            yield f"{', '.join(place)}: no hole is within R, and {found}. Before a search ends, each spends {told}."


def _draw(figure: Canvas, rows: Sequence[Row], yardsticks: Yardsticks, chosen: Choices) -> None:
    look = looks(chosen.strategies)
    shown = [name for name in chosen.strategies if name != YARDSTICK]
    grid = figure.subplots(1, len(chosen.components), squeeze=False, sharey=True)[0]
    for axes, component in zip(grid, chosen.components, strict=True):
        for index, strategy in enumerate(shown):
            there = [row for row in rows if (row.strategy, row.component) == (strategy, component)]
            ratios = [seconds_ratio(row, yardsticks[row.world, row.component]) for row in there]
            lines = [chosen.worlds.index(row.world) + 0.2 * (index - (len(shown) - 1) / 2) for row in there]
            axes.errorbar(
                [ratio.value for ratio in ratios],
                lines,
                xerr=[[0.0 if math.isnan(ratio.error) else ratio.error for ratio in ratios]],
                fmt=look[strategy].marker,
                color=look[strategy].colour,
                label=strategy,
                capsize=2,
            )
        axes.axvline(1.0, color="black", linewidth=1)
        right = axes.get_xlim()[1]
        axes.axvspan(AT_MOST, max(right, 1.4), color="black", alpha=0.06, linewidth=0)
        axes.set_xlim(0.0, max(right, 1.4))
        axes.set_yticks(range(len(chosen.worlds)), chosen.worlds)
        axes.set(xlabel="seconds at the hole / those of the tuned spiral", title=component)
    grid[0].invert_yaxis()
    handles, labels = grid[0].get_legend_handles_labels()
    if handles:
        figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))


STUDY = Robustness()
