"""The job: boards x holes -> a search each -> a result each."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

from runtime import topics
from runtime.bus import Envelope, Request
from runtime.cell import Hole
from runtime.component import component, feasible_radius
from runtime.config import Cell, seed_for
from runtime.context import Context
from runtime.intervention import AttendanceDesk, answered, nothing_needed, told
from runtime.messages import (
    BASE_FRAME,
    NANOSECONDS,
    AnswerGiven,
    Attempt,
    Belief,
    BeliefRequest,
    Candidate,
    Choice,
    Ending,
    Miss,
    Outcome,
    Phase,
    Place,
    Point,
    Pose,
    Quaternion,
    SearchGoal,
    SearchResult,
    Seat,
    SessionState,
    header,
    nanoseconds_of,
)

ASK_TIMEOUT = 60.0  # [s] of machine time for the posterior store to answer


@dataclass(frozen=True)
class Assembly:
    """Works through the boards: one search for each hole, whatever becomes of the one before.

    In an attended cell a hole that was not filled waits for a person; `runtime.intervention` says for what.
    """

    def run(self, context: Context) -> None:
        """Run the job once the session is running."""
        _Job(context).run()


class _Job:
    """The job on the bus."""

    def __init__(self, context: Context) -> None:
        bus = context.bus
        self._context = context
        self._goals = bus.publisher(topics.SEARCH_GOAL)
        self._results = bus.publisher(topics.SEARCH_RESULT)
        self._session = bus.publisher(topics.SESSION)
        self._desk = AttendanceDesk(context.cell.attendance.attended)
        self._told = 0  # [ns] session time as the arm tells it
        if self._desk.attended:
            self._requests = bus.publisher(topics.INTERVENTION)
            self._answers = bus.publisher(topics.ANSWER_GIVEN)
            bus.subscribe(topics.CLOCK)
        bus.serve(topics.ANSWER)
        bus.subscribe(topics.SESSION, topics.ATTEMPT, topics.CANDIDATE)

    def run(self) -> None:
        context = self._context
        context.ready()
        if not self._wait_for_start():
            return
        cell = context.cell
        past = _ask(context, BeliefRequest(cell.board.holes[0].name, 0, 0))
        agenda = Agenda(tasks_of(cell, past.seats, past.misses))
        if self._desk.attended:
            self._requests.send(nothing_needed(context.clock.now), context.clock.now)
        for task in agenda:
            belief = _ask(context, task.question)
            goal = goal_for(cell, task.hole, belief, task.board, task.search, context.clock.now)
            self._goals.send(goal, context.clock.now)
            result = self._work_on(goal)
            if result is None or not self._attend(result, agenda):
                return
        now = context.clock.now
        if agenda.ended:
            text = f"the job was aborted at board {agenda.last.board} hole {agenda.last.hole.name}"
        else:
            text = "all boards are done"
        self._session.send(SessionState(header(now), context.session, Phase.DONE, text), now)
        for _ in self._heard():
            pass

    def _heard(self) -> Iterator[Envelope | AnswerGiven]:
        """What this job is about, and answers of people that were taken, until the cell closes.

        The clock follows what is decided on alone, so that the same is decided at the same time when a log is
        re-executed; /clock tells only when people answer.
        """
        context = self._context
        while not context.stopping:
            item = context.bus.inbox.receive()
            if isinstance(item, Request):
                given = self._reply(item)
                if given is not None:
                    yield given
            elif item is not None and item.topic == topics.CLOCK.name:
                self._told = max(self._told, item.stamp)
            elif item is not None:
                context.clock.advance(item.stamp)
                yield item

    def _reply(self, question: Request) -> AnswerGiven | None:
        """Answer whoever asks or answers; the answer, made known, if it is taken."""
        clock = self._context.clock
        reply, given = self._desk.hear(question.read(topics.ANSWER), max(clock.now, self._told))
        if given is not None:
            clock.advance(self._told)
            now = clock.now
            self._answers.send(given, now)
            self._requests.send(self._desk.open, now)
            self._context.log(answered(given))
        question.reply(reply)
        return given

    def _wait_for_start(self) -> bool:
        for item in self._heard():
            if not (isinstance(item, Envelope) and item.topic == topics.SESSION.name):
                continue
            if item.read(topics.SESSION).phase == Phase.RUNNING:
                return True
        return False

    def _work_on(self, goal: SearchGoal) -> SearchResult | None:
        """Follow one search to its end and publish the result. None if the cell is closing."""
        context, report = self._context, SearchReport(goal)
        for item in self._heard():
            if isinstance(item, Envelope) and item.topic == topics.ATTEMPT.name:
                report.hear_attempt(item.read(topics.ATTEMPT))
            elif isinstance(item, Envelope) and item.topic == topics.CANDIDATE.name:
                report.hear_candidate(item.read(topics.CANDIDATE))
            if report.over:
                break
        else:
            return None
        now = context.clock.now
        result = report.result(now)
        self._results.send(result, now)
        if result.ending != Ending.INSERTED:
            context.log(
                f"board {goal.board} hole {goal.hole}: {Ending(result.ending).name.lower()} after "
                f"{result.attempts} attempts: {result.reason}",
                logging.WARNING,
            )
        return result

    def _attend(self, result: SearchResult, agenda: Agenda) -> bool:
        """Have a person decide how to go on where one is needed. False if the cell is closing."""
        context = self._context
        request = self._desk.ask(result, context.clock.now)
        if request is None:
            return True
        self._requests.send(request, context.clock.now)
        context.log(told(request), logging.WARNING)
        for item in self._heard():
            if isinstance(item, AnswerGiven):
                agenda.follow(item)
                return True
        return False


@dataclass(frozen=True)
class Task:
    """One hole of one board."""

    board: int  # from 1
    hole: Hole
    search: int  # from 1
    after: int  # the search that must be on record before this one begins; 0: none

    @property
    def question(self) -> BeliefRequest:
        """What to ask the posterior before the goal is set."""
        return BeliefRequest(self.hole.name, self.board, self.after)


def tasks_of(cell: Cell, seats: Sequence[Seat], misses: Sequence[Miss]) -> Iterator[Task]:
    """The job: every hole of the cell's boards, which are numbered on from those that the evidence speaks of."""
    known = [seat.board for seat in seats] + [miss.board for miss in misses]
    first = 1 + max(known, default=0)
    after = 0
    for board in range(first, first + cell.boards):
        for index, hole in enumerate(cell.board.holes, 1):
            search = (board - 1) * len(cell.board.holes) + index
            yield Task(board, hole, search, after)
            after = search


