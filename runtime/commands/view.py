"""palpate view: look at a recorded session in Rerun."""

from __future__ import annotations

import argparse
from pathlib import Path

from runtime.errors import InputError
from runtime.log_file import open_log


def view_command(arguments: argparse.Namespace) -> int:
    """Open a log in a window or a browser, or write a file. Raises LogError at the end for a log that is cut short."""
    from runtime.viewer import view

    if arguments.output and arguments.rerun != "save":
        raise InputError("--output names the file that --rerun save writes; add --rerun save")
    log = Path(arguments.log)
    recorded = open_log(log)
    recorded.close()  # only opened so that a log that cannot be read is said before anything else
    save = Path(arguments.output) if arguments.output else log.with_suffix(".rrd")
    view(log, arguments.rerun, save if arguments.rerun == "save" else None)
    recorded.check_complete("everything that it holds was shown")
    return 0
