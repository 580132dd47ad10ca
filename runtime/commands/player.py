"""palpate player: tell a running `palpate replay` what to do."""

from __future__ import annotations

import argparse
import math

from rich.console import Console

from runtime.clock import MAX_RATE
from runtime.commands.operator import asked
from runtime.config import meeting_point
from runtime.errors import InputError
from runtime.messages import PlayerState
from runtime.playback.state import command
from runtime.topics import PLAYER_CONTROL

_ANSWER = 70.0  # [s] for a player to: a slow receiver may hold it up for a minute


def player_command(arguments: argparse.Namespace) -> int:
    """Send one command and print how far the player is then. Raises InputError for one that it refuses."""
    given = command(arguments.action, arguments.value)
    point = meeting_point(arguments.cell, arguments.port)
    absent = f"nothing is played on port {point.port}: no `palpate replay LOG --port {point.port}` answers"
    state = asked(point, PLAYER_CONTROL, given, absent, _ANSWER)
    if not state.ok:
        raise InputError(state.error)
    Console().print(state_line(state), highlight=False)
    return 0


def state_line(state: PlayerState) -> str:
    """A player's state as people read it."""
    rate = MAX_RATE if math.isinf(state.rate) else f"{state.rate:g}"
    return (
        f"{'paused' if state.paused else 'playing'}  {state.time:.2f} s of {state.duration:.2f} s  "
        f"rate {rate}  {state.sent} messages"
    )