class Agenda:
    """The tasks of a job in the order in which they are worked on, as people's answers change it.

    A retry is a search of its own, so the searches after it are numbered on.
    """

    def __init__(self, tasks: Iterable[Task]) -> None:
        self._tasks = tasks
        self._retries = 0
        self._again = False
        self.ended = False  # a person has ended the job
        self.last: Task  # begun

    def __iter__(self) -> Iterator[Task]:
        after = None
        for task in self._tasks:
            self._again = True
            while self._again and not self.ended:
                self._again = False
                search = task.search + self._retries
                self.last = replace(task, search=search, after=task.after if after is None else after)
                after = search
                yield self.last
            if self.ended:
                return

    def follow(self, given: AnswerGiven) -> None:
        """Do what a person answered when the task begun last had failed."""
        if given.choice == Choice.RETRY:
            self._again = True
            self._retries += 1
        elif given.choice == Choice.ABORT:
            self.ended = True


@dataclass
class SearchReport:
    """What is known of the search in hand."""

    goal: SearchGoal
    attempts: int = 0
    seated: Attempt | None = None
    given_up: Candidate | None = None
    aborted: bool = False

    @property
    def over(self) -> bool:
        """Whether the search has ended."""
        # Strategy and arm are heard independently: word that a search is given up may overtake its last attempt.
        given_up = self.given_up is not None and self.attempts >= self.given_up.number - 1
        return self.seated is not None or given_up

    def hear_attempt(self, attempt: Attempt) -> None:
        """What the arm felt; nothing if it was in another search, or is an old word."""
        if attempt.search == self.goal.search and attempt.number > self.attempts:
            self.attempts = attempt.number
            self.aborted = attempt.outcome == Outcome.ABORTED
            if attempt.outcome == Outcome.SEATED:
                self.seated = attempt

    def hear_candidate(self, candidate: Candidate) -> None:
        """What the strategy said; nothing if it was in another search, or that it goes on."""
        if candidate.search == self.goal.search and candidate.exhausted:
            self.given_up = candidate

    def result(self, now: int) -> SearchResult:
        """How the search ended, at session time `now` [ns]; for one that is over."""
        goal, seated = self.goal, self.seated
        if seated is not None:
            ending, reason = Ending.INSERTED, ""
        else:
            assert self.given_up is not None
            ending, reason = Ending.ABORTED if self.aborted else Ending.EXHAUSTED, self.given_up.reason
        nominal = goal.nominal.position
        return SearchResult(
            header=header(now, BASE_FRAME),
            search=goal.search,
            board=goal.board,
            hole=goal.hole,
            component=goal.component,
            ending=ending,
            reason=reason,
            attempts=self.attempts,
            x=seated.x if seated else math.nan,
            y=seated.y if seated else math.nan,
            seated_x=seated.pose.position.x - nominal.x if seated else math.nan,
            seated_y=seated.pose.position.y - nominal.y if seated else math.nan,
            duration=(now - nanoseconds_of(goal.header.stamp)) / NANOSECONDS,
        )


def _ask(context: Context, question: BeliefRequest) -> Belief:
    return context.bus.request(topics.ASK_BELIEF, question, ASK_TIMEOUT)


def goal_for(cell: Cell, hole: Hole, belief: Belief, board: int, search: int, now: int) -> SearchGoal:
    """The goal for one hole, with all that a strategy may know."""
    part = component(cell.component)
    yaw = hole.orientation or 0.0
    return SearchGoal(
        header=header(now, BASE_FRAME),
        search=search,
        board=board,
        hole=hole.name,
        component=cell.component,
        nominal=Pose(
            position=Point(x=cell.board.x + hole.x, y=cell.board.y + hole.y, z=cell.board.z),
            # tool z points down: half a turn about x, then the part's orientation about the board's normal
            orientation=Quaternion(x=math.cos(yaw / 2), y=math.sin(yaw / 2), z=0.0, w=0.0),
        ),
        feasible_radius=feasible_radius(part),
        search_radius=cell.search.radius,
        max_attempts=cell.search.max_attempts,
        seed=seed_for(cell.seed, f"search {search}"),
        prior=belief.distribution,
        seats=belief.seats,
        misses=belief.misses,
        layout=[Place(place.name, cell.board.x + place.x, cell.board.y + place.y) for place in cell.board.holes],
    )
