"""The simulated arm at work: searches on a simulated cell, whose truth is published.

How it stops depends on the permit. Category 2, for the light curtain: it brakes along its path, stands under power, and
goes on. Category 1, for an emergency stop: it brakes the same way, then the brakes hold it and the drives lose their
power. The reset that permits motion again switches them on and releases the brakes, for which a real arm wants a person
at its pendant, and the motion goes on from where the arm stands.
"""

from __future__ import annotations

import math
from collections import deque

from drivers.ur3e.arm import EMERGENCY_STOP, PROTECTIVE_STOP, SAFEGUARD_STOP
from drivers.ur3e.control_box.modes import RobotMode
from drivers.ur3e.control_box.safety import Power
from drivers.ur3e.mishap import MishapScript
from drivers.ur3e.search_service import SearchService, attempt_message
from drivers.ur3e.setup import Setup
from drivers.ur3e.simulated_arm import SimulatedArm
from drivers.ur3e.simulated_cell import SearchTruth
from drivers.ur3e.skill import Felt
from drivers.ur3e.telemetry import ObservedArm
from runtime import topics
from runtime.bus import Envelope
from runtime.cell import Hole
from runtime.clock import Pacer, parse_rate
from runtime.context import Context
from runtime.messages import BASE_FRAME, Candidate, SearchGoal, Truth, header
from runtime.safety.permit_gate import PermitGate

__all__ = ["Job", "attempt_message"]


_TOLD = {RobotMode.POWER_OFF: "the drives are without power", RobotMode.RUNNING: "the drives have power again"}


class Job(SearchService):
    """Owns the simulated cell and serves searches on it."""

    _arm: SimulatedArm

    def __init__(self, setup: Setup, context: Context) -> None:
        super().__init__(context)
        cell, bus = context.cell, context.bus
        self._truths = bus.publisher(topics.TRUTH)
        self._gate = PermitGate(context, bus.publisher(topics.CLOCK), Pacer(parse_rate(cell.rate)))
        self._power = Power()
        self._cell, self._skill = setup.build(cell, gate=self._may_move, observe=self._after_cycle)
        self._arm = self._cell.arm
        self._mishaps = MishapScript(setup.mishaps, self._cell.scene)

    def _may_move(self, now: int) -> bool:
        """Whether the arm may move in the cycle that begins at session time `now` [ns], and has the power to."""
        permitted = self._gate(now)
        arm, power, emergency = self._arm, self._power, self._gate.held.emergency
        arm.stop_mode = EMERGENCY_STOP if emergency else SAFEGUARD_STOP
        if not emergency and power.mode == RobotMode.RUNNING:
            return permitted
        power.want(RobotMode.POWER_OFF if emergency else RobotMode.RUNNING)
        power.advance(standing=not any(arm.controller.qd))
        if power.mode != arm.robot_mode:
            arm.robot_mode = power.mode
            if power.mode in _TOLD:
                self._context.log(_TOLD[power.mode])
        return permitted and power.mode == RobotMode.RUNNING

    @property
    def _waiting(self) -> deque[Envelope]:
        return self._gate.waiting

    def _wait_for_arrival(self) -> None:
        self._gate.wait_for_arrival()

    def _wait_for_first_permit(self) -> None:
        self._gate.wait_for_first_permit()
        self._gate.check()

    def _halted(self) -> bool:
        return (self._context.stopping or self._gate.lost) and self._arm.getSpeedScaling() == 0.0

    def _check(self) -> None:
        self._gate.check()

    def _present(self, goal: SearchGoal) -> None:
        truth = self._cell.begin_search(goal.search, goal.board, goal.hole)
        if self._cell.board_changed:
            self._do("home")
            self._skill.home()
        self._truths.send(_truth_message(truth, self._arm.time), self._arm.time)

    def _has_part(self) -> bool:
        return self._cell.arm.holding

    def _attempt(self, goal: SearchGoal, hole: Hole, candidate: Candidate) -> bool:
        with self._mishaps.during(goal.search, candidate.number):
            return super()._attempt(goal, hole, candidate)

    def _after_cycle(self, arm: ObservedArm) -> None:
        self._mishaps.cycle(self._arm)
        super()._after_cycle(arm)

    def _recover(self, felt: Felt) -> None:
        """Release a protective stop once the controller allows it, and go straight up.

        A motion that the arm refused leaves it where it was, able to go on.
        """
        arm = self._arm
        if arm.safety_mode != PROTECTIVE_STOP:
            return
        self._do("recover")
        self._context.log(f"{felt.reason}: {arm.stop_reason}: recovering")
        while not arm.unlockProtectiveStop():
            arm.cycle()
        self._skill.lift()


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
