"""The interlock's permit for an arm that moves by itself: no fresh permit, no motion, and nobody waits.

The real-time counterpart of `runtime.safety.permit_gate`. A simulation can hold its time back until the interlock has
spoken; a real arm cannot, so a word that is late counts as a refusal, and the arm goes on once there is a new one.
Session time is the arm's controller time since the session began. It is told on /clock often enough that a permit is
renewed several times before it ends.
"""

from __future__ import annotations

import logging
from collections import deque
from dataclasses import dataclass, field

from runtime.bus import Envelope, Publisher
from runtime.context import Context
from runtime.messages import NANOSECONDS, Clock, stamp_of
from runtime.safety.held_permit import HeldPermit
from runtime.safety.permit_gate import silent
from runtime.topics import PERMIT

TICK = 20_000_000  # [ns] of session time between ticks of /clock: a permit of 200 ms outlasts nine of them
_LATE = 100_000_000  # [ns] of session time after a permit's end until that is told
_NOTED = 1_000_000_000  # [ns] of session time between lines about permits that ended


@dataclass
class RealTimeGate:
    """Decides control cycle by control cycle whether the arm may move, and keeps what else arrives meanwhile."""

    context: Context
    clock: Publisher[Clock]
    held: HeldPermit = field(init=False)
    waiting: deque[Envelope] = field(default_factory=deque)  # arrivals that are not for the gate
    lost: bool = False  # the interlock has fallen silent
    _heard: int = 0  # [ns] when the interlock last spoke
    _noted: int = -_NOTED  # [ns] when it was last told that a permit ended
    _ticked: int = -TICK  # [ns]

    def __post_init__(self) -> None:
        self.held = HeldPermit(self.context)

    def __call__(self, now: int) -> bool:
        """Whether the arm may move at session time `now` [ns]. Never blocks."""
        self.context.clock.advance(now)
        if now - self._ticked >= TICK:
            self._ticked = now
            self.clock.send(Clock(clock=stamp_of(now)), now)
        self._take_arrivals(now)
        self.lost = self.lost or now - self._heard > self.context.cell.safety.patience * NANOSECONDS
        if self.held.granted and now > self.held.until + _LATE > self._noted + _NOTED:
            self._noted = now
            self.context.log("no fresh permit: the arm stands", logging.WARNING)
        return self.permits(now)

    def permits(self, now: int) -> bool:
        """What the last word means for session time `now` [ns]."""
        return self.held.permits(now) and not self.lost

    def _take_arrivals(self, now: int) -> None:
        while (item := self.context.bus.inbox.poll()) is not None:
            if not isinstance(item, Envelope):
                continue
            if item.topic != PERMIT.name:
                self.waiting.append(item)
            elif self.held.hear(item, self._ticked):
                self._heard = now

    def check(self) -> None:
        """Raise SessionError once the interlock has fallen silent."""
        if self.lost:
            raise silent(self.context)
