"""A light curtain that does what a script says, in session time, and can therefore vouch for its near future."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from runtime.cell import Interruption
from runtime.messages import NANOSECONDS


@dataclass(frozen=True)
class Event:
    """One scripted change."""

    at: int  # session time [ns]
    clear: bool | None  # the field from here on; None: a press of the restart button


def events_of(interruptions: Sequence[Interruption]) -> list[Event]:
    """The changes that a list of interruptions amounts to, in order of time."""
    found = []
    for item in interruptions:
        broken = round(item.at * NANOSECONDS)
        clear = broken + round(item.clear_after * NANOSECONDS)
        found += [Event(broken, False), Event(clear, True), Event(clear + round(item.reset_after * NANOSECONDS), None)]
    return sorted(found, key=lambda event: event.at)


@dataclass(frozen=True)
class Script:
    """The scripted state of the light field."""

    events: Sequence[Event]
    horizon: int  # [ns] the curtain vouches for no longer than this

    def clear_at(self, now: int) -> bool:
        """Whether the field is clear at session time `now` [ns]."""
        states = [event.clear for event in self.events if event.clear is not None and event.at <= now]
        return states[-1] if states else True

    def valid_until(self, now: int) -> int:
        """Until when [ns] the state of `now` holds: the next event, or the horizon."""
        return min([now + self.horizon, *(event.at for event in self.events if event.at > now)])

    def resets(self, after: int, until: int) -> list[int]:
        """Presses of the restart button in the interval (after, until] [ns]."""
        return [event.at for event in self.events if event.clear is None and after < event.at <= until]
