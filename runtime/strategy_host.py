"""Runs a strategy: goals and attempts in, candidates out. The one place that ends a search without a find."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from runtime.bus import Envelope
from runtime.config import strategy_of
from runtime.context import Context
from runtime.errors import SessionError
from runtime.messages import BASE_FRAME, Attempt, Candidate, Outcome, Proposal, SearchGoal, header
from runtime.plugin import Search, Strategy
from runtime.topics import ATTEMPT, CANDIDATE, SEARCH_GOAL
from runtime.validity import fault


@dataclass(frozen=True)
class StrategyHost:
    """Puts a strategy's proposals on the bus."""

    def run(self, context: Context) -> None:
        """Serve one search after another."""
        cell = context.cell
        strategy = strategy_of(cell, "cell")
        candidates = context.bus.publisher(CANDIDATE)
        context.bus.subscribe(SEARCH_GOAL, ATTEMPT)
        context.ready()
        session = SearchSession(strategy)
        for item in context.arrivals():
            if isinstance(item, Envelope):
                if item.topic == SEARCH_GOAL.name:
                    goal = item.read(SEARCH_GOAL)
                    if session.goal is not None and goal.search <= session.goal.search:
                        why = f"search {goal.search} comes after search {session.goal.search}"
                        context.admission.refuse(SEARCH_GOAL.name, why)
                        continue
                    answer: Candidate | None = session.begin(goal)
                else:
                    answer = session.observe(item.read(ATTEMPT))
                if answer is not None:
                    candidates.send(stamped(answer, context.clock.now), context.clock.now)


def stamped(candidate: Candidate, now: int) -> Candidate:
    """The candidate as it is sent at session time `now` [ns]."""
    return replace(candidate, header=header(now, BASE_FRAME))


@dataclass
class SearchSession:
    """The search in hand."""

    strategy: Strategy
    goal: SearchGoal | None = None
    search: Search | None = None
    number: int = 0  # of the attempt asked for last
    _nothing: Proposal = field(default_factory=lambda: Proposal(math.nan, math.nan))

    def begin(self, goal: SearchGoal) -> Candidate:
        """The first candidate for a goal."""
        self._close()
        self.goal, self.number = goal, 0
        self.search = self.strategy.search(goal)
        return self._next(None)

    def observe(self, attempt: Attempt) -> Candidate | None:
        """The candidate that follows an attempt; None when the part is seated or the attempt is not of this search."""
        goal = self.goal
        if goal is None or attempt.search != goal.search or attempt.number != self.number:
            return None
        if attempt.outcome == Outcome.SEATED:
            self._close()
            return None
        if attempt.outcome == Outcome.ABORTED:
            return self._exhausted(f"attempt {attempt.number} was aborted: {attempt.reason}")
        if self.number >= goal.max_attempts:
            return self._exhausted(f"the budget of {goal.max_attempts} attempts is spent")
        return self._next(attempt)

    def _next(self, attempt: Attempt | None) -> Candidate:
        assert self.goal is not None
        assert self.search is not None
        try:
            proposal = next(self.search) if attempt is None else self.search.send(attempt)
        except StopIteration:
            return self._exhausted("the strategy knows no further position")
        self.number += 1
        candidate = Candidate(self.goal.header, self.goal.search, self.number, False, "", proposal)
        if wrong := fault(candidate):
            raise SessionError(f"strategy {type(self.strategy).__name__} proposed what no arm would try: {wrong}")
        return candidate

    def _exhausted(self, reason: str) -> Candidate:
        assert self.goal is not None
        self._close()
        return Candidate(self.goal.header, self.goal.search, self.number + 1, True, reason, self._nothing)

    def _close(self) -> None:
        if self.search is not None:
            self.search.close()
            self.search = None
