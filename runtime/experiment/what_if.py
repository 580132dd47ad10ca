"""How many attempts another strategy would have needed on the very holes that a log found.

A log does not say where a hole was, but it bounds it: the candidate that succeeded lies within the feasible area about
it, those that were blocked do not. Places that agree with all of that are drawn, and a strategy works through the same
searches in the statistical model, from the evidence that the session began with. A hole that was never found has no
place: there a search goes on until the first candidate that what was tried does not rule out, and counts as bounded.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import islice, takewhile

import numpy as np
from numpy.typing import NDArray

from runtime.assembly import tasks_of
from runtime.component import component
from runtime.config import Cell, cell_of
from runtime.errors import LogError
from runtime.experiment.model import Capture, Point, StatisticalBench, along
from runtime.feasible_area import FeasibleArea, area_of
from runtime.log.file import LogFile
from runtime.messages import Attempt, Candidate, Ending, Outcome, SearchGoal, slid_in
from runtime.plain_job import PlainJob
from runtime.plugin import Strategy
from runtime.reexecution.session import recorded_session
from runtime.registry import strategy
from runtime.world import Gap

Array = NDArray[np.float64]

DRAWS = 20  # of places for every hole
_BATCH = 1024  # places looked at together
_BATCHES = 8  # at most for one hole
_LATE = 0.1e-3  # [m] a sliding part drops in at most so far after its pins have come over the holes
_FAR = 1.0  # [m] where no candidate goes
_CAPTURE = Capture()


@dataclass(frozen=True)
class Swept:
    """Places that one blocked attempt looked at: a hole's centre is not within the feasible area of any."""

    touched: Array  # (1, 2) [m] where the pins came down
    slid: Array  # (n, 2) [m] what they then passed

    def rules_out(self, area: FeasibleArea, places: Array) -> NDArray[np.bool_]:
        """Which of the places (m, 2) [m] a hole cannot have, or the attempt would have found it."""
        return _within(area, self.touched, places, 1.0) | _within(area, self.slid, places, _CAPTURE.swath)


def _within(area: FeasibleArea, points: Array, places: Array, size: float) -> NDArray[np.bool_]:
    if not len(points):
        return np.zeros(len(places), dtype=bool)
    errors = area.to_own(points[None, :, :] - places[:, None, :])
    return np.asarray((area.gauge(errors) <= size).any(axis=1))


def swept(path: Sequence[Point], until: float = math.inf) -> Swept:
    """What an attempt looked at along its path, on the first `until` [m] of it. One point: a peck."""
    slid = [at for travelled, at in along(path, _CAPTURE.step) if travelled <= until]
    return Swept(np.array(path[:1]), np.array(slid).reshape(-1, 2))


@dataclass(frozen=True)
class LoggedHole:
    """What a log knows of the place of one hole for one part."""

    goal: SearchGoal
    attempts: int
    blocked: tuple[Swept, ...]
    entered: Point | None  # [m] where the pins went in; None: never found
    slid_in: bool = False

    @cached_property
    def area(self) -> FeasibleArea:
        """Where the part goes in, about the hole's place."""
        return area_of(self.goal)

    def contradictions(self, places: Array) -> NDArray[np.int_]:
        """How many of the blocked attempts would have gone in at each of the places (m, 2) [m]."""
        count = np.zeros(len(places), dtype=int)
        for item in self.blocked:
            count += item.rules_out(self.area, places)
        return count

    def places(self, generator: np.random.Generator, count: int) -> tuple[Array, bool]:
        """Places (count, 2) [m] drawn evenly from those that agree with the log; whether there are any.

        If there are none, since real parts are not quite the drawing's, those that disagree with the fewest attempts.
        """
        assert self.entered is not None
        drawn, disagree = np.empty((0, 2)), np.empty(0, dtype=int)
        for _ in range(_BATCHES):
            batch = np.array(self.entered) - self._about(generator, _CAPTURE.swath if self.slid_in else 1.0)
            drawn = np.concatenate([drawn, batch])
            disagree = np.concatenate([disagree, self.contradictions(batch)])
            if (disagree == 0).sum() >= count:
                break
        chosen = drawn[disagree == disagree.min()]
        return np.resize(chosen, (count, 2)), bool(disagree.min() == 0)

    def _about(self, generator: np.random.Generator, size: float) -> Array:
        """Offsets within the feasible area, `size` times grown, evenly spread."""
        reach = float(self.area.rim.max()) * size
        points = generator.uniform(-reach, reach, (_BATCH, 2))
        return self.area.to_metres(points[self.area.gauge(points) <= size])

    def rules_out(self, path: Sequence[Point]) -> bool:
        """Whether the log tells that an attempt along this path finds nothing."""
        offsets = self._about(np.random.default_rng(0), 1.0)
        first = np.array(path[0]) - offsets
        if (self.contradictions(first) == 0).any():
            return False
        offsets *= _CAPTURE.swath
        return all((self.contradictions(np.array(at) - offsets) > 0).all() for _, at in along(path, _CAPTURE.step))


@dataclass(frozen=True)
class Logged:
    """A session as far as `what_if` needs it."""

    cell: Cell
    where: str
    holes: tuple[LoggedHole, ...]  # searches in order, those with a result alone

    @property
    def found(self) -> int:
        """Holes that were found."""
        return sum(hole.entered is not None for hole in self.holes)

    @property
    def attempts(self) -> int:
        """Attempts of all searches."""
        return sum(hole.attempts for hole in self.holes)

    def strategy(self, name: str) -> Strategy:
        """A strategy with the cell's settings. Raises PluginError naming what is installed."""
        return strategy(name, self.cell.strategies.get(name, {}), self.where)


