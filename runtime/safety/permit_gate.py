"""The simulated arm's side of the interlock: no fresh permit, no motion.

The simulation runs in lockstep with the interlock. Every word from the interlock holds for a stretch of session time;
the gate announces session time on /clock, and holds simulated time back rather than run past the last word. A curtain
that can vouch for its near future lets the simulation run far ahead of the messages, and still stop in the very cycle
in which the beam breaks.

What if no word comes? As fast as the machine allows, session time stands still until there is one: a process that is
slow, or was stopped for a while, changes no decision. At a rate that keeps pace with real time it stands still for a
moment only, since a busy machine is just slow; then the arm stops as a real one would, category 2, in the cycle in
which its permit ended, session time goes on, and so does the motion once there is a fresh permit. Either way the arm is
lost after the cell's patience: it is halted, and the session ends.
"""

from __future__ import annotations

import logging
from collections import deque
from dataclasses import dataclass, field

from runtime.bus import Envelope, Publisher
from runtime.clock import Pacer, Stopwatch
from runtime.context import Context
from runtime.errors import SessionError
from runtime.messages import Clock, stamp_of
from runtime.safety.held_permit import HeldPermit
from runtime.topics import PERMIT

TICK = 80_000_000  # [ns] of session time between ticks of /clock: the default permit outlasts two of them
SLOW = 0.5  # [s] of machine time that a word may be late before anybody takes note
_LOOK = 0.1  # [s] between looks for the end of the cell


@dataclass
class PermitGate:
    """Decides cycle by cycle whether the arm may move, and keeps what else arrives meanwhile."""

    context: Context
    clock: Publisher[Clock]
    pacer: Pacer
    held: HeldPermit = field(init=False)
    waiting: deque[Envelope] = field(default_factory=deque)  # arrivals that are not for the gate
    lost: bool = False  # the interlock has fallen silent
    _silence: Stopwatch | None = None  # since a word is missing
    _told: bool = False  # that it is
    _ticked: int = -TICK  # [ns]

    def __post_init__(self) -> None:
        self.held = HeldPermit(self.context)

    def __call__(self, now: int) -> bool:
        """Whether the arm may move in the cycle that begins at session time `now` [ns]. Blocks until that is known."""
        self.context.clock.advance(now)
        self.pacer.wait_until(now)  # cycle by cycle, or it would run ahead of a beam that somebody breaks now
        if now - self._ticked >= TICK:
            self._tick(now)
        if len(self.context.bus.inbox):
            self.take_arrivals()
        if now >= self.held.until and not self._wait_for_word(now):
            return False
        if self._silence is not None:
            self._tell_of_its_end(self._silence)
        return self.held.permits(now)

    def take_arrivals(self) -> None:
        """Sort what has arrived into permits and the rest."""
        while (item := self.context.bus.inbox.poll()) is not None:
            if isinstance(item, Envelope):
                self._sort(item)

    def _sort(self, item: Envelope) -> bool:
        """Whether it is a permit, and believed."""
        if item.topic == PERMIT.name:
            return self.held.hear(item, self._ticked)
        self.waiting.append(item)
        return False

    def _tick(self, now: int) -> None:
        self._ticked = now
        self.clock.send(Clock(clock=stamp_of(now)), now)

    def _wait_for_word(self, now: int) -> bool:
        """Hold session time until the interlock has spoken for `now`; False where that takes too long."""
        if self._silence is None:
            self._silence = Stopwatch()
            if self._ticked != now:
                self._tick(now)
        while now >= self.held.until:
            late = self._silence.seconds
            self.lost = self.lost or late > self.context.cell.safety.patience
            if self.lost or self.context.stopping:
                return False
            if late > SLOW:
                self._tell_once()
                if self.pacer.rate is not None:
                    return False
            item = self.context.bus.inbox.receive(timeout=_LOOK)
            if isinstance(item, Envelope):
                self._sort(item)
        return True

    def _tell_once(self) -> None:
        if not self._told:
            does = "session time is held" if self.pacer.rate is None else "the arm stops"
            self.context.log(f"no fresh permit: {does}", logging.WARNING)
            self._told = True

    def _tell_of_its_end(self, silence: Stopwatch) -> None:
        if self._told:
            self.context.log(f"a fresh permit after {silence.seconds:.1f} s")
        self._silence, self._told = None, False

    def wait_for_first_permit(self) -> None:
        """Hold session time at its beginning until motion is permitted for the first time.

        That may take as long as the one who has to press reset; the interlock's first word must come within the cell's
        patience.
        """
        self._tick(self.context.clock.now)
        silence, heard = Stopwatch(), False
        while not (self.held.granted or self.lost or self.context.stopping):
            item = self.context.bus.inbox.receive(timeout=_LOOK)
            if isinstance(item, Envelope):
                heard = self._sort(item) or heard
            self.lost = not heard and silence.seconds > self.context.cell.safety.patience

    def wait_for_arrival(self) -> None:
        """Wait until something arrives, or the plugin is asked to end; session time stands still."""
        item = self.context.bus.inbox.receive()
        if isinstance(item, Envelope):
            self._sort(item)

    def check(self) -> None:
        """Raise SessionError once the interlock has fallen silent."""
        if self.lost:
            raise silent(self.context)


def silent(context: Context) -> SessionError:
    """What to say once no permit has come for the cell's patience."""
    patience = context.cell.safety.patience
    return SessionError(f"no permit within {patience:g} s: interlock or light curtain is silent; the arm is halted")
