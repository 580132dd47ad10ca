"""The file of a posterior store: its tables and their older formats, how it is opened, and how damage is told.

Evidence is appended, never overwritten: triggers in the file itself refuse to change or delete a row. Each piece
carries a checksum, and opening reads every one, so that a flipped bit is found before it misleads a search.
"""

from __future__ import annotations

import json
import os
import sqlite3
from collections.abc import Callable
from contextlib import suppress
from datetime import datetime
from enum import Enum
from itertools import groupby
from pathlib import Path
from typing import Any
from urllib.parse import quote

from runtime.errors import InputError, SessionError
from runtime.evidence.evidence import Evidence, Tried
from runtime.messages import NANOSECONDS, Ending, Outcome

SCHEMA_VERSION = 3
_APPLICATION_ID = 0x70616C70  # "palp": tells this file from other programs' databases
_BUSY = 5.0  # [s] to wait for another connection's write
IN_MEMORY = ":memory:"


class Access(Enum):
    """What a store is opened for."""

    OWN = "by a cell: made if missing, brought up to date, set aside if damaged"
    EDIT = "by a person: made if missing, brought up to date"
    READ = "to look at it: nothing is made, changed or moved, and no newer format written"


_SCHEMA = (
    """CREATE TABLE search (
    id INTEGER PRIMARY KEY AUTOINCREMENT,
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
    recorded_at INTEGER NOT NULL DEFAULT 0,  -- [ns] since 1970
    checksum INTEGER NOT NULL DEFAULT 0,  -- of this row and its attempts
    UNIQUE (scope, session, search)
)""",
    """CREATE TABLE attempt (
    search_id INTEGER NOT NULL REFERENCES search (id),
    number INTEGER NOT NULL,
    x REAL, y REAL,  -- [m]
    outcome INTEGER NOT NULL,
    path TEXT,       -- [[x, y], ...] [m] of a slide, JSON; null: a peck
    PRIMARY KEY (search_id, number)
) WITHOUT ROWID""",
)
_TURNS_AND_ORDER = (
    # Each time a search is forgotten (an even life) or recalled (an odd one) adds a row. Without one its life is 1.
    """CREATE TABLE turn (
    search_id INTEGER NOT NULL REFERENCES search (id),
    life INTEGER NOT NULL,  -- from 2
    PRIMARY KEY (search_id, life)
) WITHOUT ROWID""",
    "CREATE INDEX search_in_order ON search (scope, board_type, component, recorded_at, session, search)",
    "CREATE INDEX search_newest ON search (recorded_at)",
    *(
        f"CREATE TRIGGER {table}_stays_at_{action.lower()} BEFORE {action} ON {table}"
        " BEGIN SELECT RAISE(ABORT, 'evidence is appended, never overwritten'); END"
        for table in ("search", "attempt", "turn")
        for action in ("UPDATE", "DELETE")
    ),
)

LIFE = "(SELECT 1 + count(*) FROM turn WHERE turn.search_id = search.id)"
COUNTS = f"{LIFE} % 2 = 1"  # SQL condition: not forgotten
IN_ORDER = "recorded_at, scope, session, search"  # oldest first; the same in every store that holds the same evidence


def read_evidence(connection: sqlite3.Connection, where: str = "1", values: tuple[object, ...] = ()) -> list[Evidence]:
    """Evidence that fits an SQL condition on `search`, oldest first."""
    return [evidence for evidence, _ in _with_checksums(connection, where, values)]


def _with_checksums(
    connection: sqlite3.Connection, where: str, values: tuple[object, ...]
) -> list[tuple[Evidence, int]]:
    rows = connection.execute(
        "SELECT scope, session, search, recorded_at, board_type, component, board, hole, ending,"
        f" search.x, search.y, seated_x, seated_y, slid, {LIFE}, checksum,"
        " number, attempt.x, attempt.y, outcome, path"
        f" FROM search LEFT JOIN attempt ON search_id = id WHERE {where} ORDER BY {IN_ORDER}, number",
        values,
    )
    return [
        (_evidence(head, [row[16:] for row in group if row[16] is not None]), head[15])
        for head, group in groupby(rows, key=lambda row: row[:16])
    ]


def _evidence(head: tuple[Any, ...], attempts: list[tuple[Any, ...]]) -> Evidence:
    *identity, component, board, hole, ending, x, y, seated_x, seated_y, slid, life, _ = head
    scope, session, search, recorded_at, board_type = identity
    tried = tuple(
        Tried(number, x_, y_, Outcome(outcome), points_of(path)) for number, x_, y_, outcome, path in attempts
    )
    return Evidence(
        scope=scope,
        session=session,
        search=search,
        recorded_at=recorded_at,
        board_type=board_type,
        component=component,
        board=board,
        hole=hole,
        ending=Ending(ending),
        x=x,
        y=y,
        seated_x=seated_x,
        seated_y=seated_y,
        slid=bool(slid),
        tried=tried,
        life=life,
    )


