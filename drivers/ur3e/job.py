"""The simulated arm at work: searches on a simulated cell, whose truth is published."""

from __future__ import annotations

import math
from collections import deque

from drivers.ur3e.search_service import SearchService, attempt_message
from drivers.ur3e.setup import Setup
from drivers.ur3e.simulated_cell import SearchTruth
from drivers.ur3e.skill import Felt
from runtime import topics
from runtime.bus import Envelope
from runtime.clock import Pacer, parse_rate
from runtime.context import Context
from runtime.messages import BASE_FRAME, SearchGoal, Truth, header
from runtime.permit_gate import PermitGate

__all__ = ["Job", "attempt_message"]


class Job(SearchService):
    """Owns the simulated cell and serves searches on it."""

    def __init__(self, setup: Setup, context: Context) -> None:
        super().__init__(context)
        cell, bus = context.cell, context.bus
        self._truths = bus.publisher(topics.TRUTH)
        self._gate = PermitGate(context, bus.publisher(topics.CLOCK), Pacer(parse_rate(cell.rate)))
        self._cell, self._skill = setup.build(cell, gate=self._gate, observe=self._after_cycle)
        self._arm = self._cell.arm

    @property
    def _waiting(self) -> deque[Envelope]:
        return self._gate.waiting

    def _wait_for_arrival(self) -> None:
        self._gate.wait_for_arrival()

    def _wait_for_first_permit(self) -> None:
        self._gate.wait_for_first_permit()

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

    def _recover(self, felt: Felt) -> None:
        """A motion that the simulated arm refused leaves it where it was, able to go on; a protective stop ends the
        session with the next motion.
        """


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
