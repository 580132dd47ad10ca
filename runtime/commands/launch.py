"""palpate launch: run a cell, show how far it is, and sum up what came out."""

from __future__ import annotations

import argparse
import logging
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from runtime import config
from runtime.commands.progress import progress_bar
from runtime.config import CellFile
from runtime.errors import InputError, SessionError
from runtime.follower import Progress, Session
from runtime.in_process import run_in_process
from runtime.launcher import Order, launch
from runtime.log_file import open_log
from runtime.messages import NANOSECONDS, Ending
from runtime.roles import VIEWER
from runtime.viewer import has_display

Run = Callable[[Order, Callable[[Progress], None]], Session]
OVERRIDES = ("strategy", "component", "boards", "seed", "rate")


def launch_command(arguments: argparse.Namespace) -> int:
    """Run a session. 0 when its job was done, holes that were given up included; they stand in the table."""
    overrides: dict[str, Any] = {
        name: getattr(arguments, name) for name in OVERRIDES if getattr(arguments, name) is not None
    }
    if arguments.port is not None:
        overrides["bus"] = {"port": arguments.port}
    cell_file = config.load(arguments.cell, overrides)
    logs = Path(arguments.logs)
    order = Order(cell_file, logs, arguments.fresh, viewer_mode(arguments.rerun))
    console = Console()
    session = _with_bar(order, console, run_in_process if arguments.in_process else launch)
    summarise(session, cell_file, console)
    if session.interrupted:
        raise KeyboardInterrupt
    return 0


def viewer_mode(mode: str) -> str | None:
    """Mode of the live viewer; None for none. Raises InputError for a window without a display."""
    if mode == "auto":
        mode = "spawn" if has_display() else "off"
    if mode == "off":
        return None
    if mode == "spawn" and not has_display():
        raise InputError("--rerun spawn needs a display and there is none; choose --rerun web, save or off")
    return mode


def _with_bar(order: Order, console: Console, run: Run) -> Session:
    cell = order.cell_file.cell
    total = cell.boards * len(cell.board.holes)
    with progress_bar(console) as bar:
        task = bar.add_task(f"{cell.component}, {cell.strategy}", total=total, detail="starting")

        def show(progress: Progress) -> None:
            for line in progress.said:
                if line.name == VIEWER or (line.level >= logging.WARNING and sys.stdout.isatty()):
                    when = line.stamp.sec + line.stamp.nanosec / NANOSECONDS
                    text = f"{when:.2f} s  {line.name}: {line.msg}"
                    console.print(text, highlight=False, markup=False, soft_wrap=True)
            where = f"board {progress.board} hole {progress.hole}" if progress.hole else "starting"
            stopped = "" if progress.permitted else "  [yellow]stopped[/]"
            detail = f"{where}  {progress.attempts} attempts  {progress.session_time:.1f} s{stopped}"
            bar.update(task, completed=progress.done, detail=detail)

        return run(order, show)


def summarise(session: Session, cell_file: CellFile, console: Console) -> None:
    """Print the results, how the recording went, and how to look at it. Raises SessionError if messages were lost."""
    cell = cell_file.cell
    table = Table(box=None, pad_edge=False)
    for heading in ("board", "hole"):
        table.add_column(heading)
    for heading in ("attempts", "time"):
        table.add_column(heading, justify="right")
    table.add_column("outcome", overflow="fold")
    for result in session.results:
        ending = Ending(result.ending)
        outcome = "inserted" if ending is Ending.INSERTED else f"{ending.name.lower()}: {result.reason}"
        table.add_row(str(result.board), result.hole, str(result.attempts), f"{result.duration:.1f} s", outcome)
    if session.results:
        console.print(table)
    inserted = sum(result.ending == Ending.INSERTED for result in session.results)
    console.print(
        f"{inserted} of {cell.boards * len(cell.board.holes)} {cell.component}s inserted with {cell.strategy} search, "
        f"{session.duration:.1f} s of session time"
        + (f" in {session.machine_time:.1f} s" if session.machine_time else ""),
        highlight=False,
    )
    if not session.log.exists():
        return
    view = session.log.with_suffix(".rrd")
    if view.exists():
        console.print(f"watched in {view}: rerun {view}", highlight=False, soft_wrap=True)
    with open_log(session.log) as log:
        recording = log.metadata.get("palpate.recording", {})
        if not log.complete or not recording:
            raise SessionError(f"{session.log} was not closed properly; what it holds can still be read")
        lost = int(recording["lost"])
        console.print(
            f"recorded {recording['messages']} messages, {lost} lost, in {session.log}\n"
            f"look at it: palpate view {session.log}",
            highlight=False,
            soft_wrap=True,
        )
        if lost:
            raise SessionError(f"{lost} messages were lost on the way to the recorder: {recording['lost_topics']}")
