"""How long strategies think: seconds a candidate, and what a long past costs."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import numpy as np

from runtime.clock import Stopwatch
from runtime.component import component
from runtime.experiment.contenders import Contender
from runtime.experiment.model import StatisticalBench
from runtime.experiment.worlds import NamedWorld
from runtime.messages import SearchGoal, Seat
from runtime.plain_job import SESSION, PlainJob
from runtime.plugin import Search, Strategy
from runtime.world import World

PASTS = (10, 100, 1000)  # boards


@dataclass(frozen=True)
class Thinking:
    """How long one strategy thought [s]."""

    first: tuple[float, ...]  # before the first candidate of each search
    others: tuple[float, ...]  # before each of the others
    cold: dict[
        int, float
    ]  # boards learned from -> before the first candidate of a process that has learned nothing yet
    warm: dict[int, float]  # the same, one search later


@dataclass
class _Timed:
    """A strategy with a stopwatch."""

    strategy: Strategy
    first: list[float] = field(default_factory=list)
    others: list[float] = field(default_factory=list)
    watch: Stopwatch = field(default_factory=Stopwatch)

    def search(self, goal: SearchGoal) -> Search:
        """The strategy's own search, timed."""
        begun = self.watch.seconds
        search = self.strategy.search(goal)
        proposal = next(search)
        self.first.append(self.watch.seconds - begun)
        try:
            while True:
                attempt = yield proposal
                begun = self.watch.seconds
                try:
                    proposal = search.send(attempt)
                except StopIteration:
                    return
                self.others.append(self.watch.seconds - begun)
        finally:
            search.close()


def thinking(contender: Contender, world: NamedWorld, part: str, seeds: int) -> Thinking:
    """Time a strategy on one core, on the statistical model of a world."""
    with _one_core():
        timed = _Timed(contender.make())
        for seed in range(seeds):
            cell = world.cell(part, seed=seed)
            list(PlainJob(cell, timed, StatisticalBench(cell), contender.prior).searches())
        cold, warm = {}, {}
        for boards in PASTS:
            cold[boards], warm[boards] = _with_past(contender, world, part, boards)
    return Thinking(tuple(timed.first), tuple(timed.others), cold, warm)


def _with_past(contender: Contender, world: NamedWorld, part: str, boards: int) -> tuple[float, float]:
    """Time before the first candidate after so many boards: of a strategy that has learned nothing, and of the next."""
    cell = replace(world.cell(part, seed=boards), boards=1)
    drawn = World(cell.board, component(part), cell.tolerances, cell.seed)
    seats = []
    for board in range(1, boards + 1):
        for number, hole in enumerate(cell.board.holes):
            x, y = drawn.offset((board - 1) * len(cell.board.holes) + number + 1, board, hole.name)
            seats.append(Seat(SESSION, board, hole.name, x, y, x, y))
    timed = _Timed(contender.make())
    job = PlainJob(cell, timed, StatisticalBench(cell), contender.prior, seats=seats)
    searches = job.searches()
    next(searches)
    next(searches)
    return timed.first[0], timed.first[1]


@contextmanager
def _one_core() -> Iterator[None]:
    """Keep this process to one core, where the system lets us."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    whole = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(whole)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, whole)


def figures(name: str, found: Thinking) -> dict[str, float]:
    """The figures of one strategy as flat names [ms]."""
    every = 1e3 * np.array(found.first + found.others)
    said = {"mean_ms": every.mean(), "p99_ms": np.percentile(every, 99), "worst_ms": every.max()}
    said["first_mean_ms"] = 1e3 * float(np.mean(found.first))
    for boards in found.cold:
        said[f"after_{boards}_boards_cold_ms"] = 1e3 * found.cold[boards]
        said[f"after_{boards}_boards_warm_ms"] = 1e3 * found.warm[boards]
    return {f"{name}_{key}": float(value) for key, value in said.items()}
