"""palpate recover: close a log that was never finished."""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.console import Console

from runtime.commands.progress import progress_bar
from runtime.log.recovery import recover


def recover_command(arguments: argparse.Namespace) -> int:
    """Close the log, and print what it holds. A complete log is left alone, with a word."""
    path = Path(arguments.log)
    output = None if arguments.output is None else Path(arguments.output)
    console = Console()
    with progress_bar(console) as bar:
        task = bar.add_task("recovering", total=None, detail=path.name)

        def show(done: int, size: int) -> None:
            bar.update(task, completed=round(done / 1e6), total=round(size / 1e6), detail="MB")

        recovered = recover(path, output, show)
    if not recovered:
        console.print(f"{path} is complete: there is nothing to recover", highlight=False, soft_wrap=True)
    for file in recovered:
        dropped = f"; the last {file.dropped} bytes were of no use" if file.dropped else ""
        console.print(
            f"recovered {file.messages} messages until {file.until:.3f} s of session time: {file.path}\n"
            f"the file as it was: {file.original}{dropped}",
            highlight=False,
            soft_wrap=True,
        )
    return 0
