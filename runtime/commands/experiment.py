"""palpate experiment: run a study, print what it found, write tables and figures."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import TimeRemainingColumn
from rich.table import Table

from runtime.commands.progress import progress_bar
from runtime.component import component
from runtime.errors import InputError
from runtime.experiment.cache import Cache, default_folder
from runtime.experiment.contenders import contender
from runtime.experiment.executor import LOCAL
from runtime.experiment.report import show, write
from runtime.experiment.studies import STUDIES, study
from runtime.experiment.study import Choices, Study, Work
from runtime.experiment.sweep import Progress, Swept, sweep
from runtime.experiment.worlds import world

LIST = "list"
PHYSICS_SHARE = 10  # seeds in the full physics are that many times fewer unless said
KNOWN = {"strategies": contender, "worlds": world, "components": component}


def experiment_command(arguments: argparse.Namespace) -> int:
    """Run a study to its end, or list them."""
    console = Console()
    if arguments.name == LIST:
        _list(console)
        return 0
    chosen_study = study(arguments.name)
    chosen = choices(chosen_study, arguments)
    if arguments.jobs is not None and arguments.jobs < 1:
        raise InputError(f"--jobs: {arguments.jobs} processes can do nothing; write 1 or more")
    if arguments.jobs is not None and arguments.executor != LOCAL:
        raise InputError("--jobs is about this machine; a cluster uses all of its workers")
    folder = Path(arguments.out) if arguments.out else Path("experiments") / chosen_study.name
    cache = Cache(Path(arguments.cache) if arguments.cache else default_folder())
    results = _run(chosen_study, chosen_study.work(chosen), cache, arguments, console)
    findings = chosen_study.findings(chosen, results)
    show(findings, console)
    for path in write(chosen_study, chosen, findings, folder):
        console.print(f"written: {path}", highlight=False, soft_wrap=True, markup=False)
    return 0


def choices(chosen_study: Study, arguments: argparse.Namespace) -> Choices:
    """The study's defaults with what the command line says instead. Raises InputError for what it cannot honour."""
    defaults = chosen_study.defaults
    given: dict[str, Any] = {option: getattr(arguments, option) for option in vars(defaults)}
    said = {option: value for option, value in given.items() if value is not None and value is not False}
    for option in said:
        if option not in defaults.offered:
            offered = ", ".join(f"--{name}" for name in defaults.offered)
            instead = f"its own options are {offered}" if offered else "it has no options of its own"
            raise InputError(f"{chosen_study.name} has no --{option}; {instead}")
    for option, find in KNOWN.items():
        if option in said:
            said[option] = _names(option, said[option])
            for name in said[option]:
                find(name)
    for option in ("seeds", "boards"):
        if option in said and said[option] < 1:
            raise InputError(f"--{option}: {said[option]} is too few; write 1 or more")
    if "physics" in said and "seeds" in defaults.offered:
        said.setdefault("seeds", max(1, defaults.seeds // PHYSICS_SHARE))
    return replace(defaults, **said)


def _names(option: str, text: str) -> tuple[str, ...]:
    names = tuple(name.strip() for name in text.split(","))
    if not all(names) or len(set(names)) < len(names):
        raise InputError(f"--{option}: {text!r} is no list of different names; write them with commas between")
    return names


def _list(console: Console) -> None:
    table = Table(box=None, pad_edge=False)
    for heading in ("name", "what it shows", "seeds", "options of its own"):
        table.add_column(heading, overflow="fold")
    for name in STUDIES:
        one = study(name)
        options = [f"--{option}" for option in one.defaults.offered]
        table.add_row(name, one.summary, str(one.defaults.seeds or "-"), " ".join(options) or "-")
    console.print(table)


def _run(
    chosen_study: Study, work: Sequence[Work[Any]], cache: Cache, arguments: argparse.Namespace, console: Console
) -> Swept:
    with progress_bar(console, TimeRemainingColumn()) as bar:
        task = bar.add_task(chosen_study.name, total=None, detail="")

        def report(progress: Progress) -> None:
            detail = f"{progress.cached} from the cache" if progress.cached else ""
            bar.update(task, completed=progress.done, total=progress.total, detail=detail)

        results = sweep(work, cache, jobs=arguments.jobs or -1, where=arguments.executor, report=report)
    if results.total:
        console.print(f"{results.total} pieces of work, {results.cached} of them from {cache.folder}", highlight=False)
    return results
