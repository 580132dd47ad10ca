"""Assembly and posterior of a recorded session, who work hand in hand, decided again."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from typing import Any

from runtime import roles, topics
from runtime.assembly import Agenda, SearchReport, Task, goal_for, tasks_of
from runtime.clock import SessionClock
from runtime.config import Cell
from runtime.evidence.evidence import evidence_of, misses_of, seats_of
from runtime.intervention import AttendanceDesk, nothing_needed
from runtime.messages import (
    Attempt,
    Intervention,
    InterventionAnswer,
    Merged,
    Miss,
    Phase,
    SearchResult,
    Seat,
)
from runtime.posterior import PosteriorDesk
from runtime.reexecution.session import Recorded, RecordedSession
from runtime.reexecution.verdict import Verdict
from runtime.topics import Topic


class _SinceFirstGoal:
    """Evidence: what the first goal says was known before, what the session found, and what others changed."""

    def __init__(self, session: RecordedSession) -> None:
        first = session.goals[0].message
        self._seats, self._misses = list(first.seats), list(first.misses)
        self._identity = session.identity
        # What came before the first goal, in a log that begins in the middle of its session, stands in that goal.
        self._changes = deque(item for item in session.merged if item.message.after_search >= first.search)
        begins = session.goals[0].sequence == 1
        self._next = self._changes[0].sequence if self._changes and not begins else 1
        self._lost = topics.MERGED.name in session.lost

    @property
    def uncertain(self) -> bool:
        """Whether a change may have been made by now that was not recorded."""
        return self._changes[0].sequence != self._next if self._changes else self._lost

    def record(self, result: SearchResult, attempts: Sequence[Attempt]) -> bool:
        piece = evidence_of("", result, self._identity, attempts, scope="", recorded_at=0)
        self._seats = [*self._seats, *seats_of(piece, piece.board)]
        self._misses = [*self._misses, *misses_of(piece, piece.board)]
        return True

    def merged(self, after: int, now: int) -> Merged | None:  # noqa: ARG002 - the log says when
        if not self._changes or self._changes[0].message.after_search != after:
            return None
        self._next += 1
        change = self._changes.popleft().message
        self._seats, self._misses = change.seats, change.misses
        return change

    def seats(self) -> list[Seat]:
        return self._seats

    def misses(self) -> list[Miss]:
        return self._misses


def check_job(verdict: Verdict) -> None:
    """Compare goals, results, beliefs and interventions with today's."""
    session = verdict.session
    if not session.goals:
        return
    evidence = _SinceFirstGoal(session)
    desk = PosteriorDesk(session.cell(roles.POSTERIOR), session.identity, evidence)
    _Job(verdict, session.cell(roles.ASSEMBLY), desk, evidence).run()


