"""Feeds what the deciders of a recorded session heard through today's code, and compares what it decides.

Strategy, posterior, assembly and interlock are pure, so the same inputs in the same order on the same clock give the
same decisions. Each topic of inputs has one publisher, whose order the log keeps. Between publishers no order is
promised, so the recorder may have heard another than the decider did. Where two meet, this is why it does not matter:

- Strategy (goals, attempts): it answers only attempts of the search in hand, in the order of their numbers, and the
  assembly sets the next goal only after all attempts of the search before. So a candidate depends on its goal and the
  attempts before it, and its stamp, the latest heard, is the later of theirs.
- Assembly (attempts, candidates): a search is over with the attempt that seats the part, or once both the last attempt
  and the word that no candidate is left are here. No candidate is later than the attempt it leads to. Word that the
  session closes may be heard before a last result or after it: the result's own stamp tells.
- Posterior (attempts, results): a search is stored when the result and all its attempts are here, and the assembly
  waits for that before it sets the next goal. What others add to the store or forget meanwhile, it lets in only
  then, and says so in the log.
- Interlock (OSSD, resets, emergency stops, muting): here order matters; each permit says how many of each were heard
  before it. Older logs do not: there each permit answers one message, and carries the stamp of the OSSD message heard
  last.

What was known before the session stands in its first goal. What people answered in an attended cell is taken from the
log: when, and what.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from runtime import roles, topics
from runtime.assembly import Agenda, SearchReport, Task, goal_for, tasks_of
from runtime.clock import SessionClock, Stopwatch
from runtime.config import Cell, strategy_of
from runtime.differences import FieldDifference, differences
from runtime.errors import LogError, PalpateError, SessionError
from runtime.evidence import evidence_of
from runtime.interlock_plugin import InterlockDesk
from runtime.intervention import AttendanceDesk, nothing_needed
from runtime.known_evidence import misses_of, seats_of
from runtime.log_file import LogFile
from runtime.messages import (
    Attempt,
    Candidate,
    Intervention,
    InterventionAnswer,
    Merged,
    Miss,
    Ossd,
    Permit,
    Phase,
    SearchGoal,
    SearchResult,
    Seat,
    nanoseconds_of,
)
from runtime.plugin import Strategy
from runtime.posterior import PosteriorDesk
from runtime.recorded_session import Recorded, RecordedSession, recorded_session
from runtime.strategy_host import SearchSession, stamped
from runtime.topics import Topic

DECISIONS: tuple[Topic[Any], ...] = (
    topics.SEARCH_GOAL,
    topics.CANDIDATE,
    topics.SEARCH_RESULT,
    topics.BELIEF,
    topics.PERMIT,
)


@dataclass
class Tally:
    """How the decisions of one topic compare."""

    compared: int = 0
    rounding: int = 0  # of them equal within rounding, not bit for bit
    differing: int = 0
    missing: int = 0  # that today's code makes and the log, which ends before, does not have
    beyond: int = 0  # recorded, but not to be compared because the recorder lost what they rest on


@dataclass(frozen=True)
class Difference:
    """A decision that is not what it was."""

    topic: str
    stamp: int  # session time [ns]
    decision: str  # which one, in words
    what: str  # in words, where it is not a matter of fields
    fields: tuple[FieldDifference, ...] = ()


@dataclass
class Verdict:
    """What came of a re-execution."""

    session: RecordedSession
    tallies: dict[str, Tally] = field(default_factory=lambda: {topic.name: Tally() for topic in DECISIONS})
    first: Difference | None = None  # the earliest in session time
    losses: list[str] = field(default_factory=list)  # why some decisions could not be compared
    seconds: float = 0.0  # of machine time to read the log and to decide again, once the strategy is loaded

    def tally(self, topic: Topic[Any]) -> Tally:
        """How the decisions of a topic compare; of one that not every session has, once it is asked for."""
        return self.tallies.setdefault(topic.name, Tally())

    @property
    def compared(self) -> int:
        """Decisions that were compared."""
        return sum(tally.compared for tally in self.tallies.values())

    @property
    def differing(self) -> int:
        """Decisions that differ."""
        return sum(tally.differing for tally in self.tallies.values())

    def compare(self, topic: Topic[Any], decision: str, recorded: Recorded[Any], now: Any, stamp: int) -> None:
        """A decision that both the log and today's code have; `stamp` [ns] is when it would be sent today."""
        found = list(differences(recorded.message, now, self.session.fields))
        sent = max(stamp, 0)  # a log has no time before zero
        if sent != recorded.stamp:
            found.append(FieldDifference("(sent at)", "ns", recorded.stamp, sent, rounding=False))
        tally = self.tally(topic)
        tally.compared += 1
        if not found:
            return
        if all(item.rounding for item in found):
            tally.rounding += 1
            return
        self._differs(Difference(topic.name, recorded.stamp, decision, "", tuple(found)))

    def only_one(self, topic: Topic[Any], decision: str, stamp: int, what: str) -> None:
        """A decision that only one of both has, where it is a difference."""
        self.tally(topic).compared += 1
        self._differs(Difference(topic.name, stamp, decision, what))

    def _differs(self, difference: Difference) -> None:
        self.tallies[difference.topic].differing += 1
        if self.first is None or _order(difference) < _order(self.first):
            self.first = difference

    def lose(self, reason: str) -> None:
        """Something the decisions rest on was not recorded."""
        if reason not in self.losses:
            self.losses.append(reason)


