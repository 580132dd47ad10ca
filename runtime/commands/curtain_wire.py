"""The wire from a cell's light curtain to a simulated controller's safeguard input, as there is one to a real arm's.

The cell may come and go: the curtain is looked for again and again. Where no cell runs there is no curtain, and the
input is closed.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

from runtime.bus import Envelope
from runtime.clock import Stopwatch
from runtime.errors import BusError, InputError
from runtime.network.access import GUEST
from runtime.network.admission import Admission
from runtime.network.meeting_point import MeetingPoint
from runtime.network.zenoh_bus import ZenohBus
from runtime.safety.interlock import Times
from runtime.topics import OSSD

_RETRY = 0.5  # [s] between looks for a cell
_SILENCE = 3.0  # [s] without a word from the curtain until its cell counts as gone


class CurtainWire:
    """Listens for the curtain in a thread of its own and says `open` or `close` when the light field changes."""

    def __init__(self, point: MeetingPoint, say: Callable[[str], None]) -> None:
        self._point, self._say = point, say
        self._open = False
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="curtain", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Listen no more."""
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._stop.wait(_RETRY):
            try:
                with ZenohBus(GUEST, self._point, patience=1.0) as bus:
                    admission = Admission(_unheard)
                    bus.inbox.admit_by(admission, admission.refuse)
                    bus.subscribe(OSSD)
                    self._listen(bus)
            except (BusError, InputError):  # keys may come as the cell does
                continue
            finally:
                self._set(False)

    def _listen(self, bus: ZenohBus) -> None:
        """Follow the curtain until it falls silent."""
        silence = Stopwatch()
        while not self._stop.is_set() and silence.seconds < _SILENCE:
            item = bus.inbox.receive(0.1)
            if isinstance(item, Envelope):
                silence = Stopwatch()
                outputs = item.read(OSSD)
                self._set(
                    _is_off(outputs.channel_1, outputs.channel_1_off_time)
                    or _is_off(outputs.channel_2, outputs.channel_2_off_time)
                )

    def _set(self, is_open: bool) -> None:
        if is_open != self._open:
            self._open = is_open
            self._say("safeguard open" if is_open else "safeguard close")


def _is_off(on: bool, off_time: int) -> bool:
    """Whether an output is off and not just in a test pulse [ns], which a safeguard input passes over."""
    return not on and not 0 < off_time <= Times.filter_time


def _unheard(_text: str) -> None:
    """Nobody reads what this wire has to say."""
