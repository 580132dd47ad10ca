"""The light curtain as a plugin: session time in, the state of its two outputs out."""

from __future__ import annotations

import logging
from dataclasses import dataclass

from drivers.light_curtain.script import script_of
from runtime.bus import Envelope
from runtime.context import Context
from runtime.messages import EmergencyStop, Muting, Reset, nanoseconds_of
from runtime.topics import CLOCK, EMERGENCY_STOP, MUTING, OSSD, RESET


@dataclass(frozen=True)
class LightCurtain:
    """Simulated light curtain with two OSSD channels and their test pulses, and what stands beside it.

    What happens is scripted in the cell file's [safety], at moments of session time:

        interruptions = [{ at = "12 s", clear_after = "2 s", reset_after = "1 s" }]
        curtain_faults = [{ at = "20 s", kind = "channel_1_stuck" }]  # or channel_2_stuck, channel_1_off, channel_2_off
        emergency_stops = [{ at = "30 s", release_after = "2 s", reset_after = "1 s" }]
        mutings = [{ at = "40 s", second_after = "0.5 s", lasts = "4 s" }]
        resets = [{ at = "50 s", held = "0.2 s" }]  # held too long or pressed too early, it is none

    Muting shows together with an interruption while it lasts: the arm goes on. A reset shows with an interruption or an
    emergency stop whose own comes later.
    """

    def run(self, context: Context) -> None:
        """Report the light field at every tick of session time, and before it what else has happened."""
        script = script_of(context.cell.safety)
        outputs = context.bus.publisher(OSSD)
        resets = context.bus.publisher(RESET)
        emergency_stops = context.bus.publisher(EMERGENCY_STOP)
        mutings = context.bus.publisher(MUTING)
        context.bus.subscribe(CLOCK)
        context.ready()
        last = -1
        was_clear = True
        for item in context.arrivals():
            if not isinstance(item, Envelope):
                continue
            now = nanoseconds_of(item.read(CLOCK).clock)
            for at, event in script.said(last, now):
                match event:
                    case Reset():
                        resets.send(event, at)
                    case EmergencyStop():
                        emergency_stops.send(event, at)
                    case Muting():
                        mutings.send(event, at)
            clear = script.clear_at(now)
            if clear != was_clear:
                context.log(f"light field {'clear' if clear else 'interrupted'}", logging.WARNING)
                was_clear = clear
            outputs.send(script.word(now, last), now)
            last = max(last, now)
