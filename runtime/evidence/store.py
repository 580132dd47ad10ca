"""The durable memory of a board type: every search, every attempt, where each part was seated. One SQLite file.

Evidence is only ever added. A board type's evidence is kept apart by `scope`, the world it was gathered in ("real",
"sim-seed-7"): simulated boards with other seeds are other boards, and no simulated one is a real one.

What is forgotten stays in the file and counts no more. So a copy of it that comes back, from a file or from another
cell, is recognised and does not count either, until somebody recalls it. Forgetting travels like evidence does: of two
stores that exchange what they know (`digest`, `lacking`, `add`) both end up with the same.
"""

from __future__ import annotations

import json
import sqlite3
import threading
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from runtime.clock import wall_nanoseconds
from runtime.closing import Closing
from runtime.errors import InputError, SessionError
from runtime.evidence.digest import Digest, Run
from runtime.evidence.evidence import Evidence, evidence_of, misses_of, seats_of
from runtime.evidence.file import (
    COUNTS,
    IN_ORDER,
    LIFE,
    Access,
    DamagedError,
    failure,
    open_file,
    path_text,
    read_evidence,
)
from runtime.messages import Attempt, Ending, Miss, SearchResult, Seat


@dataclass(frozen=True, slots=True)
class Merge:
    """What came of adding evidence from elsewhere."""

    added: int  # pieces that were new here
    known: int  # that were here already
    turned: int  # known ones that the giver had forgotten or recalled since
    forgotten: int  # pieces given that do not count here now
    conflicts: tuple[Evidence, ...]  # left out: other content under an identity that is taken


@dataclass(frozen=True, slots=True)
class Holding:
    """What a store holds of one component in one board type in one world."""

    board_type: str
    component: str
    scope: str
    searches: int
    inserted: int
    exhausted: int
    aborted: int
    sessions: int
    first: int  # [ns] since 1970, time of recording
    last: int  # [ns]
    forgotten: int  # searches beside those counted above


