"""The paper's Tables 1 and 2: four methods, ten boards of nine holes, in the matched world and on the matched clock."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from runtime.experiment.assumptions import assumptions
from runtime.experiment.estimates import Estimate, mean_over_seeds, ratio_over_seeds
from runtime.experiment.matched import CAPACITOR, IGBT, Matched
from runtime.experiment.palette import looks
from runtime.experiment.paper import BOARDS, HOLES, METHODS, TABLE_1, TABLE_2, CycleTimes
from runtime.experiment.score import GIVES_UP, Records, attempts
from runtime.experiment.study import Choices, Findings, Picture, Results, Table, Value, listed
from runtime.experiment.trial import Trial, trials

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

Array = NDArray[np.float64]

SETTLED = 4  # the first board of those whose scatter is compared: before, all methods but the line still learn
FLAT = 0.05  # share of its time by which a method may change over the boards and be called flat
OFF = 4  # cells that are told about
RARE = 0.05  # share of runs below which the paper's small scatter is not reproduced
PATIENCE = 3  # boards without which a straight line leaves no scatter to compare


@dataclass(frozen=True)
class Row:
    """One method's boards."""

    method: str
    records: Records
    times: Array  # [s] of each board, (seeds, boards)
    inserted: Array  # share of each board's parts, (seeds, boards)

    def board(self, index: int) -> Estimate:
        """Time [s] of one board, from 0."""
        return mean_over_seeds(self.times[:, [index]].tolist())

    @property
    def mean(self) -> Estimate:
        """Time [s] of all boards."""
        return mean_over_seeds(self.times.tolist())

    @property
    def share(self) -> Estimate:
        """Share of the components that were inserted."""
        return mean_over_seeds(self.inserted.tolist())

    @property
    def time_per_part(self) -> Estimate:
        """Time [s] for each component that was inserted."""
        return ratio_over_seeds(self.times.tolist(), (HOLES * self.inserted).tolist())


def rows_of(matched: Matched, chosen: Choices, results: Results) -> list[Row]:
    """The four methods, the slowest of the paper first."""
    return [
        _row(matched, one.name, [results[trial] for trial in trials(chosen, matched.world, matched.component, one)])
        for one in matched.methods
    ]


def trials_of(matched: Matched, chosen: Choices) -> list[Trial]:
    """What `rows_of` needs."""
    return [trial for one in matched.methods for trial in trials(chosen, matched.world, matched.component, one)]


def scatter_about_line(times: Array) -> Array:
    """Standard deviation [s] of board times (..., boards) about their own straight line, for each series."""
    boards = times.shape[-1]
    design = np.vander(np.arange(boards, dtype=float), 2)
    fitted = times @ np.linalg.pinv(design).T @ design.T
    return np.asarray(np.sqrt(((times - fitted) ** 2).sum(axis=-1) / (boards - 2)))


def _row(matched: Matched, method: str, records: Records) -> Row:
    boards = max(search.board for seed in records for search in seed)
    shape = (len(records), boards, -1)
    tried = np.array([[search.attempts for search in seed] for seed in records], dtype=float).reshape(shape)
    seated = np.array([[search.seated for search in seed] for seed in records], dtype=float).reshape(shape)
    clock = matched.clock
    times = HOLES * clock.part + clock.per_attempt(method) * tried.sum(axis=2)
    return Row(method, records, times, seated.mean(axis=2))


class CycleStudy:
    """One of the two tables."""

    def __init__(self, printed: CycleTimes, matched: Matched) -> None:
        self.name = f"table{printed.number}"
        self.summary = f"the paper's Table {printed.number}: cycle times of four methods, {printed.component}"
        self.defaults = Choices(seeds=100, boards=BOARDS, physics=False)
        self._printed, self._matched = printed, matched

    def work(self, chosen: Choices) -> Sequence[Trial]:
        """All methods, all seeds."""
        return trials_of(self._matched, chosen)

    def findings(self, chosen: Choices, results: Results) -> Findings:
        """Both rows of each method, its learning curve, and what that shows."""
        rows = rows_of(self._matched, chosen, results)
        printed = self._printed
        caption = (
            f"Cycle times and share of components inserted, {printed.component}: lines with bands, this simulation and "
            f"its standard error over {chosen.seeds} seeds; hollow marks, the paper's Table {printed.number}"
        )
        return Findings(
            tables=(_cycles(rows, printed), _methods(rows, printed)),
            figures=(Picture("cycles", caption, lambda figure: _draw(figure, rows, printed), (10.0, 4.6)),),
            verdict=tuple(_verdict(rows, printed)),
            assumptions=assumptions(self._matched, printed.number),
        )


def compared(rows: Sequence[Row]) -> int:
    """How many boards both the paper and these rows have."""
    return min(BOARDS, int(rows[0].times.shape[1]))


