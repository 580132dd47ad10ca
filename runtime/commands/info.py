"""palpate info: what a log holds."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable
from itertools import groupby

from rich.console import Console
from rich.table import Table

from runtime.log.file import open_log
from runtime.log.info import LogInfo, info_of
from runtime.log.tables import word
from runtime.messages import Ending, SearchResult

SEARCHES_SHOWN = 27  # more than these are summed up board by board
SAID_SHOWN = 10
SESSION_SHOWN = ("cell", "boards", "board_type", "component", "strategy", "seed", "rate")
WIDTH = 120  # [characters] of what is not printed on a terminal, at least


def info_command(arguments: argparse.Namespace) -> int:
    """Print what a log holds. A log that is cut short is told as far as it goes."""
    with open_log(arguments.log) as log:
        info = info_of(log)
    if arguments.json:
        print(json.dumps(info.as_json(), indent=2))  # noqa: T201
        return 0
    console = Console()
    if not console.is_terminal:
        console.width = max(console.width, WIDTH)
    for table in (_about(info), _topics(info), *_searches(info), *_stops(info)):
        console.print(table)
        console.print()
    _say(console, _endings(info))
    return 0


def _say(console: Console, lines: Iterable[str]) -> None:
    for line in lines:
        console.print(line, highlight=False, markup=False, soft_wrap=True)


def _table(*headings: str, right: tuple[str, ...] = ()) -> Table:
    table = Table(box=None, pad_edge=False)
    for heading in headings:
        table.add_column(heading, justify="right" if heading in right else "left", overflow="fold")
    return table


def _about(info: LogInfo) -> Table:
    """What was run, when, and how it was recorded."""
    table = Table(box=None, pad_edge=False, show_header=False)
    table.add_column(style="dim")
    table.add_column(overflow="fold")
    state = "complete" if info.complete else "not complete"
    files = f" in {info.files} files" if info.files > 1 else ""
    table.add_row("log", f"{info.path}, {_size(info.size)}{files}, {state}")
    if info.recorded:
        table.add_row("recorded", info.recorded.replace("T", " "))
    messages = sum(topic.count for topic in info.topics)
    lost = "" if info.lost is None else f", {info.lost} lost"
    table.add_row("holds", f"{info.duration:.1f} s, {messages} messages of {len(info.topics)} topics{lost}")
    session = info.session
    if session:
        cell, boards, kind, part, strategy, seed, rate = (session.get(key, "?") for key in SESSION_SHOWN)
        table.add_row("cell", f"{cell}: {boards} x {kind}, {part}")
        table.add_row("strategy", strategy)
        table.add_row("robot", ", ".join(info.drivers))
        table.add_row("seed, rate", f"{seed}, {rate}")
    if info.versions:
        table.add_row("versions", ", ".join(f"{name} {version}" for name, version in info.versions.items()))
    if info.attachments:
        table.add_row("attached", ", ".join(f"{name} ({_size(size)})" for name, size in info.attachments.items()))
    return table


def _topics(info: LogInfo) -> Table:
    table = _table("topic", "type", "messages", "rate", "size", "lost", right=("messages", "rate", "size", "lost"))
    for topic in info.topics:
        lost = "?" if topic.lost is None else f"{topic.lost}" + ("" if topic.end_known else " or more")
        rate = f"{topic.rate:.1f}/s" if topic.count > 1 else ""
        table.add_row(topic.name, topic.type.replace("/msg/", "/"), str(topic.count), rate, _size(topic.bytes), lost)
    return table


def _searches(info: LogInfo) -> list[Table]:
    if not info.results:
        return []
    if len(info.results) > SEARCHES_SHOWN:
        return [_by_board(info.results)]
    table = _table("board", "hole", "attempts", "time", "outcome", right=("attempts", "time"))
    for result in info.results:
        outcome = _outcome(result)
        table.add_row(str(result.board), result.hole, str(result.attempts), f"{result.duration:.1f} s", outcome)
    return [table]


def _by_board(results: list[SearchResult]) -> Table:
    table = _table("board", "inserted", "attempts", "time", "given up", right=("attempts", "time"))
    for board, group in groupby(results, key=lambda result: result.board):
        rows = list(group)
        inserted = sum(result.ending == Ending.INSERTED for result in rows)
        given_up = "; ".join(f"hole {row.hole} {_outcome(row)}" for row in rows if row.ending != Ending.INSERTED)
        attempts, seconds = sum(row.attempts for row in rows), sum(row.duration for row in rows)
        table.add_row(str(board), f"{inserted} of {len(rows)}", str(attempts), f"{seconds:.1f} s", given_up)
    return table


def _outcome(result: SearchResult) -> str:
    return word(Ending, result.ending) + (f": {result.reason}" if result.ending != Ending.INSERTED else "")


def _stops(info: LogInfo) -> list[Table]:
    if not info.stops:
        return []
    table = _table("stopped at", "for", "kind", "reason", right=("stopped at", "for"))
    for stop in info.stops:
        table.add_row(f"{stop.start:.2f} s", f"{stop.duration:.2f} s", stop.kind, stop.reason)
    return [table]


def _endings(info: LogInfo) -> Iterable[str]:
    """Sums, warnings, and what could not be told."""
    if info.results:
        inserted = sum(result.ending == Ending.INSERTED for result in info.results)
        attempts = sum(result.attempts for result in info.results)
        yield f"{inserted} of {len(info.results)} parts inserted with {attempts} attempts"
    if info.stops:
        times = "once" if len(info.stops) == 1 else f"{len(info.stops)} times"
        yield f"stopped {times}, {sum(stop.duration for stop in info.stops):.1f} s in all"
    elif info.session:
        yield "never stopped"
    for said in info.said[:SAID_SHOWN]:
        yield f"{said.time:.2f} s  {said.level} of {said.plugin}: {said.text}"
    if len(info.said) > SAID_SHOWN:
        yield f"and {len(info.said) - SAID_SHOWN} more warnings; --json has them all"
    unsigned = [topic.name for topic in info.topics if topic.lost is not None and not topic.end_known]
    if unsigned:
        yield f"a publisher of these topics ended without a last word: {', '.join(unsigned)}"
    yield from info.notes


def _size(count: int) -> str:
    """A number of bytes for people."""
    power = min((len(str(count)) - 1) // 3, 4)
    unit = ("B", "kB", "MB", "GB", "TB")[power]
    return f"{count / 1000**power:.3g} {unit}"
