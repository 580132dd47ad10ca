"""The posterior store keeps what it acknowledged, through crashes and damage, and keeps worlds apart."""

from __future__ import annotations

import json
import math
import random
import shutil
import sqlite3
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest
from search_samples import REAL, found, tries

from runtime.errors import InputError, PalpateError, SessionError
from runtime.evidence.evidence import Tried
from runtime.evidence.file import SCHEMA_VERSION, Access
from runtime.evidence.store import PosteriorStore
from runtime.messages import Ending, Miss, Outcome, Waypoint

ROOT = Path(__file__).parent.parent


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "made" / "holes.sqlite"


def test_second_open_sees_everything_in_order(path: Path) -> None:
    with PosteriorStore(path) as store:
        for search in (3, 1, 2):
            assert store.record("driver", found(search, f"h{search}"), "monday", tries(search), scope=REAL)
    with PosteriorStore(path) as store:
        seats = store.seats("driver", "igbt", scope=REAL)
        assert [seat.hole for seat in seats] == ["h3", "h1", "h2"]
        assert (seats[0].session, seats[0].board, seats[0].x, seats[0].y) == ("monday", 1, 1e-4, -1e-4)
        assert seats[0].seated_x == pytest.approx(1.1e-4)
        assert math.isnan(seats[0].seated_y)
        assert store.set_aside is None


def test_failures_are_kept_but_are_no_seats(path: Path) -> None:
    with PosteriorStore(path) as store:
        store.record("driver", found(1, ending=Ending.EXHAUSTED), "monday", tries(1)[:1], scope=REAL)
        assert store.seats("driver", "igbt", scope=REAL) == []
        (kept,) = store.evidence("driver", "igbt", scope=REAL)
        assert (kept.session, kept.search, kept.board, kept.hole) == ("monday", 1, 1, "h1")
        assert kept.ending is Ending.EXHAUSTED
        assert (kept.x, kept.seated_x) == (None, None)
        assert kept.tried == (Tried(1, 0.0, 0.0, Outcome.BLOCKED),)


def test_slides_and_misses_are_kept(path: Path) -> None:
    slid = [Waypoint(0.0, 0.0), Waypoint(1e-3, -2e-3)]
    with PosteriorStore(path) as store:
        peck = tries(1)[0]
        slide = replace(peck, number=2, path=slid)
        lost = found(1, ending=Ending.EXHAUSTED)
        store.record("driver", replace(lost, attempts=2), "monday", [peck, slide], scope=REAL)
        touched = replace(tries(2)[-1], path=[Waypoint(tries(2)[-1].x, tries(2)[-1].y), *slid])
        store.record("driver", found(2), "monday", [*tries(2)[:-1], touched], scope=REAL)
        caught = replace(tries(3)[-1], path=slid)
        store.record("driver", found(3), "monday", [*tries(3)[:-1], caught], scope=REAL)
    with PosteriorStore(path) as store:
        assert [seat.slid for seat in store.seats("driver", "igbt", scope=REAL)] == [False, True]
        assert store.misses("driver", "igbt", scope=REAL)[:2] == [
            Miss(1, "h1", [Waypoint(peck.x, peck.y)]),
            Miss(1, "h1", slid),
        ]
        assert store.misses("driver", "igbt", scope="elsewhere") == []
        kept = store.evidence("driver", "igbt", scope=REAL)
        assert [tried.path for tried in kept[0].tried] == [(), ((0.0, 0.0), (1e-3, -2e-3))]


SECOND_FORMAT = """
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
PRAGMA application_id = 1885432944;
PRAGMA user_version = 2;
PRAGMA journal_mode = WAL;
INSERT INTO search VALUES
    (1, 'real', 'driver', '20260102-101010', 1, 1, 'h1', 'igbt', 1, 1e-4, -1e-4, 1.1e-4, NULL, 0),
    (2, 'real', 'driver', '20260102-101010', 2, 1, 'h2', 'igbt', 2, NULL, NULL, NULL, NULL, 0),
    (4, 'real', 'driver', '20260101-101010', 1, 1, 'h1', 'igbt', 1, 2e-4, -2e-4, 2e-4, -2e-4, 1),
    (5, 'real', 'driver', 'line two', 1, 1, 'h2', 'igbt', 1, 3e-4, 3e-4, 3e-4, 3e-4, 0);
INSERT INTO attempt VALUES
    (1, 1, 0.0, 0.0, 2, NULL), (1, 2, 1e-4, -1e-4, 1, NULL),
    (2, 1, 0.0, 0.0, 2, '[[0.0, 0.0], [0.001, -0.002]]'),
    (4, 1, 2e-4, -2e-4, 1, '[[0.0, 0.0], [0.001, -0.002]]'),
    (5, 1, 3e-4, 3e-4, 1, NULL);
"""
FIRST_FORMAT = (
    SECOND_FORMAT
    + """
ALTER TABLE attempt DROP COLUMN path;
ALTER TABLE search DROP COLUMN slid;
PRAGMA user_version = 1;
"""
)


