"""One plugin's process: what it shall be arrives as JSON on the first line of standard input.

Standard input stays open as long as the launcher lives; its end, or SIGTERM, asks the plugin to end in good order.
"""

from __future__ import annotations

import faulthandler
import json
import os
import signal
import sys
import threading
from typing import TextIO

from runtime.config import cell_of
from runtime.context import Context
from runtime.errors import PalpateError
from runtime.roles import Assignment, make


def run(assignment: Assignment, context: Context) -> None:
    """Run one plugin until it ends, in this thread."""
    plugin = make(assignment.role, context.cell, assignment.where, assignment.options)
    try:
        plugin.run(context)
    finally:
        context.close()


def main() -> int:
    """Entry point of a plugin's process."""
    faulthandler.enable()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the launcher, which ends its plugins in order
    assignment = Assignment(**json.loads(sys.stdin.readline()))
    try:
        from runtime.network.zenoh_bus import ZenohBus

        with ZenohBus(assignment.role, assignment.meeting_point) as bus:
            cell = cell_of(assignment.document, assignment.where)
            context = Context(assignment.role, bus, cell, assignment.session, bytes.fromhex(assignment.seal_key))
            signal.signal(signal.SIGTERM, lambda _number, _frame: context.stop())
            threading.Thread(target=_stop_at_end, args=(sys.stdin, context), daemon=True).start()
            run(assignment, context)
    except PalpateError as error:
        print(error, file=sys.stderr)  # noqa: T201 - the launcher reads this line
        return 1
    return 0


def _stop_at_end(stream: TextIO, context: Context) -> None:
    while stream.readline():
        pass
    context.stop()


if __name__ == "__main__":
    code = main()
    sys.stdout.flush()
    sys.stderr.flush()
    # The thread that waits on standard input would hold up an ordinary exit.
    os._exit(code)
