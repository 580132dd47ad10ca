"""The simulated arm at work: one search after another, as the bus asks for them."""

from __future__ import annotations

import math

from drivers.ur3e.setup import Setup
from drivers.ur3e.simulated_arm import SimulatedArm
from drivers.ur3e.simulated_cell import SearchTruth
from drivers.ur3e.skill import Peck
from drivers.ur3e.telemetry import Telemetry, pose_of, wrench_of
from runtime import topics
from runtime.bus import Envelope
from runtime.cell import Hole
from runtime.clock import Pacer, parse_rate
from runtime.context import Context
from runtime.errors import ArmError, SessionError
from runtime.messages import BASE_FRAME, Attempt, Candidate, Outcome, Phase, SearchGoal, Truth, header
from runtime.permit_gate import PermitGate
from runtime.topics import MessageT, Topic


class _Stopped(Exception):  # noqa: N818 - no error: the cell is closing and the arm stands
    """The cell closes, and the arm has come to rest."""


class Job:
    """Owns the simulated cell and serves searches on it."""

    def __init__(self, setup: Setup, context: Context) -> None:
        cell = context.cell
        bus = context.bus
        self._context = context
        self._attempts = bus.publisher(topics.ATTEMPT)
        self._truths = bus.publisher(topics.TRUTH)
        self._gate = PermitGate(context, bus.publisher(topics.CLOCK), Pacer(parse_rate(cell.rate)))
        self._telemetry = Telemetry(context)
        bus.subscribe(topics.SESSION, topics.PERMIT, topics.SEARCH_GOAL, topics.CANDIDATE)
        self._cell, self._skill = setup.build(cell, gate=self._gate, observe=self._after_cycle)

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
            raise SessionError(f"{error}; the arm is halted") from error
        finally:
            self._telemetry.publish_trace(self._cell.arm)

    def _after_cycle(self, arm: SimulatedArm) -> None:
        self._telemetry(arm)
        if (self._context.stopping or self._gate.lost) and arm.getSpeedScaling() == 0.0:
            self._telemetry.activity = "halted"
            self._telemetry.publish_status(arm)
            self._gate.check()
            raise _Stopped

    def _wait_for_cell(self) -> bool:
        """Wait until every plugin is there and the interlock permits motion. False if the cell closes before."""
        for item in self._context.arrivals():
            if not (isinstance(item, Envelope) and item.topic == topics.SESSION.name):
                continue
            if item.read(topics.SESSION).phase == Phase.STARTING:
                break
        self._telemetry.describe()
        self._telemetry.publish_state(self._cell.arm)
        self._gate.wait_for_first_permit()
        return not self._context.stopping

    def _next(self, topic: Topic[MessageT]) -> MessageT | None:
        """The next message of a topic, waiting for it while session time stands still. None if the cell closes."""
        gate = self._gate
        while not self._context.stopping:
            for item in gate.waiting:
                if item.topic == topic.name:
                    gate.waiting.remove(item)
                    return item.read(topic)
            gate.wait_for_arrival()
        return None

    def _serve_search(self) -> bool:
        """Pick a part and try where the strategy says until it is seated or given up. False if the cell closes."""
        goal = self._next(topics.SEARCH_GOAL)
        if goal is None:
            return False
        truth = self._cell.begin_search(goal.search, goal.board, goal.hole)
        if self._cell.board_changed:
            self._do("home")
            self._skill.home()
        self._truths.send(_truth_message(truth, self._cell.arm.time), self._cell.arm.time)
        self._do("pick")
        self._skill.pick()
        if not self._cell.arm.holding:
            raise ArmError("the gripper closed on nothing at the feeder")
        self._telemetry.holding = goal.component
        hole = self._context.cell.board.hole(goal.hole)
        while (candidate := self._next(topics.CANDIDATE)) is not None:
            if candidate.search != goal.search:
                continue
            if candidate.exhausted:
                self._do("discard")
                self._skill.discard()
            elif not self._attempt(goal, hole, candidate):
                continue
            self._telemetry.holding = ""
            self._do("idle")
            self._telemetry.publish_status(self._cell.arm)
            return True
        return False

    def _attempt(self, goal: SearchGoal, hole: Hole, candidate: Candidate) -> bool:
        """Peck at a candidate, let go of the part if it is seated, tell what was felt. Whether it is seated."""
        self._do(f"board {goal.board} hole {goal.hole}: attempt {candidate.number}")
        peck = self._skill.peck(hole, candidate.proposal.x, candidate.proposal.y)
        ended = self._cell.arm.time
        if peck.outcome is Outcome.SEATED:
            self._do("release")
            self._skill.release()
        self._attempts.send(attempt_message(goal, candidate, peck, ended), self._cell.arm.time)
        return peck.outcome is Outcome.SEATED

    def _do(self, activity: str) -> None:
        self._telemetry.activity = activity


def attempt_message(goal: SearchGoal, candidate: Candidate, peck: Peck, ended: int) -> Attempt:
    """What was felt, as a message; the peck ended at session time `ended` [ns]."""
    return Attempt(
        header=header(ended, BASE_FRAME),
        search=goal.search,
        number=candidate.number,
        board=goal.board,
        hole=goal.hole,
        x=candidate.proposal.x,
        y=candidate.proposal.y,
        outcome=peck.outcome,
        reason=peck.reason,
        pose=pose_of(peck.tcp_position, peck.tcp_quaternion),
        wrench=wrench_of(peck.wrench),
        depth=peck.depth,
        peak_force=peck.peak_force,
        duration=peck.duration,
    )


def _truth_message(truth: SearchTruth, now: int) -> Truth:
    hole, part = truth.hole_truth, truth.part_truth
    return Truth(
        header=header(now, BASE_FRAME),
        search=truth.search,
        board=truth.board,
        hole=truth.hole,
        hole_x=hole.x,
        hole_y=hole.y,
        hole_yaw=math.remainder(hole.yaw, 2 * math.pi),
        pin_x=part.x,
        pin_y=part.y,
        pin_yaw=math.remainder(part.yaw, 2 * math.pi),
        offset_x=truth.offset[0],
        offset_y=truth.offset[1],
    )
