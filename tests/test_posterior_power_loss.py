"""What a machine that loses power leaves of a posterior store: every acknowledged search, and none half.

A disk keeps what was synced; of what was written since then each sector may be the new one or still the old one. So
between two moments at which the store has synced, any mixture of both moments' sectors may be found. The test holds for
mixtures of the files as they are; that the store syncs at these moments is up to SQLite (synchronous = FULL).
"""

from __future__ import annotations

import shutil
import sqlite3
from contextlib import closing
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from search_samples import REAL, found, tries

from runtime.evidence.evidence import Evidence
from runtime.evidence.store import PosteriorStore

SECTOR = 512  # bytes that a disk writes as one
SEARCHES = 24
CHECKPOINTS = (8, 16)  # searches after which the log is brought into the database, and then written from its start


@dataclass(frozen=True)
class Moment:
    """A store's files when everything written was synced."""

    database: bytes
    log: bytes
    acknowledged: list[Evidence]


def moment_of(path: Path, store: PosteriorStore) -> Moment:
    log = path.with_name(path.name + "-wal")
    return Moment(path.read_bytes(), log.read_bytes(), store.evidence())


@pytest.fixture(scope="module")
def moments(tmp_path_factory: pytest.TempPathFactory) -> list[Moment]:
    path = tmp_path_factory.mktemp("power") / "holes.sqlite"
    with PosteriorStore(path) as store:
        found_then = [moment_of(path, store)]
        for search in range(1, SEARCHES + 1):
            store.record("driver", found(search), "monday", tries(search), scope=REAL)
            found_then.append(moment_of(path, store))
            if search in CHECKPOINTS:
                with closing(sqlite3.connect(path)) as connection:
                    busy, _, moved = connection.execute("PRAGMA wal_checkpoint(FULL)").fetchone()
                assert busy == 0
                assert moved > 0
                found_then.append(moment_of(path, store))
    pairs = list(pairwise(found_then))
    assert sum(a.database != b.database for a, b in pairs) == len(CHECKPOINTS)
    assert any(len(a.log) == len(b.log) and a.log != b.log for a, b in pairs)  # written from its start again
    return found_then


def torn(old: bytes, new: bytes, arrived: list[bool], cut: float) -> bytes:
    """A mixture of sectors; of those that differ, in turn, the new one if it has `arrived`. What grew may be cut."""
    sectors = []
    differing = 0
    for start in range(0, len(new), SECTOR):
        before, after = old[start : start + SECTOR], new[start : start + SECTOR]
        if before != after:
            if not arrived[differing % len(arrived)]:
                after = before.ljust(len(after), b"\0")
            differing += 1
        sectors.append(after)
    return b"".join(sectors)[: len(old) + round(cut * (len(new) - len(old)))]


@settings(max_examples=100, deadline=None)
@given(
    number=st.integers(0, SEARCHES + len(CHECKPOINTS) - 1),
    arrived=st.lists(st.booleans(), min_size=1, max_size=40),
    cut=st.floats(0, 1),
)
def test_any_mixture_of_sectors_holds_whole_searches_and_all_that_were_acknowledged(
    moments: list[Moment], tmp_path_factory: pytest.TempPathFactory, number: int, arrived: list[bool], cut: float
) -> None:
    old, new = moments[number], moments[number + 1]
    folder = tmp_path_factory.getbasetemp() / "torn"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    path = folder / "holes.sqlite"
    path.write_bytes(torn(old.database, new.database, arrived, cut))
    path.with_name("holes.sqlite-wal").write_bytes(torn(old.log, new.log, arrived, cut))
    with PosteriorStore(path) as store:
        assert store.set_aside is None
        kept = store.evidence()
        assert kept in (old.acknowledged, new.acknowledged)
        store.record("driver", found(99), "tuesday", tries(99), scope=REAL)
        assert store.evidence()[:-1] == kept