class PosteriorStore(Closing):
    """Evidence about holes in one SQLite file, or in memory for the path ":memory:". Safe from any thread.

    What `record` and `add` have returned from survives the death of the process and of the machine (write-ahead log,
    synced at each commit). Opened by a cell (`Access.OWN`), a damaged file is renamed and a fresh one begun;
    `set_aside` then names the old one.

    Raises InputError if the path cannot be a store: a directory, another program's database, a newer palpate's file.
    Raises SessionError if the file fails in use: locked, read-only, disk full; or is damaged and access is not OWN.
    """

    def __init__(self, path: str | Path, access: Access = Access.OWN) -> None:
        self._path = Path(path)
        self._name = self._path.name
        self._lock = threading.Lock()
        self.set_aside: Path | None = None  # where a damaged file was moved to, if one was found
        try:
            self._connection = open_file(self._path, access)
        except DamagedError as damage:
            if access is not Access.OWN:
                raise SessionError(
                    f"posterior store {self._name}: damaged, or no store at all ({damage}); a session sets it aside"
                    " and begins anew"
                ) from damage
            self.set_aside = self._move_aside()
            self._connection = open_file(self._path, access)

    def record(
        self, board_type: str, result: SearchResult, session: str, attempts: Sequence[Attempt], *, scope: str
    ) -> bool:
        """Store how a search ended and all its attempts; durable on return.

        A search already stored under the same session and number stays as it is: False. InputError if an attempt
        belongs to another search. The time of recording is the machine's, but later than that of all evidence held:
        a clock set back changes no order, nor does one that differs between cells.
        """
        fresh = evidence_of(board_type, result, session, attempts, scope=scope, recorded_at=wall_nanoseconds())
        with self._transaction() as connection:
            newest = connection.execute("SELECT max(recorded_at) FROM search").fetchone()[0]
            if newest is not None and newest >= fresh.recorded_at:
                fresh = replace(fresh, recorded_at=newest + 1)
            return _insert(connection, fresh)

    def seats(self, board_type: str, component: str, *, scope: str) -> list[Seat]:
        """Every insertion of this component into boards of this type, oldest first."""
        found = self.evidence(board_type, component, scope=scope)
        return [seat for piece in found for seat in seats_of(piece, piece.board)]

    def misses(self, board_type: str, component: str, *, scope: str) -> list[Miss]:
        """Every attempt that was blocked, oldest first."""
        found = self.evidence(board_type, component, scope=scope)
        return [miss for piece in found for miss in misses_of(piece, piece.board)]

    def identities(self, board_type: str, component: str, *, scope: str) -> set[tuple[str, int]]:
        """Session and number of every search that counts."""
        rows = self._read(
            f"SELECT session, search FROM search WHERE scope = ? AND board_type = ? AND component = ? AND {COUNTS}",
            (scope, board_type, component),
        )
        return {(session, search) for session, search in rows}

    def evidence(
        self,
        board_type: str | None = None,
        component: str | None = None,
        *,
        scope: str | None = None,
        forgotten: bool = False,
    ) -> list[Evidence]:
        """All evidence of a board type, component and scope, or of any of them; oldest first.

        With `forgotten`, also that which counts no more.
        """
        condition = (
            "(?1 IS NULL OR board_type = ?1) AND (?2 IS NULL OR component = ?2) AND (?3 IS NULL OR scope = ?3)"
            f" AND (?4 OR {COUNTS})"
        )
        with self._reading() as connection:
            return read_evidence(connection, condition, (board_type, component, scope, forgotten))

    def holdings(self) -> list[Holding]:
        """What there is, by board type, component and scope."""
        counted = ", ".join(f"sum(counts AND ending = {int(ending)})" for ending in Ending)
        rows = self._read(
            f"SELECT board_type, component, scope, sum(counts), {counted},"
            " count(DISTINCT CASE WHEN counts THEN session END), min(recorded_at), max(recorded_at), sum(NOT counts)"
            f" FROM (SELECT *, {COUNTS} AS counts FROM search)"
            " GROUP BY board_type, component, scope ORDER BY board_type, component, scope",
            (),
        )
        return [Holding(*row) for row in rows]

    def add(self, evidence: Iterable[Evidence], *, all_or_none: bool = False) -> Merge:
        """Take over evidence from elsewhere; durable on return. Adding it again changes nothing.

        What has other content than the evidence held under its identity is left out and reported; with `all_or_none`
        it raises InputError, and nothing is added.
        """
        added = known = turned = forgotten = 0
        conflicts = []
        with self._transaction() as connection:
            for given in evidence:
                held = _held(connection, given)
                if held is None:
                    _insert(connection, given)
                    added += 1
                elif replace(held, life=given.life) == given:
                    known += 1
                    turned += given.life > held.life
                    _turn(connection, given, since=held.life)
                else:
                    conflicts.append(given)
                    continue
                forgotten += max(given.life, held.life if held else 1) % 2 == 0
            if conflicts and all_or_none:
                raise InputError(
                    f"search {conflicts[0].search} of session {conflicts[0].session} ({conflicts[0].scope}) is in"
                    f" {self._name} with other content; {len(conflicts)} such in all"
                )
        return Merge(added, known, turned, forgotten, tuple(conflicts))

    def digest(self) -> Digest:
        """What is known here, forgotten evidence included, in brief."""
        rows = self._read(
            "SELECT scope, session, min(search), max(search), life FROM ("
            " SELECT scope, session, search, life,"
            " search - row_number() OVER (PARTITION BY scope, session, life ORDER BY search) AS run"
            f" FROM (SELECT scope, session, search, {LIFE} AS life FROM search)"
            ") GROUP BY scope, session, life, run",
            (),
        )
        return Digest(Run(*row) for row in rows)

    def lacking(self, digest: Digest, most: int | None = None) -> list[Evidence]:
        """What another store lacks, or has not yet forgotten or recalled, by its digest: the oldest `most` of it."""
        with self._reading() as connection:
            rows = connection.execute(
                f"SELECT id, scope, session, search, {LIFE} FROM search ORDER BY {IN_ORDER}"
            ).fetchall()
            wanted = [number for number, *identity, life in rows if digest.life(*identity) < life][:most]
            return read_evidence(connection, "id IN (SELECT value FROM json_each(?))", (json.dumps(wanted),))

    def revision(self) -> tuple[int, int]:
        """Another value after every change, through this store or by another process."""
        with self._reading() as connection:
            elsewhere = connection.execute("PRAGMA data_version").fetchone()[0]
            return int(elsewhere), connection.total_changes

    def forget(self, board_type: str | None = None, *, scope: str | None = None) -> int:
        """Let the evidence of a board type, or of all, in one scope or all, count no more; how many searches."""
        return self._turn_all(1, board_type, scope)

    def recall(self, board_type: str | None = None, *, scope: str | None = None) -> int:
        """Let forgotten evidence count again; how many searches."""
        return self._turn_all(0, board_type, scope)

    def close(self) -> None:
        """Close the file; closing twice is harmless."""
        with self._lock:
            self._connection.close()

    def _turn_all(self, parity: int, board_type: str | None, scope: str | None) -> int:
        with self._transaction() as connection:
            return connection.execute(
                f"INSERT INTO turn (search_id, life) SELECT id, 1 + {LIFE} FROM search"
                f" WHERE (?1 IS NULL OR board_type = ?1) AND (?2 IS NULL OR scope = ?2) AND {LIFE} % 2 = ?3",
                (board_type, scope, parity),
            ).rowcount

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
    def _reading(self) -> Iterator[sqlite3.Connection]:
        with self._lock:
            try:
                self._connection.execute("BEGIN")
                try:
                    yield self._connection
                finally:
                    if self._connection.in_transaction:
                        self._connection.execute("ROLLBACK")
            except sqlite3.Error as error:
                raise failure(self._name, error) from error

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
                raise failure(self._name, error) from error

    def _read(self, query: str, values: tuple[object, ...]) -> list[tuple[Any, ...]]:
        with self._reading() as connection:
            return connection.execute(query, values).fetchall()