def points_of(path: str | None) -> tuple[tuple[float, float], ...]:
    """Points [m] of a slide as the file keeps them."""
    return tuple((x, y) for x, y in json.loads(path)) if path else ()


def path_text(points: tuple[tuple[float, float], ...]) -> str | None:
    """Points [m] of a slide for the file; None for a peck."""
    return json.dumps(points) if points else None


class DamagedError(Exception):
    """The file is no readable store any more."""


def open_file(path: Path, access: Access) -> sqlite3.Connection:
    """Open a store's file. Raises DamagedError, InputError if it is none, SessionError if it cannot be used now."""
    if str(path) != IN_MEMORY:
        _check_place(path, access)
    try:
        return _opened(path, access)
    except (ValueError, TypeError) as error:  # of rows that cannot be read as evidence
        raise DamagedError(str(error)) from error
    except sqlite3.Error as error:
        # Our own SQL is right, so an error in it means that the tables are not as we left them.
        name = getattr(error, "sqlite_errorname", "SQLITE_ERROR")
        if name.startswith(("SQLITE_CORRUPT", "SQLITE_NOTADB", "SQLITE_ERROR", "SQLITE_CONSTRAINT")):
            raise DamagedError(str(error)) from error
        raise failure(path.name, error) from error


def failure(name: str, error: sqlite3.Error) -> SessionError | InputError:
    """What a person can do about an error of the store `name`."""
    text = str(error)
    code = getattr(error, "sqlite_errorname", "")
    if code.startswith("SQLITE_CANTOPEN"):
        return InputError(f"posterior store {name}: cannot be opened ({text}); check the path and its permissions")
    remedy = {
        "SQLITE_BUSY": "another process is writing to it; end that one, or name another file",
        "SQLITE_READONLY": "it may not be written to; change its permissions, or name another file",
        "SQLITE_FULL": "the disk is full; make room",
        "SQLITE_CORRUPT": "it was damaged in use; start again, which sets it aside",
    }
    advice = next((words for start, words in remedy.items() if code.startswith(start)), "start the session again")
    return SessionError(f"posterior store {name}: {text}: {advice}")


def _check_place(path: Path, access: Access) -> None:
    if path.is_dir():
        raise InputError(f"posterior store {path.name or path}: this is a directory; name a file in it")
    if access is Access.READ:
        if not path.is_file():
            raise InputError(missing(path))
        return
    try:
        made = [folder for folder in (path.parent, *path.parent.parents) if not folder.exists()]
        path.parent.mkdir(parents=True, exist_ok=True)
        for folder in made:  # else a new folder may be gone after a power loss, with the synced file in it
            _sync(folder.parent)
    except OSError as error:
        raise InputError(
            f"posterior store {path.name}: its directory cannot be made ({error.strerror}); choose another place"
        ) from error


def missing(path: Path) -> str:
    """What to say of a store that is not there: where it was looked for, and what exists."""
    others = sorted(found.name for found in path.parent.glob("*.sqlite*") if found.suffix in (".sqlite", ".sqlite3"))
    exists = ", ".join(others) if others else "none; a session makes one"
    return f"no posterior store {path}; in {path.parent}/ there is {exists}"


def _sync(folder: Path) -> None:
    number = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(number)
    finally:
        os.close(number)


def _opened(path: Path, access: Access) -> sqlite3.Connection:
    connection = _connect(path, access)
    try:
        version = _recognise(connection, path.name)
        damage = connection.execute("PRAGMA integrity_check(1)").fetchone()[0] if version else "ok"
        if damage != "ok":
            raise DamagedError(damage)
        if access is Access.READ:
            connection.execute("PRAGMA query_only = ON")
            if version == 0:
                raise InputError(f"posterior store {path.name}: nothing was ever stored in it")
            if version < SCHEMA_VERSION:
                connection = _copied(connection)
                _migrate(connection)
        else:
            connection.execute("PRAGMA journal_mode = WAL").fetchone()
            connection.execute("PRAGMA synchronous = FULL")
            connection.execute("PRAGMA foreign_keys = ON")
            if version == 0:
                _create(connection)
            elif version < SCHEMA_VERSION:
                _migrate(connection)
        _verify(connection)
    except BaseException:
        connection.close()
        raise
    return connection


def _connect(path: Path, access: Access) -> sqlite3.Connection:
    def connect(name: str | Path, *, uri: bool = False) -> sqlite3.Connection:
        return sqlite3.connect(name, timeout=_BUSY, isolation_level=None, check_same_thread=False, uri=uri)

    if access is not Access.READ:
        return connect(path)
    # Opened for reading and writing: SQLite then removes the files beside it that a reader of a log needs.
    name = f"file:{quote(str(path.absolute()))}"
    connection = connect(f"{name}?mode=rw", uri=True)
    try:
        connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
    except sqlite3.OperationalError as error:
        log = path.with_name(f"{path.name}-wal")
        unwritable = error.sqlite_errorname.startswith(("SQLITE_CANTOPEN", "SQLITE_READONLY"))
        if not unwritable or log.exists():
            connection.close()
            raise
        connection.close()
        return connect(f"{name}?immutable=1", uri=True)  # nobody can be writing where nothing may be written
    except sqlite3.DatabaseError:
        connection.close()
        raise
    return connection


