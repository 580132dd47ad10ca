"""palpate replay --check: do today's strategies, posterior, assembly and interlock decide what a log recorded?"""

from __future__ import annotations

import argparse

from rich.console import Console
from rich.table import Table
from rich.text import Text

from runtime.log.file import open_log
from runtime.messages import NANOSECONDS
from runtime.reexecution.differences import FieldDifference
from runtime.reexecution.reexecute import reexecute
from runtime.reexecution.verdict import Difference, Verdict

_SHOWN = 24  # fields of the first difference


def recheck_command(arguments: argparse.Namespace) -> int:
    """Re-execute a log and print how its decisions compare. 0: all agree, 1: some differ."""
    console = Console()
    with open_log(arguments.log) as log:
        verdict = reexecute(log)
    console.print(_table(verdict))
    _say(console, verdict)
    took, seconds = verdict.session.duration / NANOSECONDS, verdict.seconds
    console.print(
        f"{took:.1f} s of session time in {seconds:.2f} s: {took / seconds:.0f} x its speed",
        highlight=False,
        soft_wrap=True,
    )
    if verdict.first is None:
        return 0
    _show(console, verdict.first)
    return 1


def _table(verdict: Verdict) -> Table:
    table = Table(box=None, pad_edge=False)
    table.add_column("topic")
    for name in ("compared", "differing", "rounding only"):
        table.add_column(name, justify="right")
    beyond = any(tally.beyond for tally in verdict.tallies.values())
    if beyond:
        table.add_column("left out", justify="right")
    for name, tally in verdict.tallies.items():
        row = [name, str(tally.compared), str(tally.differing), str(tally.rounding)]
        table.add_row(*row, *[str(tally.beyond)] * beyond)
    return table


def _say(console: Console, verdict: Verdict) -> None:
    lost = {name: count for name, count in verdict.session.lost.items() if count}
    if lost:
        named = ", ".join(f"{count} of {name}" for name, count in lost.items())
        console.print(f"the recorder lost messages: {named}", highlight=False, soft_wrap=True)
    for reason in verdict.losses:
        console.print(f"{reason}: what rests on it cannot be compared", highlight=False, soft_wrap=True)
    missing = {name: tally.missing for name, tally in verdict.tallies.items() if tally.missing}
    if missing:
        end = "is cut short" if not verdict.session.complete else "ends"
        named = ", ".join(f"{count} of {name}" for name, count in missing.items())
        console.print(
            f"the log {end} before decisions that would follow, which is no difference: {named}",
            highlight=False,
            soft_wrap=True,
        )
    beyond = sum(tally.beyond for tally in verdict.tallies.values())
    if verdict.differing:
        console.print(f"{verdict.differing} of {verdict.compared} decisions differ", highlight=False, soft_wrap=True)
    elif beyond:
        console.print(
            f"all {verdict.compared} decisions that can be compared agree; {beyond} cannot",
            highlight=False,
            soft_wrap=True,
        )
    else:
        console.print(f"all {verdict.compared} decisions agree", highlight=False, soft_wrap=True)


def _show(console: Console, difference: Difference) -> None:
    console.print(
        f"the first difference: {difference.topic}, {difference.decision}, at {difference.stamp / 1e9:.3f} s",
        highlight=False,
        soft_wrap=True,
    )
    if difference.what:
        console.print(difference.what, highlight=False, soft_wrap=True)
        return
    table = Table(box=None, pad_edge=False)
    for name in ("field", "recorded", "now"):
        table.add_column(name, overflow="fold")
    shown = sorted(difference.fields, key=lambda item: item.rounding)[:_SHOWN]
    for item in shown:
        table.add_row(*map(Text, (_name(item), repr(item.recorded), repr(item.now))))
    console.print(table)
    if len(difference.fields) > len(shown):
        console.print(f"and {len(difference.fields) - len(shown)} fields more", highlight=False, soft_wrap=True)


def _name(item: FieldDifference) -> str:
    unit = f"  [{item.unit}]" if item.unit else ""
    return f"{item.name}{unit}{'  (rounding)' if item.rounding else ''}"
