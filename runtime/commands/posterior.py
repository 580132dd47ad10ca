"""palpate posterior: look at what was learnt about the holes, take it elsewhere, forget it."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterable
from datetime import datetime
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from runtime.errors import InputError, alternatives
from runtime.evidence.file import Access, missing
from runtime.evidence.store import Holding, PosteriorStore
from runtime.evidence.text import as_csv, as_json, as_lines, read_text
from runtime.messages import NANOSECONDS

_FORMATS = {".json": as_json, ".jsonl": as_lines, ".csv": as_csv}
_COUNTED = ("searches", "inserted", "exhausted", "aborted", "sessions")


def list_command(arguments: argparse.Namespace) -> int:
    """Print a table of what the store holds."""
    path = _path(arguments)
    with PosteriorStore(path, Access.READ) as store:
        holdings = store.holdings()
    table = _table(["board type", "component", "scope"], [*_COUNTED, "first", "last", "forgotten"])
    for held in holdings:
        numbers = [str(getattr(held, name)) for name in _COUNTED]
        dates = [datetime.fromtimestamp(time / NANOSECONDS).strftime("%Y-%m-%d") for time in (held.first, held.last)]
        names = map(escape, (held.board_type, held.component, held.scope))
        table.add_row(*names, *numbers, *dates, str(held.forgotten))
    console = Console()
    if holdings:
        console.print(table)
    else:
        console.print("nothing was learnt yet")
    size = sum(file.stat().st_size for file in (path, path.with_name(f"{path.name}-wal")) if file.exists())
    console.print(f"{path}: {size / 1000:.0f} kB", highlight=False, markup=False, soft_wrap=True)
    return 0


def show_command(arguments: argparse.Namespace) -> int:
    """Print what the evidence says about each hole, and draw it if asked."""
    from runtime.commands.posterior_belief import draw, hole_beliefs

    if not 0 < arguments.prior_width < 100:
        raise InputError(f"--prior-width {arguments.prior_width:g} is no width from 0 to 100 mm")
    picture = None if arguments.picture is None else _writable(arguments.picture, (".png", ".svg"), "--picture")
    console = Console()
    shown = []
    with PosteriorStore(_path(arguments), Access.READ) as store:
        for held in _chosen(store, arguments.board_type, arguments.component, arguments.scope):
            beliefs = hole_beliefs(
                store.seats(held.board_type, held.component, scope=held.scope),
                store.misses(held.board_type, held.component, scope=held.scope),
                arguments.prior_width * 1e-3,
            )
            if arguments.hole is not None:
                beliefs = [belief for belief in beliefs if belief.hole == arguments.hole]
            if beliefs:
                shown.append((held, beliefs))
        if not shown:
            known = {item.hole for item in store.evidence(arguments.board_type)}
            raise InputError(f"no evidence about hole {arguments.hole!r}; {alternatives(arguments.hole or '', known)}")
    headings = ["insertions", "attempts blocked", "x, mm", "y, mm", "std x, mm", "std y, mm"]
    for held, beliefs in shown:
        console.print(
            f"{held.board_type}, {held.component}, {held.scope}", highlight=False, markup=False, soft_wrap=True
        )
        table = _table(["hole"], headings)
        for belief in beliefs:
            counts = str(belief.insertions), str(belief.blocked)
            table.add_row(
                escape(belief.hole), *counts, *(f"{value * 1e3:.3f}" for value in (*belief.mean, *belief.deviations))
            )
        console.print(table)
    if picture is not None:
        draw({f"{held.board_type}, {held.component}, {held.scope}": beliefs for held, beliefs in shown}, picture)
        console.print(str(picture), highlight=False, markup=False, soft_wrap=True)
    return 0


def export_command(arguments: argparse.Namespace) -> int:
    """Write evidence to a file or to standard output."""
    path = None if arguments.file is None else _writable(arguments.file, _FORMATS, "the file to export to")
    with PosteriorStore(_path(arguments), Access.READ) as store:
        if not arguments.forgotten:
            _chosen(store, arguments.board_type, arguments.component, arguments.scope)
        evidence = store.evidence(
            arguments.board_type, arguments.component, scope=arguments.scope, forgotten=arguments.forgotten
        )
    if path is None:
        sys.stdout.write(as_lines(evidence))
        sys.stdout.flush()  # here, where a reader that has gone is no error
        return 0
    try:
        path.write_text(_FORMATS[path.suffix](evidence), encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror}") from None
    _say(f"{_searches(len(evidence))} to {path}")
    return 0


def import_command(arguments: argparse.Namespace) -> int:
    """Add the evidence of a file to the store."""
    evidence = read_text(*_text(arguments.file))
    path = _path(arguments)
    with PosteriorStore(path, Access.EDIT) as store:
        merge = store.add(evidence, all_or_none=True)
    _say(f"{_searches(merge.added)} new in {path}, {merge.known} known already")
    if merge.forgotten:
        _say(
            f"{merge.forgotten} of them forgotten: they do not count;"
            " `palpate posterior forget BOARD_TYPE --undo` lets them"
        )
    return 0


def forget_command(arguments: argparse.Namespace) -> int:
    """Let evidence count no more, or again."""
    if arguments.all == (arguments.board_type is not None):
        raise InputError("name one board type, or --all")
    path = _path(arguments)
    if not path.is_file():
        raise InputError(missing(path))
    with PosteriorStore(path, Access.EDIT) as store:
        held = [
            item
            for item in store.holdings()
            if arguments.board_type in (None, item.board_type) and arguments.scope in (None, item.scope)
        ]
        if not held:
            _chosen(store, arguments.board_type, None, arguments.scope, forgotten=True)
        if arguments.undo:
            _say(f"{_searches(store.recall(arguments.board_type, scope=arguments.scope))} recalled")
            return 0
        count = sum(item.searches for item in held)
        if count and not arguments.yes:
            _confirm(f"forget {_searches(count)} of {', '.join(sorted({item.board_type for item in held}))} in {path}?")
        _say(f"{_searches(store.forget(arguments.board_type, scope=arguments.scope))} forgotten")
    return 0


def serve_command(arguments: argparse.Namespace) -> int:
    """Let cells share what they learn until Ctrl-C ends it."""
    from runtime.commands.posterior_serve import folder_of, serve

    serve(_path(arguments), arguments.listen, folder_of(arguments.keys))
    return 0


def _path(arguments: argparse.Namespace) -> Path:
    return Path(arguments.store) if arguments.store else Path(arguments.logs) / "posterior.sqlite3"


def _chosen(
    store: PosteriorStore, board_type: str | None, component: str | None, scope: str | None, *, forgotten: bool = False
) -> list[Holding]:
    """Holdings that were asked for. InputError if there are none, naming what exists."""
    held = [item for item in store.holdings() if item.searches or forgotten]
    for what, wanted in (("board type", board_type), ("component", component), ("scope", scope)):
        attribute = what.replace(" ", "_")
        known = {str(getattr(item, attribute)) for item in held}
        if wanted is not None and wanted not in known:
            raise InputError(f"no evidence about {what} {wanted!r}; {alternatives(wanted, known)}")
        held = [item for item in held if wanted in (None, getattr(item, attribute))]
    return held


def _writable(name: str, endings: Iterable[str], what: str) -> Path:
    path = Path(name)
    if path.suffix not in endings:
        raise InputError(f"{what} should end in {', '.join(endings)}, not be {name!r}")
    if not path.parent.is_dir():
        raise InputError(f"{path.parent} is no folder")
    return path


def _text(name: str) -> tuple[str, str]:
    """Text of a file and what to call it."""
    try:
        if name == "-":
            return sys.stdin.read(), "standard input"
        if Path(name).suffix == ".csv":
            raise InputError(f"{name}: a table of attempts cannot be imported; export .json or .jsonl")
        return Path(name).read_text(encoding="utf-8"), name
    except OSError as error:
        raise InputError(f"{name} cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise InputError(f"{name}: is no text; it should be what `palpate posterior export` writes") from None


def _confirm(question: str) -> None:
    if not sys.stdin.isatty():
        raise InputError(f"{question} Confirm with --yes")
    print(f"{question} [y/N] ", end="", file=sys.stderr, flush=True)  # noqa: T201
    if not re.fullmatch(r"y(es)?", sys.stdin.readline().strip().lower()):
        raise InputError("nothing was forgotten")


def _table(texts: Iterable[str], numbers: Iterable[str]) -> Table:
    table = Table(box=None, pad_edge=False)
    for heading in texts:
        table.add_column(heading, overflow="fold")
    for heading in numbers:
        table.add_column(heading, justify="right", overflow="fold")
    return table


def _searches(count: int) -> str:
    return "1 search" if count == 1 else f"{count} searches"


def _say(text: str) -> None:
    print(text)  # noqa: T201
