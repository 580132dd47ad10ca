"""A whole job in one plain loop: boards x holes -> search -> attempts, without bus, log or other plugins.

What is touched is a `Workbench`: the full physics of a driver, or the statistical model of `runtime.experiment`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Protocol

from runtime.assembly import goal_for, tasks_of
from runtime.belief import belief_about
from runtime.config import Cell, redacted_cell
from runtime.messages import (
    Attempt,
    Belief,
    Candidate,
    Gaussian,
    Miss,
    Outcome,
    SearchGoal,
    Seat,
    Waypoint,
    header,
    slid_in,
)
from runtime.plugin import SearchRecord, Strategy
from runtime.strategy_host import SearchSession

SESSION = "plain"  # name of the one session in which all seats are found


class Workbench(Protocol):
    """Where parts are tried in holes."""

    @property
    def time(self) -> int:
        """Session time [ns]."""
        ...

    @property
    def offset(self) -> tuple[float, float]:
        """Where the TCP must go relative to nominal [m] for the part in hand: for the record, not for the search."""
        ...

    def begin(self, search: int, board: int, hole: str) -> None:
        """Put board and hole in place and a part into the gripper."""
        ...

    def attempt(self, goal: SearchGoal, candidate: Candidate) -> Attempt:
        """Try a candidate."""
        ...

    def end(self, seated: bool) -> None:
        """Let go of the part: it is seated, or goes into the reject bin."""
        ...


@dataclass
class PlainJob:
    """A job, from an empty store unless `seats` and `misses` say what is known.

    `prior` false: goals carry no belief, for strategies that do not start from it.
    """

    cell: Cell
    strategy: Strategy
    bench: Workbench
    prior: bool = True
    seats: list[Seat] = field(default_factory=list)
    misses: list[Miss] = field(default_factory=list)
    attempts: list[Attempt] = field(default_factory=list)  # of all searches so far, in order

    def searches(self) -> Iterator[SearchRecord]:
        """Work through the cell's boards."""
        decide = redacted_cell(self.cell, "assembly")
        session = SearchSession(self.strategy)
        for task in tasks_of(self.cell, self.seats, self.misses):
            begun = self.bench.time
            belief = self._belief(task.hole.name, task.board)
            goal = goal_for(decide, task.hole, belief, task.board, task.search, begun)
            self.bench.begin(task.search, task.board, task.hole.name)
            attempts = self._search(session, goal)
            seated = bool(attempts) and attempts[-1].outcome == Outcome.SEATED
            self.bench.end(seated)
            self._remember(goal, attempts)
            self.attempts += attempts
            yield SearchRecord(
                board=task.board,
                hole=task.hole.name,
                seated=seated,
                attempts=len(attempts),
                search_time=sum(attempt.duration for attempt in attempts),
                part_time=1e-9 * (self.bench.time - begun),
                travelled=sum(((b.x - a.x) ** 2 + (b.y - a.y) ** 2) ** 0.5 for a, b in pairwise(attempts)),
                offset=self.bench.offset,
            )

    def _search(self, session: SearchSession, goal: SearchGoal) -> list[Attempt]:
        attempts: list[Attempt] = []
        candidate: Candidate | None = session.begin(goal)
        while candidate is not None and not candidate.exhausted:
            attempts.append(self.bench.attempt(goal, candidate))
            candidate = session.observe(attempts[-1])
        return attempts

    def _belief(self, hole: str, board: int) -> Belief:
        cell, now = self.cell, header(self.bench.time)
        distribution, count = Gaussian(), 0
        if self.prior:
            distribution, count = belief_about(hole, self.seats, cell.search.prior_width, session=SESSION, board=board)
        return Belief(now, cell.board.type, hole, count, distribution, list(self.seats), list(self.misses))

    def _remember(self, goal: SearchGoal, attempts: list[Attempt]) -> None:
        self.misses += [
            Miss(goal.board, goal.hole, attempt.path or [Waypoint(attempt.x, attempt.y)])
            for attempt in attempts
            if attempt.outcome == Outcome.BLOCKED
        ]
        if attempts and attempts[-1].outcome == Outcome.SEATED:
            last, nominal = attempts[-1], goal.nominal.position
            x, y = last.pose.position.x - nominal.x, last.pose.position.y - nominal.y
            self.seats.append(Seat(SESSION, goal.board, goal.hole, last.x, last.y, x, y, slid_in(last)))
