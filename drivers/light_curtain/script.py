"""A light curtain, and the buttons and sensors beside it, that do what a cell file says, in session time.

Since it is known what happens, the curtain can vouch for its near future: up to the next scripted change.
"""

from __future__ import annotations

from dataclasses import dataclass

from drivers.light_curtain.output import PULSE_OFFSET, PULSE_PERIOD, Output
from drivers.light_curtain.spans import Span, holds, spans_where
from runtime.cell import Safety
from runtime.messages import NANOSECONDS, EmergencyStop, Muting, Ossd, Reset, ResetEdge, header, stamp_of

SCRIPT = "light_curtain script"  # source of what it presses

Event = Reset | EmergencyStop | Muting


@dataclass(frozen=True)
class Script:
    """What happens in a session."""

    horizon: int  # [ns] the curtain vouches for no longer than this
    moments: tuple[int, ...]  # [ns] of all changes, in order
    broken: tuple[Span, ...]  # in which the light field is interrupted
    outputs: tuple[Output, Output]
    events: tuple[tuple[int, Event], ...]  # moment [ns] and what is then said, in order

    def clear_at(self, now: int) -> bool:
        """Whether the light field is clear at session time `now` [ns]."""
        return not holds(self.broken, now)

    def word(self, now: int, before: int, *, broken: bool = False) -> Ossd:
        """What the curtain says at session time `now` [ns], having spoken last at `before` [ns].

        `broken`: somebody holds the light field interrupted, whatever the script says.
        """
        first, second = (output.level(now, before, broken=broken) for output in self.outputs)
        return Ossd(
            header(now),
            first.on,
            second.on,
            stamp_of(self.valid_until(now)),
            channel_1_off_time=first.off_time,
            channel_2_off_time=second.off_time,
            channel_1_tested=stamp_of(first.tested),
            channel_2_tested=stamp_of(second.tested),
        )

    def valid_until(self, now: int) -> int:
        """Until when [ns] the state of `now` holds, test pulses to come apart: the next change, or the horizon."""
        pulses = [end for output in self.outputs if (end := output.pulse_ends(now)) is not None]
        return min([now + self.horizon, *pulses, *(moment for moment in self.moments if moment > now)])

    def said(self, after: int, until: int) -> list[tuple[int, Event]]:
        """What buttons and muting sensors say in the interval (after, until] [ns], each with its moment."""
        return [(moment, event) for moment, event in self.events if after < moment <= until]


def script_of(safety: Safety) -> Script:
    """The script in a cell's safety settings."""
    broken = tuple(_span(item.at, item.clear_after) for item in safety.interruptions)
    pressed = tuple(_span(item.at, item.release_after) for item in safety.emergency_stops)
    sensors = (
        tuple(_span(item.at, item.lasts) for item in safety.mutings),
        tuple(_span(item.at + item.second_after, item.lasts) for item in safety.mutings),
    )
    faults = {item: _span(item.at, item.ends_after) for item in safety.curtain_faults}
    resets = _resets(safety)
    moments = sorted(
        {moment for spans in (broken, pressed, *sensors, faults.values()) for span in spans for moment in span}
        | {moment for moment, _ in resets}
    )

    def output(number: int) -> Output:
        stuck = [span for item, span in faults.items() if item.kind == f"channel_{number}_stuck"]
        cut = [span for item, span in faults.items() if item.kind == f"channel_{number}_off"]

        def is_off(now: int) -> bool:
            return not holds(stuck, now) and (holds(broken, now) or holds(cut, now))

        off = spans_where(is_off, moments)
        untested = spans_where(lambda now: holds(stuck, now) or holds(off, now), moments)
        return Output(off, untested, phase=PULSE_PERIOD * (2 * number - 1) // 4 + PULSE_OFFSET)

    events = [*resets, *_emergency_stops(pressed, moments), *_mutings(sensors, moments)]
    return Script(
        horizon=_ns(safety.deadline),
        moments=tuple(moments),
        broken=broken,
        outputs=(output(1), output(2)),
        events=tuple(sorted(events, key=lambda item: item[0])),
    )


def _span(at: float, lasts: float) -> Span:
    return _ns(at), _ns(at) + _ns(lasts)


def _ns(seconds: float) -> int:
    return round(seconds * NANOSECONDS)


def _resets(safety: Safety) -> list[tuple[int, Event]]:
    """Presses of the reset button: those that follow what stops the arm, and those that the script wants."""
    whole = [_span(item.at, item.clear_after)[1] + _ns(item.reset_after) for item in safety.interruptions]
    whole += [_span(item.at, item.release_after)[1] + _ns(item.reset_after) for item in safety.emergency_stops]
    for fault in safety.curtain_faults:
        whole += [_span(fault.at, fault.ends_after)[1] + times * _ns(fault.reset_after) for times in (1, 2)]
    edges = [(moment, ResetEdge.PRESSED_AND_RELEASED) for moment in whole]
    for press in safety.resets:
        begin, end = _span(press.at, press.held)
        edges += [(begin, ResetEdge.PRESSED), (end, ResetEdge.RELEASED)]
    return [(moment, Reset(header(moment), SCRIPT, edge)) for moment, edge in edges]


def _emergency_stops(pressed: tuple[Span, ...], moments: list[int]) -> list[tuple[int, Event]]:
    return [
        (moment, EmergencyStop(header(moment), SCRIPT, is_pressed))
        for begin, end in spans_where(lambda now: holds(pressed, now), moments)
        for moment, is_pressed in ((begin, True), (end, False))
    ]


def _mutings(sensors: tuple[tuple[Span, ...], tuple[Span, ...]], moments: list[int]) -> list[tuple[int, Event]]:
    said: list[tuple[int, Event]] = []
    before = (False, False)
    for moment in moments:
        now = holds(sensors[0], moment), holds(sensors[1], moment)
        if now != before:
            said.append((moment, Muting(header(moment), *now)))
            before = now
    return said