def _copied(connection: sqlite3.Connection) -> sqlite3.Connection:
    copy = sqlite3.connect(IN_MEMORY, isolation_level=None, check_same_thread=False)
    connection.backup(copy)
    connection.close()
    return copy


def _recognise(connection: sqlite3.Connection, name: str) -> int:
    """Version of the format; 0 for a new file. Raises InputError for a file that is none of ours, or newer."""
    application = connection.execute("PRAGMA application_id").fetchone()[0]
    version = int(connection.execute("PRAGMA user_version").fetchone()[0])
    tables = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]
    if tables and application != _APPLICATION_ID:
        raise InputError(f"posterior store {name}: this is another program's database; name another file")
    if version > SCHEMA_VERSION:
        raise InputError(
            f"posterior store {name}: written by a newer palpate (format {version}, this one reads"
            f" {SCHEMA_VERSION}); update palpate or name another file"
        )
    if version < 0 or (tables and version == 0):
        raise DamagedError(f"its format {version} never existed")
    return version


def _create(connection: sqlite3.Connection) -> None:
    connection.execute("BEGIN IMMEDIATE")
    if connection.execute("PRAGMA user_version").fetchone()[0] == 0:  # nobody was faster
        for statement in (*_SCHEMA, *_TURNS_AND_ORDER):
            connection.execute(statement)
        connection.execute(f"PRAGMA application_id = {_APPLICATION_ID}")
        connection.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")
    connection.execute("COMMIT")


def _migrate(connection: sqlite3.Connection) -> None:
    connection.execute("BEGIN IMMEDIATE")
    version = connection.execute("PRAGMA user_version").fetchone()[0]  # somebody may have been faster
    for step in range(version, SCHEMA_VERSION):
        _MIGRATIONS[step](connection)
    connection.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")
    connection.execute("COMMIT")


def _keep_slides(connection: sqlite3.Connection) -> None:
    connection.execute("ALTER TABLE attempt ADD COLUMN path TEXT")
    connection.execute("ALTER TABLE search ADD COLUMN slid INTEGER NOT NULL DEFAULT 0")


def _keep_times(connection: sqlite3.Connection) -> None:
    """Times of recording are told from the sessions' names, which are dates, and so that the order stays as it was.

    Two copies of one file that are migrated apart get the same times, so that their evidence counts once.
    """
    connection.execute("ALTER TABLE search ADD COLUMN recorded_at INTEGER NOT NULL DEFAULT 0")
    connection.execute("ALTER TABLE search ADD COLUMN checksum INTEGER NOT NULL DEFAULT 0")
    connection.execute("DROP INDEX search_by_component")
    connection.execute(_TURNS_AND_ORDER[0])
    stamp = -1
    for number, session, search in connection.execute("SELECT id, session, search FROM search ORDER BY id").fetchall():
        stamp = max(_time_in(session) + search, stamp + 1)
        connection.execute("UPDATE search SET recorded_at = ? WHERE id = ?", (stamp, number))
    for evidence in read_evidence(connection):
        connection.execute(
            "UPDATE search SET checksum = ? WHERE scope = ? AND session = ? AND search = ?",
            (evidence.checksum, *evidence.identity),
        )
    for statement in _TURNS_AND_ORDER[1:]:
        connection.execute(statement)


def _time_in(session: str) -> int:
    """The date in a session's name, `20261122-151233`, taken as UTC [ns]; 0 if there is none."""
    with suppress(ValueError):
        return int(datetime.strptime(f"{session[:15]} +0000", "%Y%m%d-%H%M%S %z").timestamp()) * NANOSECONDS
    return 0


_MIGRATIONS: dict[int, Callable[[sqlite3.Connection], None]] = {1: _keep_slides, 2: _keep_times}  # to the next version


def _verify(connection: sqlite3.Connection) -> None:
    """Raise DamagedError unless every piece of evidence is as it was stored."""
    for evidence, checksum in _with_checksums(connection, "1", ()):
        if evidence.checksum != checksum:
            raise DamagedError(f"search {evidence.search} of session {evidence.session} is not as it was stored")
    gaps = "SELECT search_id FROM turn GROUP BY search_id HAVING min(life) != 2 OR max(life) != 1 + count(*)"
    orphans = "SELECT search_id FROM attempt WHERE search_id NOT IN (SELECT id FROM search)"
    if connection.execute(f"{gaps} UNION {orphans} LIMIT 1").fetchone() is not None:
        raise DamagedError("attempts or forgettings belong to no search")
