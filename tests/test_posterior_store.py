"""The posterior store keeps what it acknowledged, through crashes and damage, and keeps worlds apart."""

from __future__ import annotations

import math
import os
import signal
import sqlite3
import subprocess
import sys
import textwrap
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest
from search_world import attempt_at, goal_for

from runtime.errors import InputError, SessionError
from runtime.messages import Attempt, Ending, Miss, Outcome, SearchResult, Waypoint, header
from runtime.posterior_store import PosteriorStore, Tried

ROOT = Path(__file__).parent.parent
REAL = "real"


def found(search: int, hole: str = "h1", *, x: float = 1e-4, ending: Ending = Ending.INSERTED) -> SearchResult:
    seated = ending == Ending.INSERTED
    return SearchResult(
        header=header(0),
        search=search,
        board=1 + search // 10,
        hole=hole,
        component="igbt",
        ending=ending,
        reason="",
        attempts=2,
        x=x if seated else math.nan,
        y=-x if seated else math.nan,
        seated_x=x + 1e-5 if seated else math.nan,
        seated_y=math.nan,
        duration=1.0,
    )


def tries(search: int, hole: str = "h1") -> list[Attempt]:
    goal = goal_for(search=search, hole=hole, board=1 + search // 10)
    return [
        attempt_at(goal, 1, 0.0, 0.0, Outcome.BLOCKED),
        attempt_at(goal, 2, 1e-4, -1e-4, Outcome.SEATED),
    ]


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
        assert store.attempts("driver", "igbt", scope=REAL) == [
            Tried("monday", 1, 1, "h1", 1, 0.0, 0.0, Outcome.BLOCKED)
        ]


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
        assert [tried.path for tried in store.attempts("driver", "igbt", scope=REAL)][:2] == [
            (),
            ((0.0, 0.0), (1e-3, -2e-3)),
        ]


def test_a_file_of_the_first_format_is_brought_up_to_date(path: Path) -> None:
    fill(path, 3)
    with sqlite3.connect(path) as connection:
        connection.execute("ALTER TABLE attempt DROP COLUMN path")
        connection.execute("ALTER TABLE search DROP COLUMN slid")
        connection.execute("PRAGMA user_version = 1")
    connection.close()
    with PosteriorStore(path) as store:
        assert [seat.slid for seat in store.seats("driver", "igbt", scope=REAL)] == [False] * 3
        assert [len(miss.path) for miss in store.misses("driver", "igbt", scope=REAL)] == [1] * 3
    with sqlite3.connect(path) as connection:
        assert connection.execute("PRAGMA user_version").fetchone()[0] == 2
    connection.close()


def test_recording_a_search_again_changes_nothing(path: Path) -> None:
    with PosteriorStore(path) as store:
        assert store.record("driver", found(1), "monday", tries(1), scope=REAL)
        before = store.seats("driver", "igbt", scope=REAL), store.attempts("driver", "igbt", scope=REAL)
        assert not store.record("driver", found(1, x=9e-4), "monday", tries(1), scope=REAL)
        after = store.seats("driver", "igbt", scope=REAL), store.attempts("driver", "igbt", scope=REAL)
        assert [seat.x for seat in after[0]] == [seat.x for seat in before[0]] == [1e-4]
        assert after[1] == before[1]
        assert len(after[1]) == 2


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


def test_forget_deletes_just_what_was_named(path: Path) -> None:
    with PosteriorStore(path) as store:
        for number, (board_type, scope) in enumerate([("driver", REAL), ("driver", "sim"), ("psu", REAL)], start=1):
            store.record(board_type, found(number), "monday", tries(number), scope=scope)
        assert store.forget("nothing") == 0
        assert store.forget("driver", scope="sim") == 1
        assert store.attempts("driver", "igbt", scope="sim") == []
        assert len(store.attempts("driver", "igbt", scope=REAL)) == 2
        assert store.forget("driver") == 1
        assert store.attempts("driver", "igbt", scope=REAL) == []
        assert store.attempts("psu", "igbt", scope=REAL) != []
        assert store.forget() == 1
        assert store.attempts("psu", "igbt", scope=REAL) == []
        assert store.record("driver", found(1), "monday", tries(1), scope=REAL)  # forgotten, so new again


def test_attempts_of_another_search_are_refused_whole(path: Path) -> None:
    with PosteriorStore(path) as store:
        with pytest.raises(InputError, match="search 1 cannot store attempts of search 2"):
            store.record("driver", found(1), "monday", tries(2), scope=REAL)
        with pytest.raises(SessionError, match=r"holes\.sqlite"):  # the same attempt number twice
            store.record("driver", found(1), "monday", [tries(1)[0], tries(1)[0]], scope=REAL)
        assert store.seats("driver", "igbt", scope=REAL) == []
        assert store.record("driver", found(1), "monday", tries(1), scope=REAL)


WRITER = textwrap.dedent(
    """
    import itertools, os, sys
    sys.path[:0] = [{tests!r}, {root!r}]
    from test_posterior_store import REAL, PosteriorStore, found, tries
    store = PosteriorStore({path!r})
    for search in itertools.count(1):
        store.record("driver", found(search), "monday", tries(search), scope=REAL)
        os.write(1, b"%d\\n" % search)
        if search == {last}:
            os._exit(1)
    """
)


def writer(path: Path, last: int) -> subprocess.Popen[bytes]:
    program = WRITER.format(tests=str(ROOT / "tests"), root=str(ROOT), path=str(path), last=last)
    return subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, env={**os.environ})


def survivors(path: Path) -> list[int]:
    with PosteriorStore(path) as store:
        assert store.set_aside is None
        kept = store.attempts("driver", "igbt", scope=REAL)
        assert len(kept) == 2 * len(store.seats("driver", "igbt", scope=REAL))  # whole searches only
        return sorted({row.search for row in kept})


def test_exit_without_closing_loses_nothing(path: Path) -> None:
    with writer(path, last=20) as process:
        output, _ = process.communicate(timeout=60)
    assert output.split() == [str(n).encode() for n in range(1, 21)]
    assert survivors(path) == list(range(1, 21))


def test_kill_in_the_midst_of_writing_loses_nothing_acknowledged(path: Path) -> None:
    with writer(path, last=-1) as process:
        assert process.stdout is not None
        acknowledged = [int(process.stdout.readline()) for _ in range(25)]
        process.send_signal(signal.SIGKILL)
        rest, _ = process.communicate(timeout=60)
    acknowledged += [int(line) for line in rest.split(b"\n")[:-1]]
    kept = survivors(path)
    assert kept[: len(acknowledged)] == acknowledged
    assert len(kept) - len(acknowledged) in (0, 1)  # one may be stored and its word lost


def fill(path: Path, searches: int = 200) -> None:
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


@pytest.mark.parametrize("pragma", [("journal_mode", "wal"), ("user_version", 2)])
def test_file_format(path: Path, pragma: tuple[str, str | int]) -> None:
    fill(path, 1)
    with sqlite3.connect(path) as connection:
        assert connection.execute(f"PRAGMA {pragma[0]}").fetchone()[0] == pragma[1]
    connection.close()