def _order(difference: Difference) -> tuple[int, int]:
    """In session time; at one moment, goals come before what follows from them."""
    return difference.stamp, [topic.name for topic in (*DECISIONS, topics.INTERVENTION)].index(difference.topic)


def reexecute(log: LogFile) -> Verdict:
    """Compare every recorded decision with today's.

    Raises LogError if the log holds no decision, InputError if its settings or strategy are unknown today, and
    SessionError if today's code fails on the recorded inputs.
    """
    reading = Stopwatch()
    session = recorded_session(log)
    read = reading.seconds
    if not any(session.messages[topic.name] for topic in DECISIONS):
        raise LogError(f"{log.path}: the log holds no decisions: none of {', '.join(t.name for t in DECISIONS)}")
    verdict = Verdict(session)
    strategy = strategy_of(session.cell(roles.STRATEGY), session.where)
    deciding = Stopwatch()
    _check_strategy(verdict, strategy)
    _check_job(verdict)
    _check_interlock(verdict)
    verdict.seconds = read + deciding.seconds
    if not verdict.compared:
        why = "; ".join(verdict.losses) or "what its decisions rest on was not recorded"
        raise LogError(f"{log.path}: none of its decisions can be compared: {why}")
    return verdict


# The strategy


def _check_strategy(verdict: Verdict, strategy: Strategy) -> None:
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


# Assembly and posterior, who work hand in hand


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


def _check_job(verdict: Verdict) -> None:
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
        self.asked: list[Recorded[Intervention]] = list(
            session.interventions
        )  # and each time that nothing was needed any more
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
            earlier = [item for item in self.asked if item.message.search < first.message.search]
            self.asked = self.asked[len(earlier) :]
            if earlier:
                self.verdict.tally(topics.INTERVENTION).beyond += len(earlier)
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


# The interlock


def _check_interlock(verdict: Verdict) -> None:
    session = verdict.session
    if not session.permits:
        return
    reason = _Interlock(verdict, session.cell(roles.INTERLOCK)).run()
    if reason:
        verdict.lose(reason)
        tally = verdict.tallies[topics.PERMIT.name]
        tally.beyond += len(session.permits) - tally.compared


class _Interlock:
    """Lets today's interlock hear what the recorded one heard, in the order that its permits tell."""

    def __init__(self, verdict: Verdict, cell: Cell) -> None:
        session = verdict.session
        self.verdict, self.session = verdict, session
        self.desk, self.clock = InterlockDesk.of(cell.safety, session.name), SessionClock()
        self.waiting: dict[Topic[Any], list[Recorded[Any]]] = {
            topics.RESET: list(session.resets),
            topics.EMERGENCY_STOP: list(session.emergency_stops),
            topics.MUTING: list(session.mutings),
        }
        self.ossd = {item.sequence: item for item in session.ossd}
        known, words = session.fields.get(Permit), session.fields.get(Ossd)
        self.counted = known is None or {"ossd", "resets"} <= known
        self.tested = words is None or "channel_1_tested" in words

    def run(self) -> str:
        """Compare all permits; why it had to end before their last, empty if it had not."""
        for number, recorded in enumerate(self.session.permits, 1):
            if recorded.sequence != number:
                return f"permit {number} was not recorded, nor therefore what the interlock had heard by then"
            permit: Permit | None = None
            for topic, count in self._heard(recorded.message):
                heard = self.ossd.get(count) if topic is topics.OSSD else self._next(topic, recorded.stamp)
                if heard is None:
                    return f"message {count} of {topic.name} was not recorded"
                self.clock.advance(heard.stamp)
                permit = self.desk.hear(self._as_told(heard.message))
            if permit is None:
                return f"what permit {number} answers was not recorded"
            permit = replace(permit, seal=recorded.message.seal)  # whose key was the session's own, and is gone
            self.verdict.compare(topics.PERMIT, f"permit {number}", recorded, permit, self.clock.now)
        return ""

    def _heard(self, permit: Permit) -> list[tuple[Topic[Any], int]]:
        """What the interlock heard since the permit before, in order: topic, and number of the message on it."""
        desk = self.desk
        if not self.counted:
            following = self.ossd.get(desk.ossd + 1)
            answered = nanoseconds_of(permit.header.stamp)
            if following is None or nanoseconds_of(following.message.header.stamp) != answered:
                return [(topics.RESET, desk.resets + 1)]
            return [(topics.OSSD, desk.ossd + 1)]
        counts = (
            (topics.RESET, desk.resets, permit.resets),
            (topics.EMERGENCY_STOP, desk.emergency_stops, permit.emergency_stops),
            (topics.MUTING, desk.mutings, permit.mutings),
            (topics.OSSD, desk.ossd, permit.ossd),
        )
        return [(topic, number) for topic, before, now in counts for number in range(before + 1, now + 1)]

    def _next(self, topic: Topic[Any], sent: int) -> Recorded[Any] | None:
        """What was heard of buttons and sensors. Two may press one, and then the permit's stamp tells whose it was."""
        waiting = self.waiting[topic]
        if not waiting:
            return None
        chosen = next((item for item in waiting if max(self.clock.now, item.stamp) == sent), waiting[0])
        waiting.remove(chosen)
        return chosen

    def _as_told(self, message: Any) -> Any:
        """The curtain's word; where logs are too old to tell of test pulses, nobody asked for them either."""
        if self.tested or not isinstance(message, Ossd):
            return message
        stamp = message.header.stamp
        return replace(message, channel_1_tested=stamp, channel_2_tested=stamp)
