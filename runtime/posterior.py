"""The posterior store as a plugin: results and attempts in, what is believed about a hole out.

Where its cell shares what it learns, an exchange keeps the store in step with those of other cells meanwhile.
"""

from __future__ import annotations

import logging
from collections import defaultdict, deque
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from runtime.belief import belief_about
from runtime.bus import Publisher, Request
from runtime.config import Cell
from runtime.context import Context
from runtime.evidence.exchange import EvidenceExchange
from runtime.evidence.known import KnownEvidence
from runtime.evidence.store import PosteriorStore
from runtime.messages import Attempt, Belief, BeliefRequest, Merged, Miss, SearchResult, Seat, header
from runtime.topics import ASK_BELIEF, ATTEMPT, BELIEF, MERGED, SEARCH_RESULT


@dataclass(frozen=True)
class Posterior:
    """Remembers where parts went in, and says what that tells about a hole."""

    path: Path
    session: str  # under which evidence is kept: unlike that of any other session of any cell
    fresh: bool = False  # forget what is known of this board type first
    keys: Path | None = None  # folder of keys to share evidence with other cells; None: without TLS

    def run(self, context: Context) -> None:
        """Store every result, and answer whoever asks."""
        cell = context.cell
        with ExitStack() as held:
            store = held.enter_context(PosteriorStore(self.path))
            beliefs, changes = context.bus.publisher(BELIEF), context.bus.publisher(MERGED)
            context.bus.subscribe(SEARCH_RESULT, ATTEMPT)
            context.bus.serve(ASK_BELIEF)
            if self.fresh:
                store.forget(cell.board.type, scope=cell.posterior.scope)
            exchange = self._exchange(store, cell)
            context.ready()
            desk = PosteriorDesk(cell, self.session, KnownEvidence(store, cell, self.session))
            try:
                self._serve(context, desk, exchange, beliefs, changes, store.set_aside)
            finally:
                if exchange is not None:
                    exchange.close()
                    _say(context, exchange.reports(last=True))

    def _exchange(self, store: PosteriorStore, cell: Cell) -> EvidenceExchange | None:
        endpoints = cell.posterior.shared_through
        if not endpoints:
            return None
        from runtime.network import zenoh_exchange

        join = zenoh_exchange.client(endpoints, self.keys)
        return EvidenceExchange(store, self.session, join, ", ".join(endpoints))

    def _serve(
        self,
        context: Context,
        desk: PosteriorDesk,
        exchange: EvidenceExchange | None,
        beliefs: Publisher[Belief],
        changes: Publisher[Merged],
        damaged: Path | None,
    ) -> None:
        questions: deque[Request] = deque()
        for item in context.arrivals():
            if damaged is not None:  # said only now: before the first question the recorder may not listen yet
                context.log(
                    f"the posterior store was damaged: set aside as {damaged.name}, begun anew", logging.WARNING
                )
                damaged = None
            now = context.clock.now
            if isinstance(item, Request):
                questions.append(item)
            elif item.topic == ATTEMPT.name:
                desk.hear_attempt(item.read(ATTEMPT))
            else:
                desk.hear_result(item.read(SEARCH_RESULT))
            for settled in desk.settle(now):
                if not settled.kept:
                    context.log(
                        f"search {settled.search} was not stored: the store has another one of session {self.session}",
                        logging.WARNING,
                    )
                if settled.merged is not None:
                    changes.send(settled.merged, now)
                beliefs.send(settled.belief, now)
                if exchange is not None:
                    exchange.changed()
            while questions and desk.knows_enough(asked := questions[0].read(ASK_BELIEF)):
                questions.popleft().reply(desk.belief(asked.hole, asked.board, now))
            if exchange is not None:
                _say(context, exchange.reports())


def _say(context: Context, reports: list[tuple[str, int]]) -> None:
    for text, level in reports:
        context.log(text, level)


class Evidence(Protocol):
    """What searches found, as far as it counts in this session: `KnownEvidence` says what each does."""

    def record(self, result: SearchResult, attempts: Sequence[Attempt]) -> bool:
        """Store how a search ended and all its attempts; False if its identity is taken."""
        ...

    def merged(self, after: int, now: int) -> Merged | None:
        """Let in what others changed by the end of search `after`, at session time `now` [ns]."""
        ...

    def seats(self) -> list[Seat]:
        """Every insertion, oldest first."""
        ...

    def misses(self) -> list[Miss]:
        """Every attempt that was blocked, oldest first."""
        ...


@dataclass(frozen=True)
class Settled:
    """A search that is on record, and what followed from it."""

    search: int
    kept: bool  # whether it was stored
    merged: Merged | None  # what others had changed meanwhile
    belief: Belief  # about its hole, after both


@dataclass
class PosteriorDesk:
    """What the posterior decides, without bus or clock: results wait for their attempts, questions for a result."""

    cell: Cell
    session: str  # under which evidence is kept
    evidence: Evidence
    stored: int = 0  # number of the last search on record
    _attempts: dict[int, list[Attempt]] = field(default_factory=lambda: defaultdict(list))
    _results: deque[SearchResult] = field(default_factory=deque)

    def hear_attempt(self, attempt: Attempt) -> None:
        """Keep an attempt for its result; one that is heard again changes nothing."""
        kept = self._attempts[attempt.search]
        if all(attempt.number != other.number for other in kept):
            kept.append(attempt)

    def hear_result(self, result: SearchResult) -> None:
        """Keep a result until its attempts are here: arm and assembly are heard independently.

        One that is heard again changes nothing; its attempts would never come.
        """
        if result.search > self.stored and all(result.search != other.search for other in self._results):
            self._results.append(result)

    def settle(self, now: int) -> Iterator[Settled]:
        """Store every search of which all is known; after each, what is believed at `now` [ns] about its hole."""
        while self._results and len(self._attempts[self._results[0].search]) >= self._results[0].attempts:
            result = self._results.popleft()
            kept = self.evidence.record(result, self._attempts.pop(result.search))
            self.stored = result.search
            merged = self.evidence.merged(result.search, now)
            yield Settled(result.search, kept, merged, self.belief(result.hole, result.board, now))

    def knows_enough(self, question: BeliefRequest) -> bool:
        """Whether the search that a question waits for is on record."""
        return question.after_search <= self.stored

    def belief(self, hole: str, board: int, now: int) -> Belief:
        """What is believed about a hole at session time `now` [ns]."""
        cell = self.cell
        seats, misses = self.evidence.seats(), self.evidence.misses()
        distribution, count = belief_about(hole, seats, cell.search.prior_width, session=self.session, board=board)
        return Belief(header(now), cell.board.type, hole, count, distribution, seats, misses)
