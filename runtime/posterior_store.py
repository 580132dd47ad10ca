"""The durable memory of a board type: every search, every attempt, where each part was seated. One SQLite file.

Evidence is only ever added. A board type's evidence is kept apart by `scope`, the world it was gathered in ("real",
"sim-seed-7"): simulated boards with other seeds are other boards, and no simulated one is a real one.
"""

from __future__ import annotations

import json
import math
import sqlite3
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from runtime.closing import Closing
from runtime.errors import InputError, SessionError
from runtime.messages import Attempt, Ending, Miss, Outcome, SearchResult, Seat, Waypoint, slid_in

SCHEMA_VERSION = 2
_APPLICATION_ID = 0x70616C70  # "palp": tells this file from other programs' databases
_BUSY = 5.0  # [s] to wait for another connection's write

_SCHEMA = """
CREATE TABLE search (
    id INTEGER PRIMARY KEY AUTOINCREMENT,  -- in order of arrival
    scope TEXT NOT NULL,
    board_type TEXT NOT NULL,
    session TEXT NOT NULL,
    search INTEGER NOT NULL,
    board INTEGER NOT NULL,
    hole TEXT NOT NULL,
    component TEXT NOT NULL,
    ending INTEGER NOT NULL,
    x REAL, y REAL,                -- [m] candidate that succeeded; null: not a number
    seated_x REAL, seated_y REAL,  -- [m]
    slid INTEGER NOT NULL DEFAULT 0,  -- whether the pins dropped in on the way of a slide
    UNIQUE (scope, session, search)
);
CREATE INDEX search_by_component ON search (scope, board_type, component, id);
CREATE TABLE attempt (
    search_id INTEGER NOT NULL REFERENCES search (id) ON DELETE CASCADE,
    number INTEGER NOT NULL,
    x REAL, y REAL,  -- [m]
    outcome INTEGER NOT NULL,
    path TEXT,       -- [[x, y], ...] [m] of a slide, JSON; null: a peck
    PRIMARY KEY (search_id, number)
) WITHOUT ROWID;
"""
_MIGRATIONS = {  # from each older version to the next
    1: ("ALTER TABLE attempt ADD COLUMN path TEXT", "ALTER TABLE search ADD COLUMN slid INTEGER NOT NULL DEFAULT 0"),
}


@dataclass(frozen=True, slots=True)
class Tried:
    """One attempt of an earlier search: failures are evidence too."""

    session: str
    search: int
    board: int
    hole: str
    number: int  # within the search, from 1
    x: float  # [m] commanded offset from nominal
    y: float  # [m]
    outcome: Outcome
    path: tuple[tuple[float, float], ...] = ()  # [m] slid along; none: a peck


