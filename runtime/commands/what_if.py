"""palpate replay --what-if: what other strategies would have made of the holes that a log found."""

from __future__ import annotations

import argparse
from statistics import fmean, pstdev

from rich.console import Console
from rich.table import Table

from runtime.commands.progress import progress_bar
from runtime.errors import InputError
from runtime.experiment.what_if import DRAWS, Logged, Outlook, WhatIf, logged, what_if
from runtime.log.file import open_log

_CAVEATS = """\
± is the spread over {draws} draws of places for the holes that agree with what the log felt, not an error of the mean.
This is the statistical model, not physics: an attempt succeeds where the drawing of the part says so, with the part not
turned and holes as wide as drawn. Real outcomes near the rim differ; compare with the recorded strategy's second row.
One log is one example: which strategy is better, `palpate experiment compare` tells."""


def what_if_command(arguments: argparse.Namespace) -> int:
    """Let strategies loose on a log's holes and print how many attempts each needs."""
    names = list(dict.fromkeys(name.strip() for name in arguments.what_if.split(",") if name.strip()))
    if not names:
        raise InputError("--what-if names no strategy; `palpate plugins` lists them")
    console = Console()
    with open_log(arguments.log) as log:
        found = logged(log)
        complete = log.complete
    names = [found.cell.strategy, *(name for name in names if name != found.cell.strategy)]
    for name in names:
        found.strategy(name)  # one that is unknown is said before anything is computed
    drawn = what_if(found)
    outlooks = []
    with progress_bar(console) as bar:
        task = bar.add_task("draws", total=len(names) * len(drawn.draws), detail="")
        for name in names:
            bar.update(task, detail=name)
            outlooks.append(drawn.outlook(name, lambda: bar.advance(task)))
    console.print(_table(found, outlooks))
    _say(console, drawn, outlooks, complete)
    return 0


def _table(log: Logged, outlooks: list[Outlook]) -> Table:
    table = Table(box=None, pad_edge=False)
    table.add_column("strategy")
    for name in ("attempts", "per hole", "found", "bounded", "given up"):
        table.add_column(name, justify="right")
    count = len(log.holes)
    given_up = count - log.found
    table.add_row(
        f"{log.cell.strategy}, as recorded",
        str(log.attempts),
        f"{log.attempts / count:.2f}",
        f"{log.found} of {count}",
        "",
        str(given_up),
    )
    for outlook in outlooks:
        least = ">= " if any(outlook.bounded) else ""
        mean, bounded, found = fmean(outlook.attempts), fmean(outlook.bounded), fmean(outlook.found)
        again = ", again in the model" if outlook.strategy == log.cell.strategy else ""
        table.add_row(
            f"{outlook.strategy}{again}",
            f"{least}{mean:.1f} ± {pstdev(outlook.attempts):.1f}",
            f"{least}{mean / count:.2f}",
            f"{found:.4g} of {count}",
            f"{bounded:.4g}",
            f"{count - found - bounded:.4g}",
        )
    return table


def _say(console: Console, drawn: WhatIf, outlooks: list[Outlook], complete: bool) -> None:
    def say(text: str) -> None:
        console.print(text, highlight=False, soft_wrap=True)

    say(_CAVEATS.format(draws=DRAWS))
    if any(any(outlook.bounded) for outlook in outlooks):
        say(
            "A hole that the log never found is only bounded: attempts count up to the first that what was tried does "
            "not rule out, and nothing is learnt from it."
        )
    if drawn.contradicting:
        say(
            f"At {drawn.contradicting} of {len(drawn.log.holes)} holes no place agrees with every attempt by drawing:"
            " there places that agree with most stand in."
        )
    if not complete:
        say("The log is cut short: only searches that it saw end are counted.")
