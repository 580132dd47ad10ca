"""palpate replay: publish a recorded session on Zenoh again, with the timing it was recorded with."""

from __future__ import annotations

import argparse
import contextlib
import threading

from rich.console import Console
from rich.table import Table

from runtime.clock import parse_rate
from runtime.log_file import open_log
from runtime.player import chosen, play
from runtime.zenoh_bus import LOOPBACK, ZenohBus, ZenohRouter

ROLE = "player"


def replay_command(arguments: argparse.Namespace) -> int:
    """Play a log to its end and print what was sent. Raises LogError at the end of a log that is cut short."""
    rate = parse_rate(arguments.rate)
    console = Console()
    with contextlib.ExitStack() as stack:
        log = stack.enter_context(open_log(arguments.log))
        chosen(log, arguments.topics)  # a pattern without a match is said before anything is opened
        if not arguments.join:
            stack.enter_context(ZenohRouter(arguments.port))
        bus = stack.enter_context(ZenohBus(ROLE, arguments.port))
        console.print(f"publishing {log.path.name} on tcp/{LOOPBACK}:{arguments.port}", highlight=False)
        threading.Event().wait(arguments.delay)
        summary = play(log, bus, rate, arguments.topics)
    table = Table(box=None, pad_edge=False)
    table.add_column("topic")
    table.add_column("messages", justify="right")
    for name, count in sorted(summary.sent.items()):
        table.add_row(name, str(count))
    console.print(table)
    for name, reason in summary.skipped.items():
        console.print(f"left out {name}: {reason}", highlight=False)
    console.print(
        f"{sum(summary.sent.values())} messages, {summary.until / 1e9:.1f} s of session time", highlight=False
    )
    log.check_complete("everything that it holds was published")
    return 0
