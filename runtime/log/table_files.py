"""Writes tables as CSV or Parquet, some thousand rows at a time, so that a long log needs no memory."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pyarrow as pa
from pyarrow import csv, parquet

from runtime.errors import InputError
from runtime.log.tables import Row, columns

BATCH = 20_000  # rows
ENDINGS = {"csv": ".csv", "parquet": ".parquet"}
_WRITERS: dict[str, Callable[[Any, pa.Schema], Any]] = {"csv": csv.CSVWriter, "parquet": parquet.ParquetWriter}
_TEXTS = {"hole", "component", "kind", "outcome", "reason", "path_m", "state"}
_COUNTS = {"search", "attempt", "board", "attempts", "max_attempts", "earlier_seats", "earlier_misses"}
_FLAGS = {"granted"}


def targets(directory: Path, kind: str, names: list[str], *, force: bool) -> dict[str, Path]:
    """Where tables go, by name. Makes the directory.

    Raises InputError if it cannot be written to, or if a table is there already and shall not be replaced.
    """
    paths = {name: directory / f"{name}{ENDINGS[kind]}" for name in names}
    try:
        directory.mkdir(parents=True, exist_ok=True)
        probe = directory / f".palpate{ENDINGS[kind]}"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise InputError(f"{directory} cannot be written to: {error.strerror or error}") from None
    taken = [path.name for path in paths.values() if path.is_dir() or (path.exists() and path.stat().st_size)]
    if taken and not force:
        raise InputError(f"{directory} holds {', '.join(taken)} already; choose another directory, or add --force")
    return paths


def write(rows: Iterator[Row], paths: dict[str, Path]) -> int:
    """Write rows to a file of each kind; returns how many. Without a row nothing is written.

    The files appear under their names when they are complete. Raises InputError where that fails.
    """
    first = next(rows, None)
    if first is None:
        return 0
    schema = pa.schema([(name, _type(name)) for name in first])
    unfinished = {kind: path.with_name(f".{path.name}.part") for kind, path in paths.items()}
    count = 0
    try:
        writers = [_WRITERS[kind](str(path), schema) for kind, path in unfinished.items()]
        for gathered in columns(first, rows, BATCH):
            table = pa.table(gathered, schema=schema)
            count += table.num_rows
            for writer in writers:
                writer.write_table(table)
        for writer in writers:
            writer.close()
        for kind, path in unfinished.items():
            path.replace(paths[kind])
    except OSError as error:
        where = next(iter(paths.values())).parent
        raise InputError(f"{where} cannot be written to: {error.strerror or error}") from None
    finally:
        for path in unfinished.values():
            path.unlink(missing_ok=True)
    return count


def _type(name: str) -> pa.DataType:
    if name in _TEXTS:
        return pa.string()
    if name in _COUNTS:
        return pa.int64()
    return pa.bool_() if name in _FLAGS else pa.float64()