class _Job:
    """Walks through the searches of a session as the assembly did."""

    def __init__(self, verdict: Verdict, cell: Cell, desk: PosteriorDesk, evidence: _SinceFirstGoal) -> None:
        session = verdict.session
        self.evidence = evidence
        self.verdict, self.session, self.cell, self.desk = verdict, session, cell, desk
        self.goals = {item.message.search: item for item in session.goals}
        self.results = session.results
        self.beliefs = {item.sequence: item for item in session.beliefs}  # one for each result, in their order
        self.attempts, self.candidates = session.attempts, session.candidates
        self.clock, self.posterior_clock = SessionClock(), SessionClock()
        self.lost = False  # something that all further decisions rest on was not recorded
        self.answers = session.answers
        # What was needed of a person, and each time that nothing was needed any more.
        self.asked: list[Recorded[Intervention]] = list(session.interventions)
        self.people = AttendanceDesk(cell.attendance.attended)
        running = [state.message.phase == Phase.RUNNING for state in session.states]
        for state in session.states[: running.index(True) + 1] if any(running) else ():
            self.clock.advance(state.stamp)

    def run(self) -> None:
        """Compare goals, results and beliefs as far as all that they rest on was recorded."""
        self._leave_out_earlier()
        agenda = Agenda(self._tasks())
        if self.people.attended and self.session.goals[0].sequence == 1:
            self._asks(nothing_needed(self.clock.now), "that nothing is needed yet")
        for task in agenda:
            done = self._goal(task) and self._result(task) and self._belief(task) and self._attend(task, agenda)
            if not done:
                break
        unseen = (
            (topics.SEARCH_GOAL, self.goals.values()),
            (topics.SEARCH_RESULT, self.results.values()),
            (topics.BELIEF, self.beliefs.values()),
            (topics.INTERVENTION, self.asked),
        )
        for topic, items in unseen:
            for item in items:
                if self.lost:
                    self.verdict.tally(topic).beyond += 1
                else:
                    what = "the log has it, today's code does not make it"
                    self.verdict.only_one(topic, f"message {item.sequence}", item.stamp, what)

    def _leave_out_earlier(self) -> None:
        """Searches before the first recorded goal, in a log that begins in the middle of its session."""
        first = self.session.goals[0]
        for search in [number for number in self.results if number < first.message.search]:
            earlier = self.results.pop(search)
            self.verdict.lose(f"the goal of search {search} was not recorded")
            self.verdict.tallies[topics.SEARCH_RESULT.name].beyond += 1
            if self.beliefs.pop(earlier.sequence, None) is not None:
                self.verdict.tallies[topics.BELIEF.name].beyond += 1
        if first.sequence > 1:
            before = [item for item in self.asked if item.message.search < first.message.search]
            self.asked = self.asked[len(before) :]
            if before:
                self.verdict.tally(topics.INTERVENTION).beyond += len(before)
            self.people.numbered = self.asked[0].message.number - 1 if self.asked else 0

    def _tasks(self) -> Iterator[Task]:
        first = self.session.goals[0]
        tasks = tasks_of(self.cell, first.message.seats, first.message.misses)
        if first.sequence == 1:
            yield from tasks
            return
        # A log that begins in the middle of its session: the boards before are among what its first goal knows.
        board, search = first.message.board, first.message.search
        holes = {hole.name: index for index, hole in enumerate(self.cell.board.holes, 1)}
        start = holes.get(first.message.hole, 1)
        self.clock.advance(first.stamp)
        for number in range(board, board + self.cell.boards):
            for index, hole in enumerate(self.cell.board.holes, 1):
                if number > board or index >= start:
                    yield Task(number, hole, search, search - 1)
                    search += 1

    def _goal(self, task: Task) -> bool:
        desk = self.desk
        now = self.clock.now
        goal = goal_for(
            self.cell, task.hole, desk.belief(task.hole.name, task.board, now), task.board, task.search, now
        )
        recorded = self.goals.pop(task.search, None)
        if recorded is None:
            if self.goals:
                if self.session.lacks(topics.SEARCH_GOAL):
                    self._lose(f"the goal of search {task.search} was not recorded")
                else:
                    self._only_now(topics.SEARCH_GOAL, f"goal of search {task.search}", now)
            elif self.session.goals[0].sequence == 1:  # otherwise it is not known how many boards were to come
                self.verdict.tallies[topics.SEARCH_GOAL.name].missing += 1
            return False
        self.verdict.compare(topics.SEARCH_GOAL, f"goal of search {task.search}", recorded, goal, now)
        self.clock.advance(recorded.stamp)
        self.report = SearchReport(recorded.message)
        return True

    def _result(self, task: Task) -> bool:
        report = self.report
        recorded = self.results.pop(task.search, None)
        for candidate in self.candidates.get(task.search, []):
            self.clock.advance(candidate.stamp)
            report.hear_candidate(candidate.message)
        for attempt in self.attempts.get(task.search, []):
            self.clock.advance(attempt.stamp)
            report.hear_attempt(attempt.message)
        if not report.over:
            if recorded is not None and self._end_is_missing():
                self._lose(f"the end of search {task.search} was not recorded")
                self.verdict.tallies[topics.SEARCH_RESULT.name].beyond += 1
            elif recorded is not None:
                what = "today's code does not see the search end"
                self.verdict.only_one(topics.SEARCH_RESULT, f"result of search {task.search}", recorded.stamp, what)
            return False
        if recorded is None:
            if self.results and not self.session.lacks(topics.SEARCH_RESULT):
                self._only_now(topics.SEARCH_RESULT, f"result of search {task.search}", self.clock.now)
            elif self.results:
                self._lose(f"the result of search {task.search} was not recorded")
            else:
                self.verdict.tallies[topics.SEARCH_RESULT.name].missing += 1
            return False
        for state in self.session.states:
            if state.message.phase == Phase.CLOSING and self.clock.now < state.stamp == recorded.stamp:
                self.clock.advance(state.stamp)
        now = self.clock.now
        self.verdict.compare(topics.SEARCH_RESULT, f"result of search {task.search}", recorded, report.result(now), now)
        self.ended = recorded
        return True

    def _end_is_missing(self) -> bool:
        session = self.session
        return not session.complete or session.lacks(topics.ATTEMPT) or session.lacks(topics.CANDIDATE)

    def _belief(self, task: Task) -> bool:
        ended, attempts = self.ended, self.attempts.get(task.search, [])
        if [item.message.number for item in attempts] != list(range(1, ended.message.attempts + 1)):
            self._lose(f"attempts of search {task.search} were not recorded")
            return False
        if self.evidence.uncertain:
            self._lose("what others changed in the evidence was not all recorded")
            return False
        for item in attempts:
            self.posterior_clock.advance(item.stamp)
            self.desk.hear_attempt(item.message)
        self.posterior_clock.advance(ended.stamp)
        self.desk.hear_result(ended.message)
        now = self.posterior_clock.now
        for settled in self.desk.settle(now):
            decision = f"belief after search {task.search}"
            recorded = self.beliefs.pop(ended.sequence, None)
            if recorded is not None:
                self.verdict.compare(topics.BELIEF, decision, recorded, settled.belief, now)
            elif self.beliefs and not self.session.lacks(topics.BELIEF):
                self._only_now(topics.BELIEF, decision, now)
            else:
                self.verdict.tallies[topics.BELIEF.name].missing += 1
        return True

    def _attend(self, task: Task, agenda: Agenda) -> bool:
        """Ask a person where one was needed, and do what the log says was answered. False if it does not say."""
        ended = self.ended.message
        request = self.people.ask(ended, self.clock.now)
        if request is None:
            return True
        self._asks(request, f"request {request.number}")
        given = self.answers.get(task.search)
        if given is None:
            if self.goals or self.asked:
                self._lose(f"the answer to request {request.number} was not recorded")
            return False
        self.clock.advance(given.stamp)
        message = given.message
        answer = InterventionAnswer(message.number, message.choice, message.who, message.note)
        reply, taken = self.people.hear(answer, self.clock.now)
        if taken is None:
            what = f"today's code refuses its answer: {reply.error}"
            self.verdict.only_one(topics.INTERVENTION, f"request {request.number}", given.stamp, what)
            return False
        self._asks(reply.open, f"the end of request {request.number}")
        agenda.follow(taken)
        return True

    def _asks(self, request: Intervention, decision: str) -> None:
        recorded = self.asked.pop(0) if self.asked else None
        if recorded is not None:
            self.verdict.compare(topics.INTERVENTION, decision, recorded, request, self.clock.now)
        elif self.session.lacks(topics.INTERVENTION):
            self._lose("what was needed of a person was not recorded")
        else:
            self.verdict.tally(topics.INTERVENTION).missing += 1

    def _only_now(self, topic: Topic[Any], decision: str, stamp: int) -> None:
        self.verdict.only_one(topic, decision, stamp, "today's code makes it, the log does not have it")

    def _lose(self, reason: str) -> None:
        self.lost = True
        self.verdict.lose(reason)
