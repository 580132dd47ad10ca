"""palpate view: look at a recorded session in Rerun."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from runtime.log.file import open_log


def view_command(arguments: argparse.Namespace) -> int:
    """Open a log in a window or a browser, or write a file. Raises LogError at the end for a log that is cut short."""
    save = Path(arguments.save) if arguments.save else None
    os.environ.setdefault("RUST_LOG", "error")  # what Rerun warns of is said below, in one line
    with open_log(arguments.log) as log:
        from runtime.view.log import view

        view(log, web=arguments.web, save=save)
        log.check_complete("everything that it holds was shown")
    return 0
