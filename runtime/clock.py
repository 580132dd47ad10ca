"""Session time. The only file that reads or sleeps on the machine's clock.

In simulation the arm's controller is the source of session time, and every other plugin's clock is the latest stamp
that reached it: a decision takes no session time, so it cannot depend on how fast the machine was.
"""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, field

from runtime.errors import InputError
from runtime.messages import NANOSECONDS

MAX_RATE = "max"
RATES = (0.01, 1000.0)  # least and greatest number that a rate can be
_OVERDUE = 0.5  # [s] later than that all stood still (a person, a debugger): do not rush to catch up
_TOO_SHORT = 2e-4  # [s] that is not worth a wait


@dataclass
class SessionClock:
    """The latest session time a plugin knows of [ns]."""

    now: int = 0

    def advance(self, stamp: int) -> None:
        """Take note of a stamp; earlier ones change nothing."""
        self.now = max(self.now, stamp)


def parse_rate(text: str) -> float | None:
    """Session seconds per second; None for as fast as the machine allows."""
    if text == MAX_RATE:
        return None
    try:
        rate = float(text)
    except ValueError:
        rate = 0.0
    if not RATES[0] <= rate <= RATES[1]:
        raise InputError(
            f"rate {text!r} is neither 'max' nor a number from {RATES[0]:g} to {RATES[1]:g} (1.0 is real time)"
        )
    return rate


@dataclass
class Pacer:
    """Holds simulated or replayed time back to `rate` times real time. None: never waits."""

    rate: float | None
    halt: threading.Event = field(default_factory=threading.Event)  # ends every wait
    _started: float | None = None  # [s] machine time at session time `_origin`
    _origin: int = 0  # [ns]

    def begin(self, stamp: int) -> None:
        """Let session time `stamp` [ns] be due now."""
        self._started, self._origin = time.monotonic(), stamp

    def change(self, rate: float | None, stamp: int) -> None:
        """Go on from session time `stamp` [ns] at another rate."""
        self.rate = rate
        self.begin(stamp)

    @property
    def now(self) -> int:
        """Session time that is due now [ns]; without a rate, the one that was last due."""
        if self.rate is None or self._started is None:
            return self._origin
        return self._origin + round((time.monotonic() - self._started) * self.rate * NANOSECONDS)

    def left(self, stamp: int) -> float:
        """Machine time until session time `stamp` [ns] is due [s]; 0 if it is. Does not wait."""
        if self.rate is None or self._started is None:
            self.begin(stamp)
            return 0.0
        ahead = self._started + (stamp - self._origin) / NANOSECONDS / self.rate - time.monotonic()
        if ahead < -_OVERDUE:
            self.begin(stamp)
        return ahead if ahead > _TOO_SHORT else 0.0

    def wait_until(self, stamp: int) -> bool:
        """Wait until session time `stamp` [ns] is due; False if halted."""
        ahead = self.left(stamp)
        if ahead:
            self.halt.wait(ahead)
        return not self.halt.is_set()


@dataclass
class Metronome:
    """Beats with a fixed period of machine time, for a loop that has to keep it."""

    period: float  # [s]
    _due: float | None = None  # [s] machine time of the next beat

    def wait(self) -> float:
        """Wait for the next beat; tells by how much [s] the loop was late for it, 0 if it was in time.

        A loop that is a little late catches up; one that stood still for long goes on from now.
        """
        now = time.perf_counter()
        due = now if self._due is None else self._due
        self._due = due + self.period
        if due > now:
            time.sleep(due - now)
            return 0.0
        if now - due > _OVERDUE:
            self._due = now + self.period
        return now - due

    def restart(self) -> None:
        """Let the next beat be now."""
        self._due = None

    @property
    def left(self) -> float:
        """[s] until the next beat."""
        return 0.0 if self._due is None else self._due - time.perf_counter()


@dataclass(frozen=True)
class Stopwatch:
    """Machine time since creation, for what is reported and never decided on."""

    started: float = field(default_factory=time.perf_counter)

    @property
    def seconds(self) -> float:
        """Elapsed machine time [s]."""
        return time.perf_counter() - self.started


def pause(seconds: float) -> None:
    """Do nothing for a while of machine time."""
    time.sleep(seconds)


def wall_clock() -> str:
    """Local date and time as a sortable name, `20261122-151233`."""
    return time.strftime("%Y%m%d-%H%M%S")


def wall_nanoseconds() -> int:
    """Machine time since 1970 [ns]."""
    return time.time_ns()
