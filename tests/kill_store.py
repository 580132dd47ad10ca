"""Kill a process that stores searches, again and again, and count what was lost. `kill_store.py --help`.

A child records searches one after another and acknowledges each on a pipe once `record` has returned. After a random
number of acknowledgements and a random number of turns of a loop it is killed (SIGKILL). Then the store is opened
again: the file itself, which recovers it, or copies of the database and its log, as a dead machine leaves them.
The same file goes on through all kills.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import signal
import struct
import sys
from collections import Counter
from dataclasses import replace
from itertools import count, islice
from pathlib import Path

from search_samples import REAL, found, tries

from runtime.evidence.evidence import Evidence
from runtime.evidence.store import PosteriorStore
from runtime.messages import Outcome, Waypoint

ACKNOWLEDGEMENT = struct.Struct("<I")
SPIN = 200_000  # turns of an empty loop, some milliseconds: longer than a commit takes


def attempts_of(search: int) -> list[tuple[float, float, Outcome]]:
    """What search number `search` tries: one to seven attempts, more than a page now and then."""
    return [(search * 1e-6, number * 1e-5, Outcome.BLOCKED) for number in range(1, 1 + search % 7)]


def write(path: Path, session: str, pipe: int) -> None:
    """Record and acknowledge without end. Closing brings the log into the database, where a kill shall hit, too."""
    searches = count(1)
    while True:
        with PosteriorStore(path) as store:
            for search in islice(searches, 4):
                record(store, session, search)
                os.write(pipe, ACKNOWLEDGEMENT.pack(search))


def record(store: PosteriorStore, session: str, search: int) -> None:
    first, last = tries(search)
    blocked = [replace(first, number=n, x=x, y=y) for n, (x, y, _) in enumerate(attempts_of(search), start=1)]
    seated = replace(last, number=len(blocked) + 1)
    if search % 5 == 0:
        seated = replace(seated, path=[Waypoint(1e-6 * n, -1e-6 * n) for n in range(200)])
    result = replace(found(search), attempts=seated.number)
    if not store.record("driver", result, session, [*blocked, seated], scope=REAL):
        os._exit(3)


def kill_one(path: Path, session: str, draw: random.Random) -> int:
    """Start a writer, kill it at a random moment, and return the number of its last acknowledged search."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reader)
        try:
            write(path, session, writer)
        finally:
            os._exit(1)
    os.close(writer)
    wanted = draw.choice((0, 1, 2, draw.randrange(20)))
    heard = b""
    while len(heard) < wanted * ACKNOWLEDGEMENT.size:
        heard += os.read(reader, ACKNOWLEDGEMENT.size)
    for _ in range(draw.randrange(SPIN)):
        pass
    os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    if not os.WIFSIGNALED(status):
        raise SystemExit(f"the writer ended by itself: {os.waitstatus_to_exitcode(status)}")
    while more := os.read(reader, 65536):
        heard += more
    os.close(reader)
    numbers = [number for (number,) in ACKNOWLEDGEMENT.iter_unpack(heard)]
    if numbers != list(range(1, len(numbers) + 1)):
        raise SystemExit(f"acknowledgements out of order: {numbers}")
    return len(numbers)


def whole(item: Evidence) -> bool:
    wanted = attempts_of(item.search)
    blocked = [(tried.x, tried.y, tried.outcome) for tried in item.tried[:-1]]
    last = item.tried[-1]
    return (
        blocked == wanted
        and (last.number, last.outcome) == (len(wanted) + 1, Outcome.SEATED)
        and len(last.path) == (200 if item.search % 5 == 0 else 0)
    )


def look(path: Path, *, as_copy: bool) -> list[Evidence]:
    """What a store holds after a kill; of a copy, so that the file keeps its log, if `as_copy`."""
    if as_copy:
        copy = path.with_name("copy.sqlite")
        for suffix in ("", "-wal"):
            source, target = path.with_name(path.name + suffix), copy.with_name(copy.name + suffix)
            target.unlink(missing_ok=True)
            if source.exists():
                shutil.copy(source, target)
        path = copy
    with PosteriorStore(path) as store:
        if store.set_aside is not None:
            raise SystemExit("the store was damaged")
        return store.evidence()


def main() -> None:
    arguments = argparse.ArgumentParser(description="Kill a process that stores searches, and count what was lost.")
    arguments.add_argument("store", type=Path, help="the file; new, or one of an earlier run")
    arguments.add_argument("--kills", type=int, default=1000)
    arguments.add_argument("--seed", type=int, default=0)
    chosen = arguments.parse_args()
    draw = random.Random(chosen.seed)
    chosen.store.parent.mkdir(parents=True, exist_ok=True)
    acknowledged: Counter[str] = Counter()
    in_flight = lost = half = twice = 0
    kept: list[Evidence] = []
    for number in range(chosen.kills):
        session = f"{chosen.seed}-{number}"
        acknowledged[session] = kill_one(chosen.store, session, draw)
        last = number == chosen.kills - 1
        kept = look(chosen.store, as_copy=not last and draw.random() < 0.7)
        searches: dict[str, list[int]] = {name: [] for name in acknowledged}
        for item in kept:
            searches.setdefault(item.session, []).append(item.search)
        for name, known in acknowledged.items():
            lost += known > len(set(searches[name]))
            lost += set(searches[name]) != set(range(1, len(searches[name]) + 1))
            lost += len(searches[name]) > known + 1
            twice += len(searches[name]) != len(set(searches[name]))
        in_flight += len(searches[session]) - acknowledged[session]
        half += sum(not whole(item) for item in kept)
    figures = {
        "kills": chosen.kills,
        "acknowledged": acknowledged.total(),
        "stored": len(kept),
        "stored_unheard": in_flight,  # committed, and killed before the word was out
        "lost": lost,
        "half": half,
        "twice": twice,
    }
    sys.stdout.write(json.dumps(figures) + "\n")


if __name__ == "__main__":
    main()
