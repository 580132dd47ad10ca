"""palpate snapshot: let a running cell write down what its recorder keeps in memory."""

from __future__ import annotations

import argparse

from rich.console import Console

from runtime.config import meeting_point
from runtime.errors import BusError, SessionError
from runtime.messages import SnapshotRequest
from runtime.network.access import OPERATOR
from runtime.network.zenoh_bus import ZenohBus
from runtime.topics import SNAPSHOT

TIMEOUT = 60.0  # [s] for a recorder to write what it has
PATIENCE = 3.0  # [s] for a cell to answer


def snapshot_command(arguments: argparse.Namespace) -> int:
    """Ask, and print where the file is. Raises SessionError if there is none."""
    point = meeting_point(arguments.cell, arguments.port)
    try:
        with ZenohBus(OPERATOR, point, patience=PATIENCE) as bus:
            reply = bus.request(SNAPSHOT, SnapshotRequest(arguments.reason), TIMEOUT)
    except BusError:
        raise BusError(f"no recorder answers on {point}; is 'palpate launch' there?") from None
    if reply.error:
        raise SessionError(reply.error)
    Console().print(reply.path, highlight=False, soft_wrap=True)
    return 0
