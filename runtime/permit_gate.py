"""The arm's side of the interlock: no fresh permit, no motion.

The simulation runs in lockstep with the interlock. Every word from the interlock holds for a stretch of session time;
the gate announces session time on /clock, and holds simulated time back rather than run past the last word. A curtain
that can vouch for its near future lets the simulation run far ahead of the messages, and still stop in the very cycle
in which the beam breaks.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

from runtime.bus import Envelope, Publisher
from runtime.clock import Pacer, Stopwatch
from runtime.context import Context
from runtime.errors import SessionError
from runtime.messages import Clock, Permit, nanoseconds_of, stamp_of
from runtime.topics import PERMIT

TICK = 80_000_000  # [ns] of session time between ticks of /clock: the default permit outlasts two of them
PATIENCE = 15.0  # [s] of machine time without a word until the interlock counts as lost; a busy machine is just slow


@dataclass
class PermitGate:
    """Decides cycle by cycle whether the arm may move, and keeps what else arrives meanwhile."""

    context: Context
    clock: Publisher[Clock]
    pacer: Pacer
    waiting: deque[Envelope] = field(default_factory=deque)  # arrivals that are not for the gate
    lost: bool = False  # the interlock has fallen silent
    _word: Permit | None = None
    _granted: bool = False
    _until: int = -1  # [ns]
    _ticked: int = -TICK  # [ns]

    def __call__(self, now: int) -> bool:
        """Whether the arm may move in the cycle that begins at session time `now` [ns]. Blocks until that is known."""
        self.context.clock.advance(now)
        if now - self._ticked >= TICK:
            self._tick(now)
            self.pacer.wait_until(now)
        if len(self.context.bus.inbox):
            self.take_arrivals()
        if now >= self._until and not self._wait_for_word(now):
            return False
        return self._granted and not self.context.stopping

    def take_arrivals(self) -> None:
        """Sort what has arrived into permits and the rest."""
        while (item := self.context.bus.inbox.poll()) is not None:
            if isinstance(item, Envelope):
                self._sort(item)

    def _sort(self, item: Envelope) -> None:
        if item.topic == PERMIT.name:
            self._word = item.read(PERMIT)
            self._granted = self._word.granted
            self._until = nanoseconds_of(self._word.valid_until)
        else:
            self.waiting.append(item)

    def _tick(self, now: int) -> None:
        self._ticked = now
        self.clock.send(Clock(clock=stamp_of(now)), now)

    def _wait_for_word(self, now: int) -> bool:
        """Hold session time until the interlock has spoken for `now`; False if it is silent or the cell is closing."""
        if self._ticked != now:
            self._tick(now)
        silence = Stopwatch()
        while now >= self._until and not self.lost:
            if self.context.stopping:
                return False
            item = self.context.bus.inbox.receive(timeout=1.0)
            if isinstance(item, Envelope):
                self._sort(item)
            self.lost = silence.seconds > PATIENCE
        return not self.lost

    def wait_for_first_permit(self) -> None:
        """Hold session time at its beginning until motion is permitted for the first time."""
        self._tick(self.context.clock.now)
        while not self._granted and not self.context.stopping:
            self.wait_for_arrival()

    def wait_for_arrival(self) -> None:
        """Wait until something arrives, or the plugin is asked to end; session time stands still."""
        item = self.context.bus.inbox.receive()
        if isinstance(item, Envelope):
            self._sort(item)

    def check(self) -> None:
        """Raise SessionError once the interlock has fallen silent."""
        if self.lost:
            raise SessionError(f"no word from the interlock within {PATIENCE:g} s: the arm is halted")