def logged(log: LogFile) -> Logged:
    """What a log tells of its holes. Raises LogError if it holds no finished search, or not from the first on."""
    session = recorded_session(log)
    cell = cell_of(session.document, session.where)
    if not session.goals or not session.results:
        raise LogError(f"{log.path}: the log holds no finished search, so it tells of no hole")
    if session.goals[0].sequence != 1:
        raise LogError(f"{log.path}: the log begins in the middle of its session: what was known before is not in it")
    first = session.goals[0].message
    goals = {item.message.search: item.message for item in session.goals}
    attempts, results = session.attempts, session.results
    numbers = (task.search for task in tasks_of(cell, first.seats, first.misses))
    holes = []
    for search in takewhile(lambda number: number in goals and number in results, numbers):
        found = results[search].message.ending == Ending.INSERTED
        holes.append(_hole(goals[search], [item.message for item in attempts.get(search, [])], found))
    return Logged(cell, session.where, tuple(holes))


def _hole(goal: SearchGoal, attempts: list[Attempt], found: bool) -> LoggedHole:
    blocked, entered, slid = [], None, False
    for attempt in attempts:
        path = [(point.x, point.y) for point in attempt.path] or [(attempt.x, attempt.y)]
        if attempt.outcome == Outcome.BLOCKED:
            blocked.append(swept(path))
        elif attempt.outcome == Outcome.SEATED and found:
            entered, slid = (attempt.x, attempt.y), slid_in(attempt)
            if slid:
                blocked.append(swept(path, _travelled(path, entered) - _LATE))
    return LoggedHole(goal, len(attempts), tuple(blocked), entered, slid)


def _travelled(path: Sequence[Point], place: Point) -> float:
    """How far along a path [m] it first comes closest to a place."""
    ways = [(math.dist(at, place), travelled) for travelled, at in along(path, _CAPTURE.step)]
    return min(ways)[1]


@dataclass
class _Bench:
    """A workbench whose holes are those of a log."""

    model: StatisticalBench
    holes: dict[int, LoggedHole]
    hole: LoggedHole | None = None

    @property
    def time(self) -> int:
        return self.model.time

    @property
    def offset(self) -> tuple[float, float]:
        return self.model.offset

    def begin(self, search: int, board: int, hole: str) -> None:
        self.hole = self.holes[search]
        self.model.begin(search, board, hole)

    def attempt(self, goal: SearchGoal, candidate: Candidate) -> Attempt:
        assert self.hole is not None
        attempt = self.model.attempt(goal, candidate)
        if self.hole.entered is None:
            proposal = candidate.proposal
            path = [(proposal.x, proposal.y), *((point.x, point.y) for point in proposal.path)]
            if not self.hole.rules_out(path):
                return replace(attempt, outcome=Outcome.ABORTED, reason="the log does not tell what happens here")
        return attempt

    def end(self, seated: bool) -> None:
        self.model.end(seated)


@dataclass(frozen=True)
class _Places:
    """One draw: where every hole is."""

    gaps: dict[int, Gap]

    def gap(self, search_number: int, board_number: int, hole_name: str) -> Gap:  # noqa: ARG002 - one for each search
        return self.gaps[search_number]


@dataclass(frozen=True)
class Outlook:
    """What a strategy makes of the holes of a log."""

    strategy: str
    attempts: list[int] = field(default_factory=list)  # of all searches together, for each draw
    found: list[int] = field(default_factory=list)  # holes
    bounded: list[int] = field(default_factory=list)  # holes at which the log does not tell how it goes on


@dataclass(frozen=True)
class WhatIf:
    """Places for all holes of a log, the same for every strategy."""

    log: Logged
    draws: tuple[dict[int, Gap], ...]
    contradicting: int  # holes whose attempts agree with no place at all

    def outlook(self, name: str, tell: Callable[[], None] = lambda: None) -> Outlook:
        """Let a strategy work through every draw, and tell after each. Raises PluginError."""
        made, outlook, first = self.log.strategy(name), Outlook(name), self.log.holes[0].goal
        holes = {hole.goal.search: hole for hole in self.log.holes}
        for number, gaps in enumerate(self.draws):
            model = StatisticalBench(self.log.cell, capture=_CAPTURE, gaps=_Places(gaps), seed=number)
            bench = _Bench(model, holes)
            job = PlainJob(self.log.cell, made, bench, seats=list(first.seats), misses=list(first.misses))
            records = list(islice(job.searches(), len(holes)))
            outlook.attempts.append(sum(record.attempts for record in records))
            outlook.found.append(sum(record.seated for record in records))
            outlook.bounded.append(sum(attempt.outcome == Outcome.ABORTED for attempt in job.attempts))
            tell()
        return outlook


def what_if(log: Logged, draws: int = DRAWS) -> WhatIf:
    """Draw places for all holes of a log. The same log gives the same draws."""
    gaps: list[dict[int, Gap]] = [{} for _ in range(draws)]
    contradicting = 0
    part = component(log.cell.component)
    for hole in log.holes:
        search = hole.goal.search
        places = np.full((draws, 2), _FAR)
        if hole.entered is not None:
            places, agree = hole.places(np.random.default_rng([log.cell.seed, search]), draws)
            contradicting += not agree
        orientation = log.cell.board.hole(hole.goal.hole).orientation or 0.0
        for drawn, (x, y) in zip(gaps, places.tolist(), strict=True):
            drawn[search] = Gap(part, x, y, orientation, turned=0.0, wider=0.0)
    return WhatIf(log, tuple(gaps), contradicting)
