"""The strategy of a recorded session, decided again."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from runtime import topics
from runtime.clock import SessionClock
from runtime.errors import PalpateError, SessionError
from runtime.messages import (
    Attempt,
    Candidate,
    SearchGoal,
)
from runtime.plugin import Strategy
from runtime.reexecution.session import Recorded
from runtime.reexecution.verdict import Verdict
from runtime.strategy_host import SearchSession, stamped


def check_strategy(verdict: Verdict, strategy: Strategy) -> None:
    """Compare every candidate with today's."""
    session = verdict.session
    host = SearchSession(strategy)
    clock = SessionClock()
    attempts, candidates = session.attempts, session.candidates
    last = max(candidates, default=0)
    for goal in session.goals:
        clock.advance(goal.stamp)
        search = goal.message.search
        heard = attempts.pop(search, [])
        recorded = {item.message.number: item for item in candidates.pop(search, [])}
        for now in _candidates(host, goal.message, heard, clock):
            decision = f"search {search}, candidate {now.number}"
            if now.number in recorded:
                verdict.compare(topics.CANDIDATE, decision, recorded.pop(now.number), now, clock.now)
            elif (search < last or recorded) and not session.lacks(topics.CANDIDATE):
                verdict.only_one(topics.CANDIDATE, decision, clock.now, "today's code goes on where the log does not")
            else:
                verdict.tallies[topics.CANDIDATE.name].missing += 1
        if recorded and [item.message.number for item in heard] != list(range(1, len(heard) + 1)):
            verdict.lose(f"attempts of search {search} were not recorded")
            verdict.tallies[topics.CANDIDATE.name].beyond += len(recorded)
        elif recorded and len(heard) < max(recorded) - 1:
            verdict.lose(f"the last attempts of search {search} were not recorded")
            verdict.tallies[topics.CANDIDATE.name].beyond += len(recorded)
        else:
            for number, item in recorded.items():
                decision = f"search {search}, candidate {number}"
                verdict.only_one(topics.CANDIDATE, decision, item.stamp, "today's code has ended the search before it")
    for search, items in candidates.items():
        verdict.lose(f"the goal of search {search} was not recorded")
        verdict.tallies[topics.CANDIDATE.name].beyond += len(items)


def _candidates(
    host: SearchSession, goal: SearchGoal, heard: Sequence[Recorded[Attempt]], clock: SessionClock
) -> Iterator[Candidate]:
    """What today's strategy says to a goal and the attempts that followed, as far as they were all recorded."""
    try:
        yield stamped(host.begin(goal), clock.now)
        for number, attempt in enumerate(heard, 1):
            if attempt.message.number != number:
                return
            clock.advance(attempt.stamp)
            answer = host.observe(attempt.message)
            if answer is not None:
                yield stamped(answer, clock.now)
    except PalpateError:
        raise
    except Exception as error:  # whatever a strategy raises
        name = type(host.strategy).__name__
        raise SessionError(
            f"strategy {name} fails on search {goal.search}, attempt {host.number}: {type(error).__name__}: {error}"
        ) from error