def _insert(connection: sqlite3.Connection, evidence: Evidence) -> bool:
    added = connection.execute(
        "INSERT INTO search (scope, session, search, recorded_at, board_type, component, board, hole, ending,"
        " x, y, seated_x, seated_y, slid, checksum) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)"
        " ON CONFLICT (scope, session, search) DO NOTHING",
        (
            *evidence.identity,
            evidence.recorded_at,
            evidence.board_type,
            evidence.component,
            evidence.board,
            evidence.hole,
            int(evidence.ending),
            *(evidence.x, evidence.y, evidence.seated_x, evidence.seated_y),
            evidence.slid,
            evidence.checksum,
        ),
    )
    if added.rowcount == 0:
        return False
    connection.executemany(
        "INSERT INTO attempt (search_id, number, x, y, outcome, path) VALUES (?, ?, ?, ?, ?, ?)",
        [
            (
                added.lastrowid,
                item.number,
                item.x,
                item.y,
                int(item.outcome),
                path_text(item.path),
            )
            for item in evidence.tried
        ],
    )
    _turn(connection, evidence, since=1)
    return True


def _held(connection: sqlite3.Connection, evidence: Evidence) -> Evidence | None:
    found = read_evidence(connection, "scope = ? AND session = ? AND search = ?", evidence.identity)
    return found[0] if found else None


def _turn(connection: sqlite3.Connection, evidence: Evidence, since: int) -> None:
    """Bring the life of evidence held, `since` so far, up to that of its copy."""
    connection.executemany(
        "INSERT INTO turn (search_id, life) SELECT id, ? FROM search WHERE scope = ? AND session = ? AND search = ?",
        [(life, *evidence.identity) for life in range(since + 1, evidence.life + 1)],
    )
