"""How far a player is and what it has been told: no clock, no file, no bus.

The player asks before each message whether it goes out, and at which session time to go on after a jump. Commands come
from the keyboard and as requests to /player/control, and take the same way.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from runtime.clock import MAX_RATE, RATES, parse_rate
from runtime.errors import InputError, alternatives
from runtime.messages import NANOSECONDS, PlayerCommand, PlayerState

ACTIONS = {
    "pause": "hold the next message back",
    "resume": "go on",
    "toggle": "pause or resume",
    "step": "send one message, or VALUE of them, while paused",
    "seek": "go to VALUE seconds after the beginning of the log",
    "skip": "go VALUE seconds on, or back if VALUE is negative",
    "rate": "play at VALUE times the recorded speed, or max",
    "scale": "multiply the rate by VALUE",
    "state": "change nothing, and tell how far it is",
    "quit": "end",
}
_NEEDS_VALUE = frozenset({"seek", "skip", "rate", "scale"})
_MOST_STEPS = 1_000_000


def command(action: str, value: str | None = None) -> PlayerCommand:
    """A command from words. Raises InputError for one that no player understands."""
    if action not in ACTIONS:
        raise _unknown(action)
    if value is None:
        if action in _NEEDS_VALUE:
            raise InputError(f"{action} needs a VALUE: {ACTIONS[action]}")
        return PlayerCommand(action, 0.0)
    if action not in _NEEDS_VALUE | {"step"}:
        raise InputError(f"{action} takes no value, and was given {value!r}")
    if action == "rate":
        return PlayerCommand(action, _number(parse_rate(value)))
    try:
        return PlayerCommand(action, float(value))
    except ValueError:
        raise InputError(f"{action} {value!r}: the value is no number") from None


def _number(rate: float | None) -> float:
    """A rate as messages carry it."""
    return math.inf if rate is None else rate


@dataclass
class Playback:
    """A pass through the messages of a log with start <= stamp < until. Session times in ns."""

    begin: int  # of the log: what seconds in commands and states count from
    end: int  # of the log
    start: int  # of what is played
    until: int
    rate: float | None = 1.0  # None: as fast as receivers take it
    paused: bool = False
    loop: bool = False
    sent: int = 0  # messages
    steps: int = 0  # messages that go out although it is paused
    target: int | None = None  # where to go on instead
    quitting: bool = False
    position: int = field(init=False)  # session time that is reached

    def __post_init__(self) -> None:
        self.position = self.start

    @property
    def diverted(self) -> bool:
        """Whether the next message is not the one that follows in the log."""
        return self.quitting or self.target is not None

    def releases(self, stamp: int, now: int) -> bool:
        """Whether the next message, of this stamp, goes out when the time due is `now`. Takes note of how far it is."""
        if self.diverted:
            return False
        if self.paused:
            if not self.steps:
                return False
            self.steps -= 1
            self.position = stamp
            return True
        self.position = max(self.position, min(now, stamp))
        return now >= stamp

    def jump(self) -> int:
        """Begin a pass: where a command said, or at the start. Returns the session time [ns]."""
        self.position = self.start if self.target is None else self.target
        self.target = None
        return self.position

    def finish(self, barren: bool) -> None:
        """The end was reached. `barren`: from the start to the end there was no message."""
        if self.loop and not barren:
            self.target = self.start
        else:
            self.position = max(self.position, min(self.until, self.end))
            self.quitting = True

    def obey(self, given: PlayerCommand) -> None:
        """Carry a command out. Raises InputError for what cannot be done, and has then changed nothing."""
        doings: dict[str, Callable[[float], None]] = {
            "pause": lambda _: self._pause(),
            "resume": lambda _: self._resume(),
            "toggle": lambda _: self._resume() if self.paused else self._pause(),
            "step": self._step,
            "seek": self._seek,
            "skip": self._skip,
            "rate": self._set_rate,
            "scale": self._scale,
            "state": lambda _: None,
            "quit": lambda _: self._quit(),
        }
        if given.action not in doings:
            raise _unknown(given.action)
        doings[given.action](given.value)

    def state(self, now: int) -> PlayerState:
        """What a command is answered with, when session time `now` [ns] is reached."""
        time, duration = self._seconds(now), self._seconds(self.end)
        return PlayerState(True, "", self.paused, time, duration, _number(self.rate), self.sent)

    def _pause(self) -> None:
        self.paused = True

    def _resume(self) -> None:
        self.paused, self.steps = False, 0

    def _quit(self) -> None:
        self.quitting = True

    def _step(self, value: float) -> None:
        count = value or 1
        if not 1 <= count <= _MOST_STEPS or count != round(count):
            raise InputError(f"step {value:g}: the value is no number of messages from 1 to {_MOST_STEPS}")
        if not self.paused:
            raise InputError("a step needs a pause before it")
        self.steps += round(count)

    def _seek(self, value: float) -> None:
        first, last = (self._seconds(each) for each in (self.start, self.until - 1))
        # A state tells its time in seconds that were rounded: what it told can be sought again.
        if not first - 1e-6 <= value <= last + 1e-6:
            raise InputError(f"seek {value:g} is outside of what is played, {first:.3f} to {last:.3f} s")
        self._go_on_at(self.begin + round(value * NANOSECONDS))

    def _skip(self, value: float) -> None:
        if not math.isfinite(value):
            raise InputError(f"skip {value}: the value is no number of seconds")
        reached = self.position if self.target is None else self.target
        self._go_on_at(reached + round(value * NANOSECONDS))

    def _go_on_at(self, stamp: int) -> None:
        self.target, self.steps = min(max(stamp, self.start), self.until - 1), 0

    def _set_rate(self, value: float) -> None:
        if value != math.inf and not RATES[0] <= value <= RATES[1]:
            raise InputError(f"rate {value:g} is neither {MAX_RATE} nor a number from {RATES[0]:g} to {RATES[1]:g}")
        self.rate = None if value == math.inf else value

    def _scale(self, value: float) -> None:
        if self.rate is None:
            raise InputError(f"rate {MAX_RATE} cannot be scaled; set it with rate")
        self._set_rate(self.rate * value if math.isfinite(value) else math.nan)

    def _seconds(self, stamp: int) -> float:
        """[s] after the beginning of the log."""
        return (stamp - self.begin) / NANOSECONDS


def _unknown(action: str) -> InputError:
    return InputError(f"a player cannot {action!r}; {alternatives(action, ACTIONS)}")