def run_sql(path: Path, script: str) -> list[tuple[object, ...]]:
    """Do what a script says, and return what its last statement gives."""
    path.parent.mkdir(exist_ok=True)
    with closing(sqlite3.connect(path, isolation_level=None)) as connection:
        *first, last = [statement for statement in script.split(";\n") if statement.strip()]
        for statement in first:
            connection.execute(statement)
        return connection.execute(last).fetchall()


@pytest.mark.parametrize("version", [1, 2])
def test_files_of_older_formats_are_brought_up_to_date(path: Path, version: int) -> None:
    run_sql(path, FIRST_FORMAT if version == 1 else SECOND_FORMAT)
    with PosteriorStore(path, Access.READ) as store:
        looked_at = store.evidence()
    assert run_sql(path, "PRAGMA user_version") == [(version,)]  # looking changes nothing
    copy = path.with_name("copy.sqlite")
    shutil.copy(path, copy)
    with PosteriorStore(path) as store, PosteriorStore(copy) as other:
        seats = store.seats("driver", "igbt", scope=REAL)
        assert [(seat.session, seat.hole, seat.x) for seat in seats] == [
            ("20260102-101010", "h1", 1e-4),
            ("20260101-101010", "h1", 2e-4),
            ("line two", "h2", 3e-4),
        ]  # in their old order
        assert [seat.slid for seat in seats] == [False, version == 2, False]
        assert [len(miss.path) for miss in store.misses("driver", "igbt", scope=REAL)] == [1, 2 if version == 2 else 1]
        assert store.evidence() == looked_at
        assert store.record("driver", found(9), "tuesday", tries(9), scope=REAL)
        assert store.evidence()[-1].session == "tuesday"  # what is new comes after what was
        assert store.add(other.evidence()).known == 4  # a copy migrated apart is no other evidence
    assert run_sql(path, "PRAGMA user_version") == [(SCHEMA_VERSION,)]
    fresh = path.with_name("fresh.sqlite")
    PosteriorStore(fresh).close()
    names = "SELECT type, name, tbl_name FROM sqlite_master ORDER BY 1, 2"
    columns = "SELECT m.name, c.name, c.type, c.pk FROM sqlite_master m, pragma_table_info(m.name) c ORDER BY 1, 2"
    for query in (names, columns):
        assert run_sql(path, query) == run_sql(fresh, query)


def test_recording_a_search_again_changes_nothing(path: Path) -> None:
    with PosteriorStore(path) as store:
        assert store.record("driver", found(1), "monday", tries(1), scope=REAL)
        before = store.seats("driver", "igbt", scope=REAL), store.evidence()
        assert not store.record("driver", found(1, x=9e-4), "monday", tries(1), scope=REAL)
        after = store.seats("driver", "igbt", scope=REAL), store.evidence()
        assert [seat.x for seat in after[0]] == [seat.x for seat in before[0]] == [1e-4]
        assert after[1] == before[1]
        assert [len(kept.tried) for kept in after[1]] == [2]


def test_sessions_components_boards_and_worlds_are_kept_apart(path: Path) -> None:
    with PosteriorStore(path) as store:
        for scope in (REAL, "sim-seed-7"):
            for session in ("monday", "tuesday"):
                for board_type in ("driver", "psu"):
                    name = f"{session}-{board_type}"
                    assert store.record(board_type, found(1), name, tries(1), scope=scope)
        store.record("driver", found(2), "monday-driver", tries(2), scope="sim-seed-7")
        assert len(store.seats("driver", "igbt", scope=REAL)) == 2
        assert len(store.seats("driver", "igbt", scope="sim-seed-7")) == 3
        assert store.seats("driver", "igbt", scope="sim-seed-8") == []
        assert store.seats("driver", "capacitor", scope=REAL) == []
        assert store.seats("psu", "igbt", scope=REAL) != []
        assert store.seats("psu", "igbt", scope="sim-seed-8") == []


