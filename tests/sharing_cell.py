"""The sharing part of a cell in a process of its own: a store and its exchange, told what to do line by line.

    sharing_cell.py STORE SESSION ENDPOINT [KEYS]

`record N` stores N more searches, `forget TYPE` forgets a board type, `digest` tells what is known, `reached` whether
the router is. Each is answered with one line of JSON; the end of the input ends the process.
"""

from __future__ import annotations

import json
import sys
from itertools import count, islice
from pathlib import Path

from search_samples import REAL, found, tries

from runtime.evidence.exchange import EvidenceExchange, Join, Peers
from runtime.evidence.store import PosteriorStore
from runtime.network.zenoh_exchange import client

BOARD_TYPES = ("driver", "psu")


def main(path: Path, session: str, endpoint: str, keys: Path | None) -> None:
    joined: list[Peers] = []
    searches = count(1)
    with (
        PosteriorStore(path) as store,
        EvidenceExchange(store, session, remembered(endpoint, keys, joined), "") as peers,
    ):
        answer("ready")
        for line in sys.stdin:
            command, *rest = line.split()
            if command == "record":
                for search in islice(searches, int(rest[0])):
                    board_type = BOARD_TYPES[search % 2]
                    assert store.record(board_type, found(search), session, tries(search), scope=REAL)
                    peers.changed()
                answer("recorded")
            elif command == "forget":
                answer(store.forget(rest[0]))
                peers.changed()
            elif command == "digest":
                answer(store.digest().text())
            elif command == "reached":
                answer(bool(joined) and joined[0].reached)


def remembered(endpoint: str, keys: Path | None, joined: list[Peers]) -> Join:
    join = client([endpoint], keys)

    def keep(cell: str, ears: EvidenceExchange) -> Peers:
        joined.append(join(cell, ears))
        return joined[0]

    return keep


def answer(what: object) -> None:
    sys.stdout.write(json.dumps(what) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    store, session, endpoint, *keys = sys.argv[1:]
    main(Path(store), session, endpoint, Path(keys[0]) if keys else None)
