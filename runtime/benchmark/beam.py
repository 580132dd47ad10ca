"""Somebody who reaches into the light curtain of a running cell at random moments, and watches the arm."""

from __future__ import annotations

import contextlib
import random
import threading
from dataclasses import dataclass

from runtime.bus import Envelope
from runtime.clock import Stopwatch
from runtime.errors import BusError
from runtime.messages import NANOSECONDS, ArmStatus, CurtainCommand, CurtainState, nanoseconds_of
from runtime.network.access import OPERATOR
from runtime.network.meeting_point import MeetingPoint
from runtime.network.zenoh_bus import ZenohBus
from runtime.topics import ARM_STATUS, LIGHT_FIELD

PAUSE = (0.2, 0.8)  # [s] of machine time between an arm that may move again and the next break
HOLD = (0.2, 0.35)  # [s] between the stop and a clear field
WAIT = (0.05, 0.15)  # [s] between that and the reset
_ANSWER = 10.0  # [s] for the curtain to answer, and for the arm to stop or to go on
_NORMAL = 1  # safety mode of an arm that may move, as in ArmStatus


@dataclass(frozen=True)
class LiveBreak:
    """A beam that was broken in machine time, and what the arm said of itself."""

    delay: float = 0.0  # [s] machine time from when the curtain took note until the arm's word of its stop was here
    told: int = 0  # [ns] session time after the control cycle that stopped
    reset: int = 0  # [ns] session time of the reset, or a little before
    failure: str = ""


class Beam:
    """Runs in a process of its own, so that nothing but the bus stands between it and the cell."""

    def __init__(self, point: MeetingPoint, seed: int) -> None:
        self._random = random.Random(seed)
        self._bus = ZenohBus(OPERATOR, point)
        self._bus.subscribe(ARM_STATUS)

    def reach_in(self) -> LiveBreak:
        """Break the beam at a random moment, step back, and press reset once the arm should stand."""
        self._watch(self._random.uniform(*PAUSE))
        broken: list[CurtainState] = []
        hand = threading.Thread(target=self._break, args=(broken,))  # its answer must not hold up the arm's word
        since = Stopwatch()
        hand.start()
        stopped, delay = self._first(since, may_move=False)
        hand.join()
        if not broken:
            return LiveBreak(failure=f"the light curtain gave no answer within {_ANSWER:g} s")
        if stopped is None:
            self._step_back()
            return LiveBreak(failure=f"the arm did not stop within {_ANSWER:g} s")
        moved = self._watch(self._random.uniform(*HOLD))
        self._do("clear")
        moved = self._watch(self._random.uniform(*WAIT)) or moved
        reset = self._step_back()
        failure = "the arm was free to move before the reset" if moved else ""
        delay += since.started - broken[0].heard
        return LiveBreak(delay, nanoseconds_of(stopped.header.stamp), round(reset.time * NANOSECONDS), failure)

    def _break(self, broken: list[CurtainState]) -> None:
        with contextlib.suppress(BusError):  # then the list stays empty
            broken.append(self._do("break"))

    def _do(self, action: str) -> CurtainState:
        return self._bus.request(LIGHT_FIELD, CurtainCommand(action), _ANSWER)

    def _step_back(self) -> CurtainState:
        """Clear the field, press reset, and wait until the arm goes on."""
        self._do("clear")
        reset = self._do("reset")
        self._first(Stopwatch(), may_move=True)
        return reset

    def _watch(self, seconds: float) -> bool:
        """Watch the arm for a while; whether it became free to move."""
        watch, freed = Stopwatch(), False
        while (left := seconds - watch.seconds) > 0:
            status = self._heard(left)
            freed = freed or (status is not None and status.safety_mode == _NORMAL)
        return freed

    def _first(self, since: Stopwatch, *, may_move: bool) -> tuple[ArmStatus | None, float]:
        """The arm's first word that it may move, or may not, and when [s] it came; None if it never did."""
        while since.seconds < _ANSWER:
            status = self._heard(_ANSWER)
            seconds = since.seconds
            if status is not None and (status.safety_mode == _NORMAL) == may_move:
                return status, seconds
        return None, _ANSWER

    def _heard(self, timeout: float) -> ArmStatus | None:
        item = self._bus.inbox.receive(timeout)
        return item.read(ARM_STATUS) if isinstance(item, Envelope) else None

    def close(self) -> None:
        """Leave the cell."""
        self._bus.close()
