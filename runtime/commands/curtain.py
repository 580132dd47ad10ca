"""palpate curtain: reach into the simulated light curtain of a running cell, step back, press reset."""

from __future__ import annotations

import argparse

from rich.console import Console

from runtime.commands.operator import asked
from runtime.config import meeting_point
from runtime.errors import InputError
from runtime.messages import CurtainCommand, CurtainState
from runtime.topics import LIGHT_FIELD


def curtain_command(arguments: argparse.Namespace) -> int:
    """Do one thing and print how the curtain is then. Raises BusError if no cell runs there."""
    point = meeting_point(arguments.cell, arguments.port)
    absent = f"no light curtain answers on {point}; is 'palpate launch' there?"
    state = asked(point, LIGHT_FIELD, CurtainCommand(arguments.action), absent)
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
