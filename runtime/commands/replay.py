"""palpate replay: publish a recorded session on Zenoh again, with the timing it was recorded with."""

from __future__ import annotations

import argparse
import contextlib
import sys

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from runtime.bus import Inbox, Request, encode
from runtime.clock import parse_rate
from runtime.commands.player import state_line
from runtime.commands.recheck import recheck_command
from runtime.commands.what_if import what_if_command
from runtime.config import meeting_point
from runtime.errors import InputError
from runtime.log.file import open_log
from runtime.network.access import PLAYER
from runtime.network.zenoh_bus import ZenohBus, ZenohRouter
from runtime.playback.keys import HELP, command_of, keys_of
from runtime.playback.playlist import Selection, parse_remap, playlist
from runtime.player import Manner, Player, PlaySummary
from runtime.topics import PLAYER_CONTROL

_WAITING = "waiting for somebody to listen to {}"
_REFRESH = 8.0  # [Hz] of the status line


def replay_command(arguments: argparse.Namespace) -> int:
    """Play a log and print what was sent. Raises LogError at the end of a log that is cut short."""
    if arguments.check or arguments.what_if is not None:
        return recheck_command(arguments) if arguments.check else what_if_command(arguments)
    return _play(arguments)


def _play(arguments: argparse.Namespace) -> int:
    selection = Selection(
        arguments.topics or (),
        arguments.exclude or (),
        parse_remap(arguments.remap or ()),
        arguments.start,
        arguments.end,
        arguments.wait,
    )
    manner = Manner(parse_rate(arguments.rate), arguments.loop, arguments.paused, arguments.clock, arguments.delay)
    console = Console()
    point = meeting_point(arguments.cell, arguments.port)
    if arguments.join and point.keys is not None:
        raise InputError("a cell with security lets only its own plugins speak; play the log without --join")
    with contextlib.ExitStack() as stack:
        log = stack.enter_context(open_log(arguments.log))
        what = playlist(log, selection, clock=manner.clock is not None)  # what is wrong is said before anything opens
        if not arguments.join:
            stack.enter_context(ZenohRouter(point, playback=True))
        bus = stack.enter_context(ZenohBus(PLAYER, point))
        player = Player(log, bus, what, manner)
        console.print(f"publishing {log.path.name} on {point.endpoint(point.host)}", highlight=False)
        if player.waiting_for:
            console.print(_WAITING.format(player.waiting_for), highlight=False)
        interrupted = _run(player, bus.inbox, console)
    sum_up(player.summary, console)
    if interrupted:
        raise KeyboardInterrupt
    log.check_complete("everything that it holds was published")
    return 0


def _run(player: Player, inbox: Inbox, console: Console) -> bool:
    """Play, led by the keyboard and with a status line if there is a terminal. Tells whether Ctrl-C ended it."""

    def press(key: str) -> None:
        command = command_of(key)
        if command is not None:
            inbox.put(Request(PLAYER_CONTROL.name, encode(command), _unheard))

    with contextlib.ExitStack() as stack:
        keys = sys.stdin.isatty()
        try:
            if keys:
                stack.enter_context(keys_of(sys.stdin.fileno(), press))
            if sys.stdout.isatty():
                live = Live(
                    console=console,
                    get_renderable=lambda: _status(player, keys),
                    refresh_per_second=_REFRESH,
                    transient=True,
                )
                stack.enter_context(live)
            player.run()
        except KeyboardInterrupt:
            return True
    return False


def _unheard(_reply: bytes) -> None:
    """The status line tells what a key did."""


def _status(player: Player, keys: bool) -> RenderableType:
    awaited = "" if player.playback.sent else player.waiting_for
    line = Text(_WAITING.format(awaited) if awaited else state_line(player.state), no_wrap=True, overflow="ellipsis")
    return Group(line, Text(HELP, style="dim", no_wrap=True)) if keys else line


def sum_up(summary: PlaySummary, console: Console) -> None:
    """Print what was sent, and whether anybody was there to hear it."""
    table = Table(box=None, pad_edge=False)
    table.add_column("topic")
    table.add_column("messages", justify="right")
    table.add_column("listened to", justify="right")
    for name, count in sorted(summary.sent.items()):
        table.add_row(name, str(count), str(summary.heard[name]))
    console.print(table)
    for name, reason in summary.skipped.items():
        console.print(f"left out {name}: {reason}", highlight=False, soft_wrap=True)
    sent, heard = summary.sent.total(), summary.heard.total()
    told = "nobody listened" if not heard else f"{'all' if heard == sent else heard} of them listened to"
    console.print(f"{sent} messages, {told}, {summary.until / 1e9:.1f} s of session time", highlight=False)
