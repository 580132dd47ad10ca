"""The interlock's permit for an arm that moves by itself: no fresh permit, no motion, and nobody waits.

The real-time counterpart of `runtime.permit_gate`. A simulation can hold its time back until the interlock has spoken;
a real arm cannot, so a word that is late counts as a refusal, and the arm goes on once there is a new one. Session time
is the arm's controller time since the session began. It is told on /clock often enough that a permit is renewed
several times before it ends.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

from runtime.bus import Envelope, Publisher
from runtime.context import Context
from runtime.errors import SessionError
from runtime.messages import Clock, nanoseconds_of, stamp_of
from runtime.topics import PERMIT

TICK = 20_000_000  # [ns] of session time between ticks of /clock: a permit of 200 ms outlasts nine of them
PATIENCE = 15_000_000_000  # [ns] of session time without a word until the interlock counts as lost


@dataclass
class RealTimeGate:
    """Decides control cycle by control cycle whether the arm may move, and keeps what else arrives meanwhile."""

    context: Context
    clock: Publisher[Clock]
    waiting: deque[Envelope] = field(default_factory=deque)  # arrivals that are not for the gate
    lost: bool = False  # the interlock has fallen silent
    _granted: bool = False
    _until: int = -1  # [ns]
    _heard: int = 0  # [ns] when the interlock last spoke
    _ticked: int = -TICK  # [ns]

    def __call__(self, now: int) -> bool:
        """Whether the arm may move at session time `now` [ns]. Never blocks."""
        self.context.clock.advance(now)
        if now - self._ticked >= TICK:
            self._ticked = now
            self.clock.send(Clock(clock=stamp_of(now)), now)
        self._take_arrivals(now)
        self.lost = self.lost or now - self._heard > PATIENCE
        return self.permits(now)

    def permits(self, now: int) -> bool:
        """What the last word means for session time `now` [ns]."""
        return self._granted and now < self._until and not self.lost and not self.context.stopping

    def _take_arrivals(self, now: int) -> None:
        while (item := self.context.bus.inbox.poll()) is not None:
            if not isinstance(item, Envelope):
                continue
            if item.topic == PERMIT.name:
                permit = item.read(PERMIT)
                self._granted, self._until, self._heard = permit.granted, nanoseconds_of(permit.valid_until), now
            else:
                self.waiting.append(item)

    def check(self) -> None:
        """Raise SessionError once the interlock has fallen silent."""
        if self.lost:
            raise SessionError(f"no word from the interlock within {PATIENCE / 1e9:g} s: the arm is halted")
