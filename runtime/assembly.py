"""The job: boards x holes -> a search each -> a result each."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass

from runtime import topics
from runtime.bus import Envelope, Publisher
from runtime.cell import Hole
from runtime.component import component, feasible_radius
from runtime.config import Cell, seed_for
from runtime.context import Context
from runtime.messages import (
    BASE_FRAME,
    NANOSECONDS,
    Attempt,
    Belief,
    BeliefRequest,
    Candidate,
    Ending,
    Outcome,
    Phase,
    Place,
    Point,
    Pose,
    Quaternion,
    SearchGoal,
    SearchResult,
    SessionState,
    header,
    nanoseconds_of,
)

ASK_TIMEOUT = 60.0  # [s] of machine time for the posterior store to answer


@dataclass
class _Report:
    """What is known of the search in hand."""

    attempts: int = 0
    seated: Attempt | None = None
    given_up: Candidate | None = None
    aborted: bool = False

    @property
    def over(self) -> bool:
        # Strategy and arm are heard independently: word that a search is given up may overtake its last attempt.
        given_up = self.given_up is not None and self.attempts >= self.given_up.number - 1
        return self.seated is not None or given_up


@dataclass(frozen=True)
class Assembly:
    """Works through the boards: one search for each hole, whatever becomes of the one before."""

    def run(self, context: Context) -> None:
        """Run the job once the session is running."""
        goals = context.bus.publisher(topics.SEARCH_GOAL)
        results = context.bus.publisher(topics.SEARCH_RESULT)
        session = context.bus.publisher(topics.SESSION)
        context.bus.subscribe(topics.SESSION, topics.ATTEMPT, topics.CANDIDATE)
        context.ready()
        if not _wait_for_start(context):
            return
        cell = context.cell
        past = _ask(context, BeliefRequest(cell.board.holes[0].name, 0, 0))
        known = [seat.board for seat in past.seats] + [miss.board for miss in past.misses]
        first_board = 1 + max(known, default=0)
        last = 0
        for board in range(first_board, first_board + cell.boards):
            for index, hole in enumerate(cell.board.holes):
                belief = _ask(context, BeliefRequest(hole.name, board, last))
                last = (board - 1) * len(cell.board.holes) + index + 1
                goal = goal_for(cell, hole, belief, board, last, context.clock.now)
                goals.send(goal, context.clock.now)
                if not _work_on(context, goal, results):
                    return
        now = context.clock.now
        session.send(SessionState(header(now), context.session, Phase.DONE, "all boards are done"), now)
        for _ in context.arrivals():
            pass


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


def _wait_for_start(context: Context) -> bool:
    for item in context.arrivals():
        if not (isinstance(item, Envelope) and item.topic == topics.SESSION.name):
            continue
        if item.read(topics.SESSION).phase == Phase.RUNNING:
            return True
    return False


def _work_on(context: Context, goal: SearchGoal, results: Publisher[SearchResult]) -> bool:
    """Follow one search to its end and publish the result. False if the cell is closing."""
    report = _Report()
    for item in context.arrivals():
        if isinstance(item, Envelope):
            _take_note(report, goal, item)
        if report.over:
            break
    else:
        return False
    now = context.clock.now
    result = _result(report, goal, now)
    results.send(result, now)
    if result.ending != Ending.INSERTED:
        context.log(
            f"board {goal.board} hole {goal.hole}: {Ending(result.ending).name.lower()} after "
            f"{result.attempts} attempts: {result.reason}",
            logging.WARNING,
        )
    return True


def _take_note(report: _Report, goal: SearchGoal, item: Envelope) -> None:
    if item.topic == topics.ATTEMPT.name:
        attempt = item.read(topics.ATTEMPT)
        if attempt.search == goal.search:
            report.attempts = attempt.number
            report.aborted = attempt.outcome == Outcome.ABORTED
            if attempt.outcome == Outcome.SEATED:
                report.seated = attempt
    elif item.topic == topics.CANDIDATE.name:
        candidate = item.read(topics.CANDIDATE)
        if candidate.search == goal.search and candidate.exhausted:
            report.given_up = candidate


def _result(report: _Report, goal: SearchGoal, now: int) -> SearchResult:
    seated = report.seated
    if seated is not None:
        ending, reason = Ending.INSERTED, ""
    else:
        assert report.given_up is not None
        ending, reason = Ending.ABORTED if report.aborted else Ending.EXHAUSTED, report.given_up.reason
    nominal = goal.nominal.position
    return SearchResult(
        header=header(now, BASE_FRAME),
        search=goal.search,
        board=goal.board,
        hole=goal.hole,
        component=goal.component,
        ending=ending,
        reason=reason,
        attempts=report.attempts,
        x=seated.x if seated else math.nan,
        y=seated.y if seated else math.nan,
        seated_x=seated.pose.position.x - nominal.x if seated else math.nan,
        seated_y=seated.pose.position.y - nominal.y if seated else math.nan,
        duration=(now - nanoseconds_of(goal.header.stamp)) / NANOSECONDS,
    )
