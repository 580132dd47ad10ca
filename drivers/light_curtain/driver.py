"""The light curtain as a plugin: session time in, the state of its two outputs out."""

from __future__ import annotations

import logging
from dataclasses import dataclass

from drivers.light_curtain.script import Script, events_of
from runtime.bus import Envelope
from runtime.context import Context
from runtime.messages import NANOSECONDS, Ossd, Reset, header, nanoseconds_of, stamp_of
from runtime.topics import CLOCK, OSSD, RESET


@dataclass(frozen=True)
class LightCurtain:
    """Simulated light curtain with two OSSD channels; breaks when the cell file's safety.interruptions say so."""

    def run(self, context: Context) -> None:
        """Report the light field at every tick of session time."""
        safety = context.cell.safety
        script = Script(events_of(safety.interruptions), round(safety.deadline * NANOSECONDS))
        outputs = context.bus.publisher(OSSD)
        resets = context.bus.publisher(RESET)
        context.bus.subscribe(CLOCK)
        context.ready()
        last = -1
        was_clear = True
        for item in context.arrivals():
            if not isinstance(item, Envelope):
                continue
            now = nanoseconds_of(item.read(CLOCK).clock)
            for at in script.resets(last, now):
                resets.send(Reset(header(at), "light_curtain script"), at)
            clear = script.clear_at(now)
            if clear != was_clear:
                context.log(f"light field {'clear' if clear else 'interrupted'}", logging.WARNING)
                was_clear = clear
            outputs.send(Ossd(header(now), clear, clear, stamp_of(script.valid_until(now))), now)
            last = max(last, now)
