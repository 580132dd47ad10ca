"""The posterior store as a plugin: results and attempts in, what is believed about a hole out."""

from __future__ import annotations

import logging
from collections import defaultdict, deque
from dataclasses import dataclass, field
from pathlib import Path

from runtime.belief import belief_about
from runtime.bus import Envelope, Publisher, Request
from runtime.context import Context
from runtime.messages import Attempt, Belief, BeliefRequest, SearchResult, header
from runtime.posterior_store import PosteriorStore
from runtime.topics import ASK_BELIEF, ATTEMPT, BELIEF, SEARCH_RESULT


@dataclass(frozen=True)
class Posterior:
    """Remembers where parts went in, and says what that tells about a hole."""

    path: Path
    fresh: bool = False  # forget what is known of this board type first

    def run(self, context: Context) -> None:
        """Store every result, and answer whoever asks."""
        cell = context.cell
        with PosteriorStore(self.path) as store:
            beliefs = context.bus.publisher(BELIEF)
            context.bus.subscribe(SEARCH_RESULT, ATTEMPT)
            context.bus.serve(ASK_BELIEF)
            context.ready()
            if self.fresh:
                store.forget(cell.board.type, scope=cell.posterior.scope)
            desk = _Desk(context, store, beliefs)
            damaged = store.set_aside
            for item in context.arrivals():
                if damaged is not None:  # said only now: before the first question the recorder may not listen yet
                    context.log(
                        f"the posterior store was damaged: set aside as {damaged.name}, begun anew", logging.WARNING
                    )
                    damaged = None
                desk.take(item)
                desk.work()


@dataclass
class _Desk:
    """Results that wait for their attempts, and questions that wait for a result."""

    context: Context
    store: PosteriorStore
    beliefs: Publisher[Belief]
    attempts: dict[int, list[Attempt]] = field(default_factory=lambda: defaultdict(list))
    results: deque[SearchResult] = field(default_factory=deque)
    questions: deque[Request] = field(default_factory=deque)
    stored: int = 0  # number of the last search on record

    def take(self, item: Envelope | Request) -> None:
        if isinstance(item, Request):
            self.questions.append(item)
        elif item.topic == ATTEMPT.name:
            attempt = item.read(ATTEMPT)
            self.attempts[attempt.search].append(attempt)
        else:
            self.results.append(item.read(SEARCH_RESULT))

    def work(self) -> None:
        while self.results and len(self.attempts[self.results[0].search]) >= self.results[0].attempts:
            result = self.results.popleft()
            cell = self.context.cell
            attempts = self.attempts.pop(result.search)
            self.store.record(
                cell.board.type, result, session=self.context.session, attempts=attempts, scope=cell.posterior.scope
            )
            self.stored = result.search
            self.beliefs.send(self._belief(result.hole, result.board), self.context.clock.now)
        while self.questions and self.questions[0].read(ASK_BELIEF).after_search <= self.stored:
            question = self.questions.popleft()
            asked: BeliefRequest = question.read(ASK_BELIEF)
            question.reply(self._belief(asked.hole, asked.board))

    def _belief(self, hole: str, board: int) -> Belief:
        cell = self.context.cell
        seats = self.store.seats(cell.board.type, cell.component, scope=cell.posterior.scope)
        distribution, count = belief_about(
            hole, seats, cell.search.prior_width, session=self.context.session, board=board
        )
        misses = self.store.misses(cell.board.type, cell.component, scope=cell.posterior.scope)
        return Belief(header(self.context.clock.now), cell.board.type, hole, count, distribution, seats, misses)
