"""The bar that long work shows on a terminal, and nowhere else."""

from __future__ import annotations

import sys

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, TextColumn, TimeElapsedColumn


def progress_bar(console: Console, *more: ProgressColumn) -> Progress:
    """A bar with a count, the task's field `detail`, the time so far and `more` columns; gone when it is done."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[detail]}"),
        TimeElapsedColumn(),
        *more,
        console=console,
        disable=not sys.stdout.isatty(),
        transient=True,
    )
