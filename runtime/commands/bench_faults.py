"""palpate bench faults: strike a cell with every fault of the matrix, and print what became of it."""

from __future__ import annotations

import argparse
from collections import Counter
from typing import Any

from rich.console import Console
from rich.table import Table

from runtime.benchmark.faults import HOLES, Fault, Row, chosen, figures_of, measure
from runtime.benchmark.small_cell import small
from runtime.commands.progress import progress_bar
from runtime.errors import InputError, SessionError

MOST = 1000  # tries with one fault
SEED = 1


def bench_faults(arguments: argparse.Namespace) -> dict[str, float]:
    """Strike, judge, print the matrix, and tell the figures; `faults_passed` of `faults_tried` kept every promise."""
    faults = _faults(arguments)
    console = Console()
    if arguments.list:
        _list(faults, console)
        return {}
    if not 1 <= arguments.tries <= MOST:
        raise InputError(f"--tries {arguments.tries} is no number from 1 to {MOST}")
    overrides: dict[str, Any] = {} if arguments.strategy is None else {"strategy": arguments.strategy}
    document = small(arguments.cell, HOLES, overrides)
    seed = SEED if arguments.seed is None else arguments.seed
    with progress_bar(console) as bar:
        task = bar.add_task("faults", total=len(faults) * arguments.tries, detail="")
        rows = measure(faults, document, arguments.tries, seed, lambda name: bar.update(task, advance=1, detail=name))
    _show(rows, console)
    return figures_of(rows)


def check_passed(figures: dict[str, float]) -> None:
    """Raise SessionError if a cell broke a promise."""
    failed = figures.get("faults_tried", 0) - figures.get("faults_passed", 0)
    if failed:
        raise SessionError(f"promises were broken in {failed:.0f} of {figures['faults_tried']:.0f} tries")


def _faults(arguments: argparse.Namespace) -> list[Fault]:
    found = chosen(arguments.only)
    if not found:
        raise InputError(f"no fault is called {arguments.only!r}; 'palpate bench faults --list' tells what there is")
    return found


def _list(faults: list[Fault], console: Console) -> None:
    table = Table(box=None, pad_edge=False)
    table.add_column("fault", no_wrap=True)
    table.add_column("what happens", overflow="fold")
    for fault in faults:
        table.add_row(fault.name, fault.meaning)
    console.print(table)


def _show(rows: list[Row], console: Console) -> None:
    table = Table(box=None, pad_edge=False)
    table.add_column("fault", no_wrap=True)
    for heading in ("tries", "stopped within", "lost"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("recovered", overflow="fold")
    for row in rows:
        stop = "-" if row.stop is None else f"{1e3 * row.stop:.0f} ms"
        lost = str(sum(one.lost for one in row.verdicts)) if row.verdicts else "-"
        table.add_row(row.fault.name, str(len(row.verdicts)), stop, lost, _outcome(row))
    console.print(table, highlight=False, markup=False)
    broken = [f"BROKEN  {row.fault.name}, {what}" for row in rows for what in row.broken]
    for line in ["", *broken, *([""] if broken else []), *_LEGEND]:
        console.print(line, highlight=False, markup=False, soft_wrap=True)


def _outcome(row: Row) -> str:
    if row.skipped:
        return f"not tried: {row.skipped}"
    ends = Counter(one.line for one in row.verdicts if not one.recovered)
    several = len(row.verdicts) > 1
    told = [f"ended{f' {count} times' if several and count > 1 else ''}: {line}" for line, count in ends.items()]
    if row.recovered:
        told.insert(0, f"{row.recovered} of {len(row.verdicts)}")
    return "; ".join(told)


_LEGEND = (
    "stopped within: session time from the end of the arm's last permit until its joints were told to stand, worst; "
    "-: no permit ended while it moved.",
    "lost: searches that the posterior had on record and the store lacks, or has in part.",
    "recovered: the cell did its whole job; else the one line with which it ended.",
)
