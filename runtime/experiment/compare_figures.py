"""Figures of `compare`: a panel for each world and component, the strategies in the same colours in all."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from runtime.experiment.palette import Look, looks
from runtime.experiment.score import GIVES_UP, by_board, solved_within
from runtime.experiment.study import Choices, Picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

    from runtime.experiment.compare import Compared

Panel = Callable[[Any, "Sequence[Compared]", dict[str, Look]], None]
COUNTS = (1, 2, 3, 4, 5, 6, 8, 10, 13, 16, 20, 25, 32, 40, 50, 64, 80, 100, 128, 160, 200, 256, 320, 400)


def pictures(rows: Sequence[Compared], chosen: Choices) -> tuple[Picture, ...]:
    """Learning curves, distance from the limit, and how many searches are solved how soon."""

    def picture(key: str, caption: str, panel: Panel, *, legend: bool = True) -> Picture:
        wide, high = len(chosen.worlds), len(chosen.components)
        size = (max(7.0, 1.0 + 3.6 * wide), 1.2 + 3.0 * high)
        return Picture(key, caption, lambda figure: _panels(figure, rows, chosen, panel, legend), size)

    return (
        picture("learning", "Attempts for each search by board; bands: standard error over seeds", _learning),
        picture(
            "limit",
            "Attempts in multiples of the estimated limit, and the share of parts inserted; hatched: below 95 %, "
            "few attempts because it gives up",
            _limit,
            legend=False,
        ),
        picture("solved", "Share of the searches that were solved within so many attempts", _solved),
    )


def _panels(figure: Canvas, rows: Sequence[Compared], chosen: Choices, panel: Panel, legend: bool) -> None:
    worlds, components = chosen.worlds, chosen.components
    look = looks(chosen.strategies)
    grid = figure.subplots(len(components), len(worlds), squeeze=False, sharex=True, sharey=True)
    for line, component in enumerate(components):
        for column, name in enumerate(worlds):
            axes = grid[line][column]
            axes.set_title(f"{name}, {component}", fontsize=10)
            panel(axes, [row for row in rows if (row.world, row.component) == (name, component)], look)
            axes.label_outer()
    if legend:
        handles, labels = grid[0][0].get_legend_handles_labels()
        columns = min(len(labels), 4 if len(worlds) == 1 else 6)
        figure.legend(handles, labels, loc="outside lower center", ncols=columns)


def _learning(axes: Any, rows: Sequence[Compared], look: dict[str, Look]) -> None:
    for row in rows:
        curve, one = by_board(row.records), look[row.strategy]
        boards, means = list(curve), [estimate.value for estimate in curve.values()]
        axes.plot(boards, means, color=one.colour, marker=one.marker, linestyle=one.dashes, ms=4, label=row.strategy)
        errors = [0.0 if math.isnan(estimate.error) else estimate.error for estimate in curve.values()]
        low, high = zip(*((mean - error, mean + error) for mean, error in zip(means, errors, strict=True)), strict=True)
        axes.fill_between(boards, low, high, color=one.colour, alpha=0.2, linewidth=0)
    limit = [sum(board) / len(board) for board in rows[0].limits.estimates]
    axes.plot(range(1, 1 + len(limit)), limit, color="black", linewidth=1, label="estimated limit")
    axes.set(xlabel="board", ylabel="attempts for each search", yscale="log")
    _plain(axes.yaxis)
    axes.xaxis.get_major_locator().set_params(integer=True)


def _limit(axes: Any, rows: Sequence[Compared], look: dict[str, Look]) -> None:
    for index, row in enumerate(rows):
        if math.isnan(row.limits.estimate):
            continue
        ratio, error = row.score.attempts.value / row.limits.estimate, row.score.attempts.error / row.limits.estimate
        reach = 0.0 if math.isnan(error) else error
        hatch = "///" if row.score.success_rate < GIVES_UP else ""
        axes.barh(index, ratio, xerr=reach, color=look[row.strategy].colour, height=0.7, hatch=hatch, edgecolor="white")
        label = f"{ratio:.2f}   {row.score.success_rate:.1%}"
        axes.annotate(label, (ratio + reach, index), (4, 0), textcoords="offset points", va="center", fontsize=8)
    axes.axvline(1.0, color="black", linewidth=1)
    axes.set_yticks(range(len(rows)), [row.strategy for row in rows])
    axes.set(xlabel="attempts / estimated limit")
    axes.margins(x=0.4)
    axes.grid(visible=False, axis="y")
    if not axes.yaxis_inverted():
        axes.invert_yaxis()


def _solved(axes: Any, rows: Sequence[Compared], look: dict[str, Look]) -> None:
    most = max(search.attempts for row in rows for seed in row.records for search in seed)
    counts = [count for count in COUNTS if count <= most] or [1]
    for row in rows:
        one = look[row.strategy]
        share = [100 * part for part in solved_within(row.records, counts)]
        axes.plot(counts, share, color=one.colour, linestyle=one.dashes, label=row.strategy)
    axes.set(xlabel="attempts", ylabel="searches solved [%]", xscale="log", ylim=(0, 101))
    _plain(axes.xaxis)


def _plain(axis: Any) -> None:
    """A logarithmic axis with numbers as people write them."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _place: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())
