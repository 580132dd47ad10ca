"""The light curtain as a plugin: session time and an operator's commands in, the state of its two outputs out."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field

from drivers.light_curtain.script import Event, Script, script_of
from runtime.bus import Envelope, Publisher, Request
from runtime.clock import Stopwatch
from runtime.context import Context
from runtime.errors import alternatives
from runtime.messages import (
    NANOSECONDS,
    CurtainState,
    EmergencyStop,
    Muting,
    Ossd,
    Reset,
    header,
    nanoseconds_of,
)
from runtime.topics import CLOCK, EMERGENCY_STOP, LIGHT_FIELD, MUTING, OSSD, RESET

ACTIONS = ("break", "clear", "reset", "state")
OPERATOR = "operator"  # source of a reset that somebody pressed


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

    Somebody can also reach in while the cell runs: `palpate curtain break`, then `clear` and `reset`. Nobody could
    vouch for that ahead of time. It is told at once, under the latest session time that the curtain has heard of, and
    takes effect in the next control cycle of the arm after the refusal has reached it: at rate 1.0 about when it
    happens; as fast as the machine allows, at whatever session time the arm has come to by then.
    """

    def run(self, context: Context) -> None:
        """Report the light field at every tick of session time and every command, and before it what has happened."""
        curtain = _Curtain(context, script_of(context.cell.safety))
        context.bus.subscribe(CLOCK)
        context.bus.serve(LIGHT_FIELD)
        context.ready()
        for item in context.arrivals():
            if isinstance(item, Envelope):
                curtain.tell(nanoseconds_of(item.read(CLOCK).clock))
            else:
                curtain.obey(item)


@dataclass
class _Curtain:
    """The curtain in a session, and the buttons and sensors beside it."""

    context: Context
    script: Script
    held: bool = False  # interrupted until a command clears it
    _last: int = -1  # [ns] session time of the last word
    _was_clear: bool = True
    _outputs: Publisher[Ossd] = field(init=False)
    _resets: Publisher[Reset] = field(init=False)
    _emergency_stops: Publisher[EmergencyStop] = field(init=False)
    _mutings: Publisher[Muting] = field(init=False)

    def __post_init__(self) -> None:
        bus = self.context.bus
        self._outputs, self._resets = bus.publisher(OSSD), bus.publisher(RESET)
        self._emergency_stops, self._mutings = bus.publisher(EMERGENCY_STOP), bus.publisher(MUTING)

    def tell(self, now: int) -> None:
        """Say how all is at session time `now` [ns]."""
        for at, event in self.script.said(self._last, now):
            self._publish(event, at)
        clear = not self.held and self.script.clear_at(now)
        if clear != self._was_clear:
            self.context.log(f"light field {'clear' if clear else 'interrupted'}", logging.WARNING)
            self._was_clear = clear
        self._outputs.send(self.script.word(now, self._last, broken=self.held), now)
        self._last = max(self._last, now)

    def _publish(self, event: Event, at: int) -> None:
        match event:
            case Reset():
                self._resets.send(event, at)
            case EmergencyStop():
                self._emergency_stops.send(event, at)
            case Muting():
                self._mutings.send(event, at)

    def obey(self, request: Request) -> None:
        """Do as an operator says, and answer once it is told."""
        heard = Stopwatch().started
        action, begun, now, error = request.read(LIGHT_FIELD).action, self._last >= 0, max(self._last, 0), ""
        match action:
            case "break" | "clear":
                self.held = action == "break"
                if begun:  # before, nobody may listen yet; the first tick tells
                    self.tell(now)
            case "reset" if begun:
                self._resets.send(Reset(header(now), OPERATOR), now)
            case "reset":
                error = "the session has not begun: there is nothing to reset yet"
            case "state":
                pass
            case _:
                error = f"the light curtain knows no {action!r}; {alternatives(action, ACTIONS)}"
        word = self.script.word(now, self._last, broken=self.held)
        request.reply(
            CurtainState(
                ok=not error,
                error=error,
                interrupted=self.held or not self.script.clear_at(now),
                held=self.held,
                channel_1=word.channel_1 or word.channel_1_off_time > 0,  # a test pulse switches nothing off
                channel_2=word.channel_2 or word.channel_2_off_time > 0,
                time=now / NANOSECONDS,
                heard=heard,
            )
        )
