"""palpate curtain: reach into the simulated light curtain of a running cell, step back, press reset."""

from __future__ import annotations

import argparse

from rich.console import Console

from runtime.config import meeting_point
from runtime.errors import BusError, InputError
from runtime.messages import CurtainCommand, CurtainState
from runtime.network.access import OPERATOR
from runtime.network.zenoh_bus import ZenohBus
from runtime.topics import LIGHT_FIELD

_PATIENCE = 3.0  # [s] for a router to answer
_ANSWER = 10.0  # [s] for a curtain to


def curtain_command(arguments: argparse.Namespace) -> int:
    """Do one thing and print how the curtain is then. Raises BusError if no cell runs there."""
    point = meeting_point(arguments.cell, arguments.port)
    try:
        with ZenohBus(OPERATOR, point, patience=_PATIENCE) as bus:
            state = bus.request(LIGHT_FIELD, CurtainCommand(arguments.action), _ANSWER)
    except BusError:
        raise BusError(f"no light curtain answers on {point}; is 'palpate launch' there?") from None
    if not state.ok:
        raise InputError(state.error)
    Console().print(state_line(state), highlight=False, soft_wrap=True)
    return 0


def state_line(state: CurtainState) -> str:
    """A curtain's state as people read it."""
    light = "interrupted" if state.interrupted else "clear"
    held = " until 'palpate curtain clear'" if state.held else ""
    outputs = " and ".join("on" if on else "off" for on in (state.channel_1, state.channel_2))
    return f"light field {light}{held}, outputs {outputs}, {state.time:.2f} s of session time"
