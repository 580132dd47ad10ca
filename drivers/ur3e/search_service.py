"""The arm at work: one search after another, as the bus asks for them. The same on a simulated arm and on a real one.

What differs is who puts boards and parts in place, how session time passes while there is nothing to do, and what is
done after an aborted attempt.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from dataclasses import replace

from drivers.ur3e.arm import NORMAL, PROTECTIVE_STOP
from drivers.ur3e.skill import Felt, InsertionSkill
from drivers.ur3e.telemetry import ObservedArm, Telemetry, pose_of, wrench_of
from runtime import topics
from runtime.bus import Envelope
from runtime.cell import Hole
from runtime.context import Context
from runtime.errors import ArmError, SessionError
from runtime.messages import (
    BASE_FRAME,
    NANOSECONDS,
    Attempt,
    Candidate,
    Choice,
    Outcome,
    Phase,
    Proposal,
    SearchGoal,
    Waypoint,
    header,
)
from runtime.messages.attendance import DROPPED_WORDS, JAM_WORDS
from runtime.topics import MessageT, Topic


class _Stopped(Exception):  # noqa: N818 - no error: the cell is closing and the arm stands
    """The cell closes, and the arm has come to rest."""


class SearchService(ABC):
    """Serves searches with an arm and a skill on it, until the cell closes."""

    _arm: ObservedArm
    _skill: InsertionSkill

    def __init__(self, context: Context) -> None:
        self._context = context
        self._attempts = context.bus.publisher(topics.ATTEMPT)
        self._telemetry = Telemetry(context)
        self._served = 0  # number of the search begun last
        self._stopped_at: int | None = None  # [ns] since when the arm has not been allowed to move
        self._begun = False  # motion has been permitted for the first time
        self._attended = context.cell.attendance.attended
        context.bus.subscribe(topics.SESSION, topics.PERMIT, topics.SEARCH_GOAL, topics.CANDIDATE)
        if self._attended:
            context.bus.subscribe(topics.ANSWER_GIVEN)

    @property
    @abstractmethod
    def _waiting(self) -> deque[Envelope]:
        """What has arrived and nobody has asked for yet."""

    @abstractmethod
    def _wait_for_arrival(self) -> None:
        """Let something arrive; returns all the same now and then, to see whether the cell closes."""

    @abstractmethod
    def _wait_for_first_permit(self) -> None:
        """Session time begins; wait until motion is permitted, or the cell closes."""

    @abstractmethod
    def _halted(self) -> bool:
        """Whether the plugin is to end, or must, and the arm stands still."""

    @abstractmethod
    def _check(self) -> None:
        """Raise SessionError if it is the interlock that ended the session."""

    @abstractmethod
    def _present(self, goal: SearchGoal) -> None:
        """Have board, hole and part of a search put in place, with the arm out of the way of a fresh board."""

    @abstractmethod
    def _has_part(self) -> bool:
        """Whether the gripper has a part, as far as that can be known."""

    @abstractmethod
    def _recover(self, felt: Felt) -> None:
        """Make the arm able to go on after an aborted attempt. Raises ArmError where that is not safe.

        In an attended cell a person has looked at a protective stop by then.
        """

    def run(self) -> None:
        """Serve searches until the cell closes. Raises SessionError if the arm cannot go on; it is halted by then."""
        self._context.ready()
        try:
            if self._wait_for_cell():
                while self._serve_search():
                    pass
        except _Stopped:
            self._context.log("the arm is halted")
        except ArmError as error:
            raise SessionError(self._last_words(error)) from error
        finally:
            self._telemetry.publish_trace()

    def _last_words(self, error: ArmError) -> str:
        return f"{error}; the arm is halted"

    def _after_cycle(self, arm: ObservedArm) -> None:
        self._telemetry(arm)
        self._tell_stops(arm)
        if self._halted():
            self._telemetry.activity = "halted"
            self._telemetry.publish_status(arm)
            self._check()
            raise _Stopped

    def _tell_stops(self, arm: ObservedArm) -> None:
        """Say in the log what a stop interrupted, and that the same goes on after it."""
        stopped = arm.safety_mode not in (NORMAL, PROTECTIVE_STOP)
        if stopped == (self._stopped_at is not None) or not self._begun or self._context.stopping:
            return
        activity, context = self._telemetry.activity, self._context
        if self._stopped_at is None:
            self._stopped_at = arm.time
            height = arm.pose[0][2] - context.cell.board.z
            part = f" with {self._telemetry.holding}" if self._telemetry.holding else ""
            context.log(f"stopped during {activity}{part}, TCP {1e3 * height:.1f} mm above the board")
        else:
            context.log(f"goes on with {activity} after {(arm.time - self._stopped_at) / NANOSECONDS:.2f} s")
            self._stopped_at = None

    def _wait_for_cell(self) -> bool:
        """Wait until every plugin is there and the interlock permits motion. False if the cell closes before."""
        for item in self._context.arrivals():
            if not (isinstance(item, Envelope) and item.topic == topics.SESSION.name):
                continue
            if item.read(topics.SESSION).phase == Phase.STARTING:
                break
        self._telemetry.describe()
        self._telemetry.publish_state(self._arm)
        self._wait_for_first_permit()
        self._begun = True
        return not self._context.stopping

    def _next(self, topic: Topic[MessageT]) -> MessageT | None:
        """The next message of a topic, waiting for it. None if the cell closes."""
        waiting = self._waiting
        while not self._context.stopping:
            for item in waiting:
                if item.topic == topic.name:
                    waiting.remove(item)
                    return item.read(topic)
            self._wait_for_arrival()
        return None

    def _serve_search(self) -> bool:
        """Pick a part and try where the strategy says until it is seated or given up. False if the cell closes."""
        goal = self._next(topics.SEARCH_GOAL)
        if goal is None:
            return False
        if goal.search <= self._served:
            why = f"search {goal.search} comes after search {self._served}"
            self._context.admission.refuse(topics.SEARCH_GOAL.name, why)
            return True
        if all(goal.hole != place.name for place in self._context.cell.board.holes):
            self._context.admission.refuse(topics.SEARCH_GOAL.name, f"the board has no hole {goal.hole[:20]!r}")
            return True
        self._served = goal.search
        self._present(goal)
        self._do("pick")
        self._skill.pick()
        if not self._has_part():
            raise ArmError("the gripper closed on nothing at the feeder")
        self._telemetry.holding = goal.component
        hole = self._context.cell.board.hole(goal.hole)
        tried = 0  # number of the candidate taken last: one that comes again is not tried again
        while (candidate := self._next(topics.CANDIDATE)) is not None:
            if candidate.search != goal.search or candidate.number <= tried:
                continue
            tried = candidate.number
            if candidate.exhausted:
                self._put_away()
            elif not self._attempt(goal, hole, candidate):
                continue
            self._telemetry.holding = ""
            self._do("idle")
            self._telemetry.publish_status(self._arm)
            return True
        return False

    def _put_away(self) -> None:
        """Leave a hole that is given up: the part goes to the reject bin, the arm to where it is in nobody's way."""
        if self._has_part():
            self._do("discard")
            self._skill.discard()
        else:
            self._do("home")
            self._skill.let_go()

    def _attempt(self, goal: SearchGoal, hole: Hole, candidate: Candidate) -> bool:
        """Try a candidate, let go of the part if it is seated, tell what was felt. Whether it is seated."""
        self._do(f"board {goal.board} hole {goal.hole}: attempt {candidate.number}")
        felt = self._judged(touch(self._skill, hole, candidate.proposal))
        ended = self._arm.time
        if felt.outcome is Outcome.SEATED:
            self._do("release")
            self._skill.release()
        self._attempts.send(attempt_message(goal, candidate, felt, ended), self._arm.time)
        if felt.outcome is Outcome.ABORTED and self._may_recover(goal):
            self._recover(felt)
        return felt.outcome is Outcome.SEATED

    def _judged(self, felt: Felt) -> Felt:
        """What was felt, or that it means nothing: without a part, and to a person who can look, with a jammed one."""
        if not self._has_part():
            self._telemetry.holding = ""
            return replace(felt, outcome=Outcome.ABORTED, reason=DROPPED_WORDS)
        if self._attended and self._skill.jammed(felt):
            reason = f"{JAM_WORDS} {1e3 * felt.depth:.2f} mm deep"
            return replace(felt, outcome=Outcome.ABORTED, reason=reason)
        return felt

    def _may_recover(self, goal: SearchGoal) -> bool:
        """Wait until a person has looked at a protective stop, where there is one. False if the job ends with it."""
        if not self._attended or self._arm.safety_mode != PROTECTIVE_STOP:
            return True
        self._do("waiting for a person")
        self._telemetry.publish_status(self._arm)
        while (given := self._next(topics.ANSWER_GIVEN)) is not None:
            if given.search == goal.search:
                if given.choice != Choice.ABORT:
                    return True
                break
        while not self._context.stopping:
            self._wait_for_arrival()
        return False

    def _do(self, activity: str) -> None:
        self._telemetry.activity = activity


def touch(skill: InsertionSkill, hole: Hole, proposal: Proposal) -> Felt:
    """Do what a strategy proposes: a slide if it gives a path, else a peck."""
    if not proposal.path:
        return skill.peck(hole, proposal.x, proposal.y)
    return skill.slide(hole, _points(proposal))


def attempt_message(goal: SearchGoal, candidate: Candidate, felt: Felt, ended: int) -> Attempt:
    """What was felt, as a message; the attempt ended at session time `ended` [ns]."""
    proposal = candidate.proposal
    return Attempt(
        header=header(ended, BASE_FRAME),
        search=goal.search,
        number=candidate.number,
        board=goal.board,
        hole=goal.hole,
        x=felt.x,
        y=felt.y,
        outcome=felt.outcome,
        reason=felt.reason,
        pose=pose_of(felt.tcp_position, felt.tcp_quaternion),
        wrench=wrench_of(felt.wrench),
        depth=felt.depth,
        peak_force=felt.peak_force,
        duration=felt.duration,
        path=[Waypoint(x, y) for x, y in _points(proposal)] if proposal.path else [],
    )


def _points(proposal: Proposal) -> list[tuple[float, float]]:
    return [(proposal.x, proposal.y), *((point.x, point.y) for point in proposal.path)]