def rmse(rows: Sequence[Row], printed: CycleTimes) -> float:
    """Root mean square difference [s] to the printed cells."""
    boards = compared(rows)
    ours = np.array([row.times.mean(axis=0)[:boards] for row in rows])
    theirs = np.array([printed.cycles[row.method][:boards] for row in rows])
    return math.sqrt(float(np.mean((ours - theirs) ** 2)))


def _cycles(rows: Sequence[Row], printed: CycleTimes) -> Table:
    boards = rows[0].times.shape[1]
    lines: list[tuple[Value, ...]] = []
    for row in rows:
        cells = printed.cycles[row.method]
        known = tuple(f"{cells[board]:.1f}" if board < BOARDS else None for board in range(boards))
        average = f"{printed.averages[row.method]:.1f} printed, {printed.row_mean(row.method):.2f} by its row"
        lines.append((row.method, "paper", *known, average))
        lines.append((row.method, "here", *(row.board(board) for board in range(boards)), str(row.mean)))
    return Table(
        "",
        f"Assembly cycle time of a board in s, {printed.component}: the paper's Table {printed.number}, and this "
        "simulation ± standard error over seeds, failures included",
        ("method", "from", *(f"C{board + 1}" for board in range(boards)), "average"),
        tuple(lines),
    )


def _methods(rows: Sequence[Row], printed: CycleTimes) -> Table:
    lines: list[tuple[Value, ...]] = []
    for row in rows:
        scatter = _less_scattered(row, printed)
        lines.append(
            (
                row.method,
                f"{printed.averages[row.method]:.1f}",
                f"{printed.row_mean(row.method):.2f}",
                row.mean,
                row.share,
                mean_over_seeds(attempts(row.records)),
                row.time_per_part,
                *(scatter or (None, None, None)),
            )
        )
    return Table(
        "methods",
        "The same by method: what the times hide. Scatter: of boards "
        f"C{SETTLED} to C{BOARDS} about their own straight line",
        (
            "method",
            "paper's average, s",
            "mean of its row, s",
            "here, s",
            "share inserted",
            "attempts",
            "s per part inserted",
            "paper's scatter, s",
            "median scatter here, s",
            "runs here with no more scatter than the paper",
        ),
        tuple(lines),
    )


def _less_scattered(row: Row, printed: CycleTimes) -> tuple[float, float, float] | None:
    """The paper's scatter [s], the median of this simulation's, and the share of its runs that have no more."""
    boards = compared([row])
    if boards - (SETTLED - 1) < PATIENCE:
        return None
    theirs = float(scatter_about_line(np.array(printed.cycles[row.method][SETTLED - 1 : boards])))
    ours = scatter_about_line(row.times[:, SETTLED - 1 : boards])
    return theirs, float(np.median(ours)), float(np.mean(ours <= theirs))


def _verdict(rows: Sequence[Row], printed: CycleTimes) -> Iterator[str]:
    by_name = {row.method: row for row in rows}
    yield _order(rows, printed)
    if compared(rows) > 1:
        yield _fall(by_name["meta"], printed)
        yield _flatness(by_name["linear"], printed)
    for row in rows:
        if row.share.value < GIVES_UP:
            yield (
                f"{row.method} inserts {row.share.value:.0%} of the components: the others it gives up, after "
                f"{_spent(row):.3g} attempts on average, and they count in its time as if done. For each component "
                f"inserted it takes {row.time_per_part} s, meta {by_name['meta'].time_per_part} s."
            )
    yield (
        f"How close: {rmse(rows, printed):.2g} s root mean square over {len(rows) * compared(rows)} cells, with eleven "
        "parameters and a clock of three fitted to the same table on other seeds. That a model can be made to fit "
        "shows that the pattern is possible, not that it was measured."
    )
    yield _farthest_off(rows, printed)
    yield from _scatter(rows, printed)
    yield (
        "Misprinted in the paper: the averages are not the means of their rows, "
        + listed(
            f"{row.method} {printed.averages[row.method]:.1f} for {printed.row_mean(row.method):.2f}" for row in rows
        )
        + " s."
    )
    yield (
        "Cannot be decided: how many components the paper's methods inserted, which it does not state and on which the "
        "times depend as much as on speed; whose mean the starting points are; tolerances, strides, covers, lambda's "
        "unit, and what an attempt costs. Its seconds are of another cell: the clock here is fitted to them, and "
        "predicts none. Its authors call the experiments unverified."
    )


def _order(rows: Sequence[Row], printed: CycleTimes) -> str:
    told = ", ".join(f"{row.method} {row.mean}" for row in rows)
    gaps = [mean_over_seeds((slow.times - fast.times).tolist()) for slow, fast in pairwise(rows)]
    theirs = ", ".join(f"{method} {printed.row_mean(method):.1f}" for method in METHODS)
    if any(gap.value <= 0 for gap in gaps):
        outcome = "Not reproduced"
    elif all(gap.value > 2 * gap.error for gap in gaps):
        outcome = "Reproduced"
    else:
        outcome = "Reproduced, though some neighbours differ by less than two standard errors"
    return f"{outcome}: the order of the four methods by mean time, {told} s (paper: {theirs} s)."