def test_forget_takes_just_what_was_named_and_recall_brings_it_back(path: Path) -> None:
    with PosteriorStore(path) as store:
        for number, (board_type, scope) in enumerate([("driver", REAL), ("driver", "sim"), ("psu", REAL)], start=1):
            store.record(board_type, found(number), "monday", tries(number), scope=scope)
        whole = store.evidence()
        assert store.forget("nothing") == 0
        assert store.forget("driver", scope="sim") == 1
        assert store.seats("driver", "igbt", scope="sim") == store.misses("driver", "igbt", scope="sim") == []
        assert len(store.misses("driver", "igbt", scope=REAL)) == 1
        assert store.forget("driver") == 1  # the other is forgotten already
        assert [item.board_type for item in store.evidence()] == ["psu"]
        assert store.forget() == 1
        assert store.evidence() == []
        assert [item.forgotten for item in store.evidence(forgotten=True)] == [True] * 3
        assert not store.record("driver", found(1), "monday", tries(1), scope=REAL)  # nothing comes back by itself
        assert store.evidence() == []
        assert store.recall("driver") == 2
        assert [replace(item, life=1) for item in store.evidence()] == whole[:2]
        assert store.recall("driver") == 0
        assert store.forget("driver", scope=REAL) == 1
    with PosteriorStore(path) as store:
        assert [item.scope for item in store.evidence()] == ["sim"]


def test_the_file_itself_refuses_changes_of_evidence(path: Path) -> None:
    fill(path, 2)
    with PosteriorStore(path) as store:
        store.forget()
    for statement in (
        *(f"DELETE FROM {table}" for table in ("search", "attempt", "turn")),
        "UPDATE search SET x = 0",
        "UPDATE attempt SET outcome = 1",
        "UPDATE turn SET life = 3",
    ):
        with pytest.raises(sqlite3.IntegrityError, match="appended, never overwritten"):
            run_sql(path, statement)


def test_order_follows_recording_even_if_the_clock_is_set_back(path: Path) -> None:
    with PosteriorStore(path) as store:
        store.record("driver", found(1), "monday", tries(1), scope=REAL)
        (first,) = store.evidence()
        ahead = replace(first, session="elsewhere", recorded_at=first.recorded_at + 3600 * 10**9)
        assert store.add([ahead]).added == 1
        store.record("driver", found(2), "monday", tries(2), scope=REAL)
        assert [item.session for item in store.evidence()] == ["monday", "elsewhere", "monday"]
        assert store.evidence()[-1].recorded_at == ahead.recorded_at + 1


def test_attempts_of_another_search_are_refused_whole(path: Path) -> None:
    with PosteriorStore(path) as store:
        with pytest.raises(InputError, match="search 1 cannot store attempts of search 2"):
            store.record("driver", found(1), "monday", tries(2), scope=REAL)
        with pytest.raises(SessionError, match=r"holes\.sqlite"):  # the same attempt number twice
            store.record("driver", found(1), "monday", [tries(1)[0], tries(1)[0]], scope=REAL)
        assert store.seats("driver", "igbt", scope=REAL) == []
        assert store.record("driver", found(1), "monday", tries(1), scope=REAL)


def test_kills_at_random_moments_lose_nothing_and_leave_nothing_half(path: Path) -> None:
    program = [sys.executable, str(ROOT / "tests" / "kill_store.py"), str(path), "--kills", "25", "--seed", "1"]
    done = subprocess.run(program, capture_output=True, text=True, timeout=120, check=True)
    figures = json.loads(done.stdout)
    assert figures["kills"] == 25
    assert figures["acknowledged"] > 50
    assert (figures["lost"], figures["half"], figures["twice"]) == (0, 0, 0)
    with PosteriorStore(path) as store:
        assert len(store.evidence()) == figures["stored"]


def fill(path: Path, searches: int = 80) -> None:
    with PosteriorStore(path) as store:
        for search in range(1, searches + 1):
            store.record("driver", found(search), "monday", tries(search), scope=REAL)


