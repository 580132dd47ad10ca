"""palpate launch: run a cell, show how far it is, and sum up what came out."""

from __future__ import annotations

import argparse
import contextlib
import json
import logging
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from runtime import config
from runtime.commands.attendance import PROMPT, TypedLines, answer_of, show_request
from runtime.commands.progress import progress_bar
from runtime.config import CellFile
from runtime.errors import InputError, LogError, SessionError
from runtime.follower import FailedSessionError, Progress, Session
from runtime.in_process import run_in_process
from runtime.launcher import Order, launch
from runtime.log.file import open_log
from runtime.log.snapshot_ring import SNAPSHOT, parse_span
from runtime.log.split import parse_split
from runtime.log.writer import SUMMARY
from runtime.messages import NANOSECONDS, Ending
from runtime.roles import VIEWER
from runtime.view.target import has_display

Run = Callable[[Order, Callable[[Progress], None]], Session]
OVERRIDES = ("strategy", "component", "boards", "seed", "rate")


def launch_command(arguments: argparse.Namespace) -> int:
    """Run a session. 0 when its job was done, holes that were given up included; they stand in the table."""
    overrides: dict[str, Any] = {
        name: getattr(arguments, name) for name in OVERRIDES if getattr(arguments, name) is not None
    }
    if arguments.port is not None:
        overrides["bus"] = {"port": arguments.port}
    if arguments.attended:
        overrides["attendance"] = {"mode": "attended"}
    cell_file = config.load(arguments.cell, overrides)
    typed = TypedLines()
    if cell_file.cell.attendance.attended and arguments.in_process and not typed.available:
        raise InputError("an attended cell that runs with --in-process is answered in its terminal, and there is none")
    logs = Path(arguments.logs)
    order = Order(
        cell_file,
        logs,
        arguments.fresh,
        viewer_mode(arguments.rerun),
        None if arguments.split is None else parse_split(arguments.split),
        None if arguments.snapshot is None else parse_span(arguments.snapshot),
    )
    console = Console()
    try:
        session = _with_bar(order, console, typed, run_in_process if arguments.in_process else launch)
    except FailedSessionError as failed:
        with contextlib.suppress(SessionError, LogError):  # what failed is what is told
            tell_recording(failed.session, console)
        raise
    summarise(session, cell_file, console)
    if session.interrupted:
        raise KeyboardInterrupt
    if session.aborted:
        raise SessionError(session.aborted)
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


def _with_bar(order: Order, console: Console, typed: TypedLines, run: Run) -> Session:
    cell = order.cell_file.cell
    total = cell.boards * len(cell.board.holes)
    attendant = _Attendant(console, typed)
    with progress_bar(console) as bar:
        task = bar.add_task(f"{cell.component}, {cell.strategy}", total=total, detail="starting")

        def show(progress: Progress) -> None:
            for line in progress.said:
                if line.name == VIEWER or (line.level >= logging.WARNING and sys.stdout.isatty()):
                    when = line.stamp.sec + line.stamp.nanosec / NANOSECONDS
                    text = f"{when:.2f} s  {line.name}: {line.msg}"
                    console.print(text, highlight=False, markup=False, soft_wrap=True)
            attendant.look(progress)
            where = f"board {progress.board} hole {progress.hole}" if progress.hole else "starting"
            stopped = "" if progress.permitted else "  [yellow]stopped[/]"
            detail = f"{where}  {progress.attempts} attempts  {progress.session_time:.1f} s{stopped}"
            if progress.request is not None:
                detail += "  [yellow]waits for a person[/]"
            bar.update(task, total=progress.searches, completed=progress.done, detail=detail)

        return run(order, show)


class _Attendant:
    """The person at this terminal: sees what the cell needs, and may type an answer."""

    def __init__(self, console: Console, typed: TypedLines) -> None:
        self._console, self._typed = console, typed
        self._shown = 0  # number of the request shown last

    def look(self, progress: Progress) -> None:
        """Show a request that is new, hand on what was typed."""
        request = progress.request
        if progress.refusal:
            self._say(progress.refusal)
            progress.refusal = ""
        if request is None:
            return
        if request.number > self._shown:
            self._shown = request.number
            self._typed.forget()
            show_request(request, self._console)
            self._say(PROMPT if self._typed.available else "answer with `palpate attend`")
        line = self._typed.next()
        if line is not None and line.strip():
            try:
                progress.answer = answer_of(line, request)
            except InputError as error:
                self._say(str(error))

    def _say(self, text: str) -> None:
        self._console.print(text, highlight=False, markup=False, soft_wrap=True)


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
    view = session.log.with_suffix(".rrd")
    if view.exists():
        console.print(f"watched in {view}: rerun {view}", highlight=False, soft_wrap=True)
    tell_recording(session, console)


def tell_recording(session: Session, console: Console) -> None:
    """Print which files were written, or why none. Raises SessionError if messages were lost or a log is not whole."""
    if session.log.exists():
        _tell_log(session, console)
        return
    snapshots = session.snapshots()
    for path in snapshots:
        with open_log(path) as log:
            told = log.metadata.get(SNAPSHOT, {})
            console.print(
                f"snapshot of {log.start / NANOSECONDS:.1f} to {log.end / NANOSECONDS:.1f} s in {path}: "
                f"{told.get('reason', '')}",
                highlight=False,
                markup=False,
                soft_wrap=True,
            )
    if snapshots:
        _tell_losses(snapshots[-1], console)
        console.print(f"look at it: palpate view {snapshots[-1]}", highlight=False, soft_wrap=True)
    else:
        console.print("no file was written: nothing failed, and nobody asked for a snapshot", highlight=False)


def _tell_log(session: Session, console: Console) -> None:
    with open_log(session.log) as log:
        recording = log.metadata.get(SUMMARY, {})
        if not log.complete or not recording:
            count = sum(topic.count for topic in log.topics)
            raise SessionError(
                f"{session.log} was not closed properly; the {count} messages that it holds can be read, "
                f"and 'palpate recover {session.log}' closes it"
            )
        files = f" and {len(log.files) - 1} more files" if len(log.files) > 1 else ""
        console.print(
            f"recorded {recording['messages']} messages, {recording['lost']} lost, in {session.log}{files}\n"
            f"look at it: palpate view {session.log}",
            highlight=False,
            soft_wrap=True,
        )
    _tell_losses(session.log, console)


def _tell_losses(path: Path, console: Console) -> None:
    with open_log(path) as log:
        recording = log.metadata.get(SUMMARY, {})
    lost: dict[str, int] = json.loads(recording.get("lost_topics", "{}"))
    if not lost:
        return
    table = Table(box=None, pad_edge=False)
    table.add_column("lost on the way to the recorder")
    table.add_column("messages", justify="right")
    for topic, count in lost.items():
        table.add_row(topic, str(count))
    console.print(table)
    what = ", ".join(f"{topic} {count}" for topic, count in lost.items())
    raise SessionError(f"{sum(lost.values())} messages were lost on the way to the recorder: {what}")