def _fall(meta: Row, printed: CycleTimes) -> str:
    last = compared([meta]) - 1
    cells = printed.cycles["meta"]
    ours, theirs = 1 - meta.board(last).value / meta.board(0).value, 1 - cells[last] / cells[0]
    outcome = "Reproduced" if ours >= theirs / 2 else "Not reproduced"
    return (
        f"{outcome}: meta's fall from C1 to C{last + 1}, {meta.board(0)} to {meta.board(last)} s, by {ours:.0%} "
        f"(paper: {cells[0]} to {cells[last]} s, by {theirs:.0%})."
    )


def _flatness(line: Row, printed: CycleTimes) -> str:
    last = compared([line])
    half = last // 2
    early, late = float(line.times[:, :half].mean()), float(line.times[:, half:last].mean())
    cells = printed.cycles["linear"]
    theirs = sum(cells[half:last]) / (last - half) - sum(cells[:half]) / half
    flat = abs(late - early) <= FLAT * early
    return (
        f"{'Reproduced' if flat else 'Not reproduced'}: line search does not get faster, {late - early:+.1f} s from "
        f"the first half of the boards to the second (paper: {theirs:+.1f} s). {_why(line)}"
    )


def _why(line: Row) -> str:
    """Why a line's time does not change."""
    if line.share.value < 0.5:
        return "It is flat because most of its searches run to the line's end, whatever was learnt before."
    return "Most of its searches find their hole."


def _farthest_off(rows: Sequence[Row], printed: CycleTimes) -> str:
    off = [
        (row.board(board).value - printed.cycles[row.method][board], row.board(board).error, row.method, board)
        for row in rows
        for board in range(compared(rows))
    ]
    worst = sorted(off, key=lambda one: -abs(one[0]))[:OFF]
    told = listed(f"{method} C{board + 1} by {Estimate(by, error)} s" for by, error, method, board in worst)
    outcome = "Not reproduced" if any(abs(by) > 3 * error for by, error, *_ in worst) else "Within chance"
    return f"{outcome}, the cells farthest off: {told}."


def _spent(row: Row) -> float:
    """Mean attempts of the searches that failed."""
    failed = [search.attempts for seed in row.records for search in seed if not search.seated]
    return float(np.mean(failed))


def _scatter(rows: Sequence[Row], printed: CycleTimes) -> Iterator[str]:
    found = {row.method: scatter for row in rows if (scatter := _less_scattered(row, printed))}
    if found:
        told = listed(f"{share:.1%} ({name})" for name, (_, _, share) in found.items())
        rare = [name for name, (_, _, share) in found.items() if share < RARE]
        outcome = f"Not reproduced for {listed(rare)}" if rare else "Not excluded"
        yield (
            f"{outcome}: how little the paper's boards scatter. From C{SETTLED} on, about their own straight line, no "
            f"more than the paper's do the boards of {told} of the runs here."
        )


def _draw(figure: Canvas, rows: Sequence[Row], printed: CycleTimes) -> None:
    look = looks(METHODS)
    times, shares = figure.subplots(1, 2, width_ratios=(1.5, 1.0))
    for row in rows:
        one, boards = look[row.method], np.arange(1, row.times.shape[1] + 1)
        for axes, values in ((times, row.times), (shares, 100 * row.inserted)):
            estimates = [mean_over_seeds(values[:, [index]].tolist()) for index in range(len(boards))]
            mean = np.array([estimate.value for estimate in estimates])
            error = np.nan_to_num([estimate.error for estimate in estimates])
            axes.plot(boards, mean, color=one.colour, linestyle=one.dashes, label=f"{row.method}, here")
            axes.fill_between(boards, mean - error, mean + error, color=one.colour, alpha=0.25, linewidth=0)
        known = printed.cycles[row.method][: compared(rows)]
        style: dict[str, Any] = {"color": one.colour, "marker": one.marker, "linestyle": "none", "fillstyle": "none"}
        times.plot(range(1, len(known) + 1), known, **style, label=f"{row.method}, paper")
    times.set(xlabel="board", ylabel="cycle time [s]", ylim=(0, None), title=f"{printed.component}: time of a board")
    shares.set(xlabel="board", ylabel="components inserted [%]", ylim=(0, 103), title="how many of them went in")
    for axes in (times, shares):
        axes.xaxis.get_major_locator().set_params(integer=True)
    handles, labels = times.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4)


TABLE1 = CycleStudy(TABLE_1, IGBT)
TABLE2 = CycleStudy(TABLE_2, CAPACITOR)
