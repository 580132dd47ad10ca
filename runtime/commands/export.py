"""palpate export: a log as tables."""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.console import Console
from rich.table import Table

from runtime.commands.progress import progress_bar
from runtime.errors import InputError, LogError, alternatives
from runtime.log.file import open_log
from runtime.log.table_files import targets, write
from runtime.log.tables import SIGNALS, hindrance, reader, tables

NO_SIGNALS = "none"
NO_ROWS = {"stops": "there always was a permit"}


def export_command(arguments: argparse.Namespace) -> int:
    """Write tables. Raises LogError at the end for a log that is cut short, after all it holds was written."""
    directories = {
        kind: Path(getattr(arguments, kind)) for kind in ("csv", "parquet") if getattr(arguments, kind) is not None
    }
    if not directories:
        raise InputError("say where the tables go: --csv DIR, --parquet DIR, or both")
    signals = signals_of(arguments.signals)
    console = Console()
    with open_log(arguments.log) as log:
        wanted = tables(signals)
        left_out = {table.name: why for table in wanted if (why := hindrance(log, table.topic))}
        possible = [table for table in wanted if table.name not in left_out]
        if not possible:
            raise LogError(f"{log.path} holds nothing to export: {'; '.join(dict.fromkeys(left_out.values()))}")
        names = [table.name for table in possible]
        places = {
            kind: targets(directory, kind, names, force=arguments.force) for kind, directory in directories.items()
        }
        shown = Table(box=None, pad_edge=False)
        for heading, side in (("table", "left"), ("rows", "right"), ("file", "left")):
            shown.add_column(heading, justify=side, overflow="fold")  # type: ignore[arg-type]
        counts = {topic.name: topic.count for topic in log.topics}
        with progress_bar(console) as bar:
            total = sum(counts.get(topic.name, 0) for table in possible for topic in (table.topic, *table.more))
            task = bar.add_task("exporting", total=total, detail="")
            for table in possible:
                bar.update(task, detail=table.name)
                paths = {kind: place[table.name] for kind, place in places.items()}
                rows = write(table.rows(reader(log, lambda: bar.advance(task))), paths)
                if not rows:
                    left_out[table.name] = NO_ROWS.get(table.name, "it would have no rows")
                    continue
                for path in paths.values():
                    shown.add_row(table.name, str(rows), str(path))
        if shown.row_count:
            console.print(shown, soft_wrap=True)
        _explain(console, left_out)
        log.check_complete("everything that it holds was exported")
    return 0


def signals_of(text: str) -> list[str]:
    """Names of signals, separated by commas. Raises InputError naming what there is for one that is unknown."""
    names = [name.strip() for name in text.split(",") if name.strip()]
    if names == [NO_SIGNALS]:
        return []
    unknown = [name for name in names if name not in SIGNALS]
    if unknown or not names:
        wrong = unknown[0] if unknown else text
        raise InputError(f"--signals: there is no signal {wrong!r}; {alternatives(wrong, [*SIGNALS, NO_SIGNALS])}")
    return names


def _explain(console: Console, left_out: dict[str, str]) -> None:
    """Say which tables were left out, those with one reason together."""
    for why in dict.fromkeys(left_out.values()):
        names = ", ".join(name for name, reason in left_out.items() if reason == why)
        console.print(f"left out {names}: {why}", highlight=False, markup=False, soft_wrap=True)
