"""palpate snapshot: let a running cell write down what its recorder keeps in memory."""

from __future__ import annotations

import argparse

from rich.console import Console

from runtime.commands.operator import asked
from runtime.config import meeting_point
from runtime.errors import SessionError
from runtime.messages import SnapshotRequest
from runtime.topics import SNAPSHOT

TIMEOUT = 60.0  # [s] for a recorder to write what it has


def snapshot_command(arguments: argparse.Namespace) -> int:
    """Ask, and print where the file is. Raises SessionError if there is none."""
    point = meeting_point(arguments.cell, arguments.port)
    absent = f"no recorder answers on {point}; is 'palpate launch' there?"
    reply = asked(point, SNAPSHOT, SnapshotRequest(arguments.reason), absent, TIMEOUT)
    if reply.error:
        raise SessionError(reply.error)
    Console().print(reply.path, highlight=False, soft_wrap=True)
    return 0
