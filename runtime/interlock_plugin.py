"""The interlock as a plugin: the curtain's outputs and resets in, permits out."""

from __future__ import annotations

import logging
from dataclasses import dataclass

from runtime.bus import Envelope
from runtime.context import Context
from runtime.interlock import Interlock
from runtime.messages import NANOSECONDS, Ossd, Permit, header, nanoseconds_of, stamp_of
from runtime.topics import OSSD, PERMIT, RESET


@dataclass(frozen=True)
class InterlockPlugin:
    """Grants and withdraws the permit to move."""

    def run(self, context: Context) -> None:
        """Answer every word of the curtain with a permit or its refusal."""
        safety = context.cell.safety
        deadline = round(safety.deadline * NANOSECONDS)
        permits = context.bus.publisher(PERMIT)
        context.bus.subscribe(OSSD, RESET)
        context.ready()
        interlock = Interlock(discrepancy=round(safety.discrepancy * NANOSECONDS))
        heard: Ossd | None = None
        for item in context.arrivals():
            if not isinstance(item, Envelope):
                continue
            before = interlock
            if item.topic == OSSD.name:
                heard = item.read(OSSD)
                interlock = interlock.on_ossd(heard.channel_1, heard.channel_2, nanoseconds_of(heard.header.stamp))
            else:
                interlock = interlock.on_reset()
                if interlock == before:
                    context.log(f"reset did nothing: {interlock.reason}", logging.WARNING)
            if heard is None:
                continue
            if interlock.state is not before.state:
                context.log(f"interlock {interlock.state.name.lower()}: {interlock.reason}", _level(interlock))
            since = nanoseconds_of(heard.header.stamp)
            until = min(nanoseconds_of(heard.valid_until), since + deadline)
            permits.send(
                Permit(header(since), interlock.permits, interlock.state, interlock.reason, stamp_of(until)),
                context.clock.now,
            )


def _level(interlock: Interlock) -> int:
    return logging.INFO if interlock.permits else logging.WARNING