class PosteriorStore(Closing):
    """Evidence about holes in one SQLite file, opened by the one process that owns it; safe from any of its threads.

    What `record` has returned from survives the death of the process and of the machine (write-ahead log, synced at
    each commit). A damaged file is renamed and a fresh one begun; `set_aside` then names the old one.

    Raises InputError if the path cannot be a store: a directory, another program's database, a newer palpate's file.
    Raises SessionError if the file fails in use: locked, read-only, disk full.
    """

    def __init__(self, path: str | Path) -> None:
        self._path = Path(path)
        self._name = self._path.name
        self._lock = threading.Lock()
        self.set_aside: Path | None = None  # where a damaged file was moved to, if one was found
        if self._path.is_dir():
            raise InputError(f"posterior store {self._name}: this is a directory; name a file in it")
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(
                f"posterior store {self._name}: its directory cannot be made ({error.strerror}); choose another place"
            ) from error
        try:
            self._connection = self._open()
        except _DamagedError:
            self.set_aside = self._move_aside()
            self._connection = self._open()

    def record(
        self, board_type: str, result: SearchResult, session: str, attempts: Sequence[Attempt], *, scope: str
    ) -> bool:
        """Store how a search ended and all its attempts; durable on return.

        A search already stored under the same session and number stays as it is: False. InputError if an attempt
        belongs to another search.
        """
        strangers = sorted({attempt.search for attempt in attempts if attempt.search != result.search})
        if strangers:
            raise InputError(f"search {result.search} cannot store attempts of search {strangers[0]}")
        row = (
            scope,
            board_type,
            session,
            result.search,
            result.board,
            result.hole,
            result.component,
            int(result.ending),
            *map(_null, (result.x, result.y, result.seated_x, result.seated_y)),
            any(slid_in(attempt) for attempt in attempts),
        )
        with self._transaction() as connection:
            added = connection.execute(
                "INSERT INTO search (scope, board_type, session, search, board, hole, component, ending,"
                " x, y, seated_x, seated_y, slid) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)"
                " ON CONFLICT (scope, session, search) DO NOTHING",
                row,
            )
            if added.rowcount == 0:
                return False
            connection.executemany(
                "INSERT INTO attempt (search_id, number, x, y, outcome, path) VALUES (?, ?, ?, ?, ?, ?)",
                [
                    (added.lastrowid, item.number, _null(item.x), _null(item.y), int(item.outcome), _path_text(item))
                    for item in attempts
                ],
            )
        return True

    def seats(self, board_type: str, component: str, *, scope: str) -> list[Seat]:
        """Every insertion of this component into boards of this type, oldest first."""
        rows = self._read(
            "SELECT session, board, hole, x, y, seated_x, seated_y, slid FROM search"
            " WHERE scope = ? AND board_type = ? AND component = ? AND ending = ? ORDER BY id",
            (scope, board_type, component, int(Ending.INSERTED)),
        )
        return [
            Seat(session, board, hole, _number(x), _number(y), _number(seated_x), _number(seated_y), bool(slid))
            for session, board, hole, x, y, seated_x, seated_y, slid in rows
        ]

    def attempts(self, board_type: str, component: str, *, scope: str) -> list[Tried]:
        """Every attempt of every search, failed ones included, oldest first."""
        rows = self._read(
            "SELECT session, search, board, hole, number, attempt.x, attempt.y, outcome, path"
            " FROM search JOIN attempt ON search_id = id"
            " WHERE scope = ? AND board_type = ? AND component = ? ORDER BY id, number",
            (scope, board_type, component),
        )
        return [
            Tried(session, search, board, hole, number, _number(x), _number(y), Outcome(outcome), _path(path))
            for session, search, board, hole, number, x, y, outcome, path in rows
        ]

    def misses(self, board_type: str, component: str, *, scope: str) -> list[Miss]:
        """Every attempt that was blocked, oldest first."""
        rows = self._read(
            "SELECT board, hole, attempt.x, attempt.y, path FROM search JOIN attempt ON search_id = id"
            " WHERE scope = ? AND board_type = ? AND component = ? AND outcome = ? ORDER BY id, number",
            (scope, board_type, component, int(Outcome.BLOCKED)),
        )
        return [
            Miss(board, hole, [Waypoint(*point) for point in _path(path) or ((_number(x), _number(y)),)])
            for board, hole, x, y, path in rows
        ]

    def forget(self, board_type: str | None = None, *, scope: str | None = None) -> int:
        """Delete the evidence of a board type, or of all, in one scope or all; how many searches that was."""
        with self._transaction() as connection:
            return connection.execute(
                "DELETE FROM search WHERE (?1 IS NULL OR board_type = ?1) AND (?2 IS NULL OR scope = ?2)",
                (board_type, scope),
            ).rowcount

    def close(self) -> None:
        """Close the file; closing twice is harmless."""
        with self._lock:
            self._connection.close()

    def _open(self) -> sqlite3.Connection:
        connection: sqlite3.Connection | None = None
        try:
            connection = sqlite3.connect(self._path, timeout=_BUSY, isolation_level=None, check_same_thread=False)
            self._prepare(connection)
        except BaseException as error:
            if connection is not None:
                connection.close()
            if _is_damage(error):
                raise _DamagedError from error
            if isinstance(error, sqlite3.Error):
                raise self._failure(error) from error
            raise
        return connection

    def _prepare(self, connection: sqlite3.Connection) -> None:
        application = connection.execute("PRAGMA application_id").fetchone()[0]
        version = connection.execute("PRAGMA user_version").fetchone()[0]
        foreign = (
            connection.execute("SELECT count(*) FROM sqlite_master").fetchone()[0] and application != _APPLICATION_ID
        )
        if foreign:
            raise InputError(f"posterior store {self._name}: this is another program's database; name another file")
        if version > SCHEMA_VERSION:
            raise InputError(
                f"posterior store {self._name}: written by a newer palpate (format {version}, this one reads"
                f" {SCHEMA_VERSION}); update palpate or name another file"
            )
        damage = connection.execute("PRAGMA quick_check(1)").fetchone()[0]
        if damage != "ok":
            raise _DamagedError(damage)
        connection.execute("PRAGMA journal_mode = WAL").fetchone()
        connection.execute("PRAGMA synchronous = FULL")
        connection.execute("PRAGMA foreign_keys = ON")
        if version == 0:
            self._create(connection)
        elif version < SCHEMA_VERSION:
            self._migrate(connection)

    def _create(self, connection: sqlite3.Connection) -> None:
        connection.execute("BEGIN IMMEDIATE")
        if connection.execute("PRAGMA user_version").fetchone()[0] == 0:  # nobody was faster
            for statement in _SCHEMA.split(";\n"):
                if statement.strip():
                    connection.execute(statement)
            connection.execute(f"PRAGMA application_id = {_APPLICATION_ID}")
            connection.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")
        connection.execute("COMMIT")

    def _migrate(self, connection: sqlite3.Connection) -> None:
        connection.execute("BEGIN IMMEDIATE")
        version = connection.execute("PRAGMA user_version").fetchone()[0]  # somebody may have been faster
        for step in range(version, SCHEMA_VERSION):
            for statement in _MIGRATIONS[step]:
                connection.execute(statement)
        connection.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")
        connection.execute("COMMIT")

    def _move_aside(self) -> Path:
        number = 1
        while (target := self._path.with_name(f"{self._name}.damaged-{number}")).exists():
            number += 1
        try:
            self._path.rename(target)
            for suffix in ("-wal", "-shm"):  # they belong to the damaged file and would spoil a fresh one
                companion = self._path.with_name(self._name + suffix)
                if companion.exists():
                    companion.rename(target.with_name(target.name + suffix))
        except OSError as error:
            raise SessionError(
                f"posterior store {self._name}: damaged, and cannot be moved aside ({error.strerror}); move it yourself"
            ) from error
        return target

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        with self._lock:
            try:
                self._connection.execute("BEGIN IMMEDIATE")
                try:
                    yield self._connection
                    self._connection.execute("COMMIT")
                except BaseException:
                    if self._connection.in_transaction:
                        self._connection.execute("ROLLBACK")
                    raise
            except sqlite3.Error as error:
                raise self._failure(error) from error

    def _read(self, query: str, values: tuple[object, ...]) -> list[tuple[Any, ...]]:
        with self._lock:
            try:
                rows: list[tuple[Any, ...]] = self._connection.execute(query, values).fetchall()
            except sqlite3.Error as error:
                raise self._failure(error) from error
        return rows

    def _failure(self, error: sqlite3.Error) -> SessionError | InputError:
        text = str(error)
        name = getattr(error, "sqlite_errorname", "")
        if name.startswith("SQLITE_CANTOPEN"):
            return InputError(
                f"posterior store {self._name}: cannot be opened ({text}); check the path and its permissions"
            )
        remedy = {
            "SQLITE_BUSY": "another process is writing to it; end that one, or name another file",
            "SQLITE_READONLY": "it may not be written to; change its permissions, or name another file",
            "SQLITE_FULL": "the disk is full; make room",
            "SQLITE_CORRUPT": "it was damaged in use; start again, which sets it aside",
        }
        advice = next((words for code, words in remedy.items() if name.startswith(code)), "start the session again")
        return SessionError(f"posterior store {self._name}: {text}: {advice}")


def _null(value: float) -> float | None:
    return value if math.isfinite(value) else None  # SQLite has no "not a number"


def _number(value: float | None) -> float:
    return math.nan if value is None else value


def _path_text(attempt: Attempt) -> str | None:
    return json.dumps([(point.x, point.y) for point in attempt.path]) if attempt.path else None


def _path(text: str | None) -> tuple[tuple[float, float], ...]:
    return tuple((x, y) for x, y in json.loads(text)) if text else ()


class _DamagedError(Exception):
    """The file is no readable database any more."""


def _is_damage(error: BaseException) -> bool:
    name = getattr(error, "sqlite_errorname", "")
    return isinstance(error, _DamagedError) or name.startswith(("SQLITE_CORRUPT", "SQLITE_NOTADB"))
