"""One output signal switching device of the simulated curtain, with the test pulses that real ones send.

A curtain switches each output off for a moment, in turn, to see that it still can: every 40 ms for at most 0.3 ms is
what data sheets of safety laser scanners and light curtains state.
"""

from __future__ import annotations

from dataclasses import dataclass

from drivers.light_curtain.spans import Span, holds

PULSE_PERIOD = 40_000_000  # [ns]
PULSE_WIDTH = 300_000  # [ns]
PULSE_OFFSET = 1_000_000  # [ns] against control cycles of 2 ms, so that the curtain hardly ever speaks during a pulse


@dataclass(frozen=True)
class Level:
    """What a safety input sees of an output at a moment."""

    on: bool
    off_time: int  # [ns] length so far of the pulse it is in, or the longest it was off since the look before; or 0
    tested: int  # [ns] session time at which it was last seen off; 0: never


@dataclass(frozen=True)
class Output:
    """An output over the whole session."""

    off: tuple[Span, ...]  # switched off
    untested: tuple[Span, ...]  # no test pulses: switched off, or stuck
    phase: int  # [ns] of its test pulses

    def level(self, now: int, before: int, *, broken: bool = False) -> Level:
        """Its level at session time `now` [ns], to somebody who looked last at `before` [ns].

        `broken`: the light field is interrupted now, whatever was foreseen. An output that is stuck stays on.
        """
        if holds(self.off, now) or (broken and not holds(self.untested, now)):
            return Level(False, 0, now)
        pulse = self._pulse_up_to(now)
        if pulse is not None and now < pulse[1]:
            return Level(False, max(1, now - pulse[0]), now)
        ended = [span for span in self.off if span[1] <= now] + ([] if pulse is None else [pulse])
        return Level(
            True,
            max((end - begin for begin, end in ended if end > before), default=0),
            max((end for _, end in ended), default=0),
        )

    def pulse_ends(self, now: int) -> int | None:
        """When [ns] the test pulse ends that it is in."""
        pulse = self._pulse_up_to(now)
        return pulse[1] if pulse is not None and now < pulse[1] else None

    def _pulse_up_to(self, now: int) -> Span | None:
        """The last test pulse that begins up to `now`."""
        number = (now - self.phase) // PULSE_PERIOD
        while number >= 0:
            begin = self.phase + number * PULSE_PERIOD
            pulse = (begin, begin + PULSE_WIDTH)
            prevented = [span for span in self.untested if span[0] < pulse[1] and begin < span[1]]
            if not prevented:
                return pulse
            number = min(number - 1, (prevented[0][0] - self.phase) // PULSE_PERIOD)
        return None