@pytest.mark.parametrize("damage", ["head", "middle", "cut"])
def test_a_damaged_file_is_set_aside_and_a_fresh_one_begun(path: Path, damage: str) -> None:
    fill(path)
    content = path.read_bytes()
    pages = {
        "head": b"\xff" * 4096 + content[4096:],
        "middle": content[:4096] + b"\xa5" * (len(content) - 8192) + content[-4096:],
        "cut": content[: len(content) // 2],
    }
    path.write_bytes(pages[damage])
    with PosteriorStore(path) as store:
        assert store.set_aside is not None
        assert store.set_aside.name == "holes.sqlite.damaged-1"
        assert store.set_aside.read_bytes() == pages[damage]
        assert store.seats("driver", "igbt", scope=REAL) == []
        assert store.record("driver", found(1), "monday", tries(1), scope=REAL)
    path.write_bytes(b"\x00" * 100)
    with PosteriorStore(path) as store:
        assert store.set_aside is not None
        assert store.set_aside.name == "holes.sqlite.damaged-2"


def test_no_flipped_bit_goes_unnoticed(path: Path) -> None:
    """Each is told as damage or another format, or lies where nothing is kept: never is evidence other than it was."""
    fill(path, 12)
    with PosteriorStore(path) as store:
        store.forget(scope="nowhere")
        whole = store.evidence()
    content = path.read_bytes()
    draw = random.Random(5)
    told = 0
    for place in sorted(draw.sample(range(len(content)), 150)):
        flipped = bytearray(content)
        flipped[place] ^= 1 << draw.randrange(8)
        path.write_bytes(flipped)
        for companion in ("-wal", "-shm"):
            path.with_name(path.name + companion).unlink(missing_ok=True)
        try:
            with PosteriorStore(path, Access.READ) as store:
                assert store.evidence() == whole, place
                assert len(store.seats("driver", "igbt", scope=REAL)) == len(whole), place
                assert len(store.misses("driver", "igbt", scope=REAL)) == len(whole), place
        except PalpateError:
            told += 1
        assert path.read_bytes() == bytes(flipped)  # who looks changes nothing
    assert told > 10


def test_a_damaged_store_is_only_reported_to_who_looks(path: Path) -> None:
    path.parent.mkdir()
    path.write_bytes(b"\xff" * 5000)
    for access in (Access.READ, Access.EDIT):
        with pytest.raises(SessionError, match=r"holes\.sqlite: damaged"):
            PosteriorStore(path, access)
    assert [found.name for found in path.parent.iterdir()] == [path.name]


def test_who_looks_sees_what_a_running_cell_has_stored_and_leaves_nothing_behind(path: Path) -> None:
    with PosteriorStore(path) as cell:
        cell.record("driver", found(1), "monday", tries(1), scope=REAL)
        with PosteriorStore(path, Access.READ) as looking:
            cell.record("driver", found(2), "monday", tries(2), scope=REAL)
            assert len(looking.evidence()) == 2
            with pytest.raises(SessionError, match="it may not be written to"):
                looking.forget()
        assert len(cell.evidence()) == 2
    with PosteriorStore(path, Access.READ):
        pass
    assert [found.name for found in path.parent.iterdir()] == [path.name]
    with pytest.raises(InputError, match=r"no posterior store .*tidy\.sqlite; in .* there is holes\.sqlite"):
        PosteriorStore(path.with_name("tidy.sqlite"), Access.READ)
    assert [found.name for found in path.parent.iterdir()] == [path.name]


def test_other_programs_databases_and_newer_files_are_left_alone(path: Path, tmp_path: Path) -> None:
    other = tmp_path / "contacts.db"
    with sqlite3.connect(other) as connection:
        connection.execute("CREATE TABLE people (name TEXT)")
    connection.close()
    with pytest.raises(InputError, match=r"contacts\.db: this is another program's database"):
        PosteriorStore(other)
    fill(path, 1)
    with sqlite3.connect(path) as connection:
        connection.execute("PRAGMA user_version = 99")
    connection.close()
    with pytest.raises(InputError, match=r"holes\.sqlite: written by a newer palpate \(format 99"):
        PosteriorStore(path)
    with pytest.raises(InputError, match="is a directory"):
        PosteriorStore(tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="its directory cannot be made"):
        PosteriorStore(tmp_path / "file" / "holes.sqlite")


def test_errors_name_the_file_and_a_remedy(path: Path) -> None:
    store = PosteriorStore(path)
    store.close()
    store.close()
    with pytest.raises(SessionError, match=r"posterior store holes\.sqlite: .*closed"):
        store.seats("driver", "igbt", scope=REAL)


def test_threads_of_the_process_share_it(path: Path) -> None:
    with PosteriorStore(path) as store:

        def work(search: int) -> int:
            store.record("driver", found(search), "monday", tries(search), scope=REAL)
            return len(store.seats("driver", "igbt", scope=REAL))

        with ThreadPoolExecutor(4) as pool:
            counts = list(pool.map(work, range(1, 41)))
        assert max(counts) == 40
        assert {seat.board for seat in store.seats("driver", "igbt", scope=REAL)} == {1, 2, 3, 4, 5}


@pytest.mark.parametrize("pragma", [("journal_mode", "wal"), ("user_version", SCHEMA_VERSION)])
def test_file_format(path: Path, pragma: tuple[str, str | int]) -> None:
    fill(path, 1)
    with sqlite3.connect(path) as connection:
        assert connection.execute(f"PRAGMA {pragma[0]}").fetchone()[0] == pragma[1]
    connection.close()
