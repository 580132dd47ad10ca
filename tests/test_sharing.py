"""Cells that share what they learn through a router: cut off, killed, lied to, they come to know the same."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path

import pytest
import zenoh
from cells import Palpate, cell_text, write_cell
from conftest import unused_port
from search_samples import REAL, found, tries

from runtime import config, topics
from runtime.clock import Stopwatch, pause
from runtime.errors import InputError
from runtime.evidence.evidence import Evidence, text_of
from runtime.evidence.exchange import EvidenceExchange
from runtime.evidence.file import Access
from runtime.evidence.known import KnownEvidence
from runtime.evidence.store import PosteriorStore
from runtime.launcher import Order, launch
from runtime.log.file import open_log
from runtime.network.keys import make_keys
from runtime.network.zenoh_exchange import client, router
from runtime.reexecution.reexecute import reexecute

PATIENCE = 60.0  # [s]
TESTS = Path(__file__).parent


@pytest.fixture
def palpate(tmp_path: Path) -> Palpate:
    return Palpate(tmp_path)


def wait_until(true: Callable[[], bool], what: str) -> None:
    watch = Stopwatch()
    while not true():
        assert watch.seconds < PATIENCE, what
        pause(0.05)


class Sharer:
    """A process with a store that is shared."""

    def __init__(self, path: Path, session: str, endpoint: str, keys: Path | None = None, inside: str = "") -> None:
        self.path = path
        arguments = [str(path), session, endpoint, *([] if keys is None else [str(keys)])]
        self.process = subprocess.Popen(
            [*within(inside), sys.executable, str(TESTS / "sharing_cell.py"), *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=TESTS.parent,
            env={**os.environ, "PYTHONPATH": f"{TESTS.parent}:{TESTS}"},
        )
        self.ready = False

    def tell(self, command: str) -> object:
        assert self.process.stdin is not None
        if not self.ready:
            assert self.heard() == "ready"
            self.ready = True
        self.process.stdin.write(f"{command}\n")
        self.process.stdin.flush()
        return self.heard()

    def heard(self) -> object:
        assert self.process.stdout is not None
        return json.loads(self.process.stdout.readline())

    def end(self) -> None:
        assert self.process.stdin is not None
        self.process.stdin.close()
        assert self.process.wait(PATIENCE) == 0

    def __enter__(self) -> Sharer:
        return self

    def __exit__(self, *_: object) -> None:
        with self.process:  # which closes its pipes
            self.process.kill()


class Hub:
    """`palpate posterior serve`."""

    def __init__(self, store: Path, endpoint: str, keys: Path | None = None, inside: str = "") -> None:
        arguments = ["--store", str(store), "--listen", endpoint, *([] if keys is None else ["--keys", str(keys)])]
        self.process = subprocess.Popen(
            [*within(inside), sys.executable, "-m", "runtime.cli", "posterior", "serve", *arguments],
            stdout=subprocess.PIPE,
            text=True,
            cwd=TESTS.parent,
        )

    def wait(self) -> str:
        """Until it serves; what it says then."""
        assert self.process.stdout is not None
        return self.process.stdout.readline()

    def end(self) -> str:
        self.process.terminate()
        return self.process.communicate(timeout=PATIENCE)[0]

    def __enter__(self) -> Hub:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.communicate()


def within(namespace: str) -> list[str]:
    return ["ip", "netns", "exec", namespace] if namespace else []


def alike(sharers: Sequence[Sharer], count: int) -> bool:
    """Whether all know the same, and as many searches."""
    digests = [sharer.tell("digest") for sharer in sharers]
    runs = json.loads(str(digests[0]))
    return len(set(digests)) == 1 and sum(last - first + 1 for _, _, first, last, _ in runs) == count


def evidence_in(path: Path) -> list[Evidence]:
    with PosteriorStore(path, Access.READ) as store:
        return store.evidence(forgotten=True)


@pytest.fixture
def network() -> Iterator[list[str]]:
    """Names of four network namespaces: a hub at 10.99.0.1, and cells at .11, .12 and .13 behind its bridge."""
    if os.geteuid() != 0:
        pytest.skip("network namespaces need root")
    if shutil.which("ip") is None:
        pytest.skip("network namespaces need the command `ip` (package iproute2)")
    names = [f"palpate-{os.getpid()}-{name}" for name in ("hub", "a", "b", "c")]
    try:
        made = subprocess.run(["ip", "netns", "add", names[0]], capture_output=True, text=True, check=False)
        if made.returncode:
            pytest.skip(f"no network namespaces here: {made.stderr.strip()}")
        for name in names[1:]:
            ip("netns", "add", name)
        for name in names:
            ip("-n", name, "link", "set", "lo", "up")
        ip("-n", names[0], "link", "add", "bridge", "type", "bridge")
        ip("-n", names[0], "link", "set", "bridge", "up")
        ip("-n", names[0], "address", "add", "10.99.0.1/24", "dev", "bridge")
        for number, name in enumerate(names[1:], 1):
            ip("-n", names[0], "link", "add", f"port{number}", "type", "veth", "peer", "name", "eth0", "netns", name)
            ip("-n", names[0], "link", "set", f"port{number}", "master", "bridge", "up")
            ip("-n", name, "address", "add", f"10.99.0.1{number}/24", "dev", "eth0")
            ip("-n", name, "link", "set", "eth0", "up")
        yield names
    finally:
        for name in names:
            subprocess.run(["ip", "netns", "delete", name], capture_output=True, check=False)


def ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True, capture_output=True, text=True)


def test_a_cell_that_was_cut_off_from_the_network_catches_up(network: list[str], tmp_path: Path) -> None:
    """Four stores in network namespaces of their own, by mTLS."""
    hub_side, *sides = network
    endpoint, keys = "tls/10.99.0.1:7460", tmp_path / "keys"
    make_keys(keys, ["router", "posterior"], ["10.99.0.1"])
    with ExitStack() as running:
        hub = running.enter_context(Hub(tmp_path / "hub.sqlite3", endpoint, keys, hub_side))
        cells = [
            running.enter_context(Sharer(tmp_path / f"{name}.sqlite3", f"session-{name}", endpoint, keys, side))
            for name, side in zip("abc", sides, strict=True)
        ]
        a, b, c = cells
        for cell in cells:
            cell.tell("record 3")
        wait_until(lambda: alike(cells, 9), "all learn from all")

        ip("-n", hub_side, "link", "set", "port3", "down")
        for cell in cells:
            cell.tell("record 4")
        wait_until(lambda: alike([a, b], 17), "those that are left go on sharing")
        assert a.tell("forget psu") == 10
        c.tell("record 120")  # more than go into one answer
        wait_until(lambda: not c.tell("reached"), "the cut is noticed")
        assert alike([c], 9 + 4 + 120)
        assert not alike([a, b, c], 17)

        ip("-n", hub_side, "link", "set", "port3", "up")
        wait_until(lambda: alike(cells, 9 + 12 + 120), "the one that was cut off catches up, and the others with it")
        for cell in cells:
            cell.end()
        said = hub.end()

    stores = [evidence_in(path) for path in (tmp_path / f"{name}.sqlite3" for name in ("a", "b", "c", "hub"))]
    assert all(store == stores[0] for store in stores)
    assert Counter(item.session for item in stores[0]) == {"session-a": 7, "session-b": 7, "session-c": 127}
    assert len({item.identity for item in stores[0]}) == len(stores[0]), "nothing counts twice"
    assert Counter(item.board_type for item in stores[0] if item.forgotten) == {"psu": 10}
    assert "searches taken over" in said


def test_stores_catch_up_when_the_router_was_killed_and_is_back(tmp_path: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{unused_port()}"
    with ExitStack() as running:
        cells = [
            running.enter_context(Sharer(tmp_path / f"{name}.sqlite3", f"session-{name}", endpoint)) for name in "ab"
        ]
        a, b = cells
        a.tell("record 2")  # before there is any router
        with Hub(tmp_path / "hub.sqlite3", endpoint):
            b.tell("record 2")
            wait_until(lambda: alike(cells, 4), "both learn from each other once there is a router")
        wait_until(lambda: not (a.tell("reached") or b.tell("reached")), "the router is missed")
        a.tell("record 3")
        b.tell("record 3")
        assert not alike(cells, 10)
        with Hub(tmp_path / "hub.sqlite3", endpoint):
            wait_until(lambda: alike(cells, 10), "both catch up")
            a.tell("record 1")
            a.end()
            wait_until(lambda: alike([b], 11), "what a cell found just before it closed is not left behind")
            b.end()
    assert evidence_in(tmp_path / "b.sqlite3") == evidence_in(tmp_path / "hub.sqlite3")
    assert len(evidence_in(tmp_path / "a.sqlite3")) == 11


def test_whole_cells_learn_from_each_other_and_their_logs_can_be_decided_again(palpate: Palpate) -> None:
    endpoint = f"tcp/127.0.0.1:{unused_port()}"
    extra = f'\n[posterior]\nshare = "{endpoint}"\n'
    cell = write_cell(palpate.folder, cell_text(holes=2, extra=extra))
    folders = [palpate.folder / name for name in ("one", "two")]
    with Hub(palpate.folder / "hub.sqlite3", endpoint) as hub_process:
        assert "shares evidence with other cells" in hub_process.wait()
        launches = [
            palpate.start("launch", cell, "--logs", folder, "--in-process", "--rerun", "off") for folder in folders
        ]
        for launched in launches:
            out, err = launched.communicate(timeout=120)
            assert launched.returncode == 0, out + err
    hub = evidence_in(palpate.folder / "hub.sqlite3")
    assert len(hub) == 4
    assert len({item.session for item in hub}) == 2
    entered = 0
    for folder in folders:
        assert set(evidence_in(folder / "posterior.sqlite3")) <= set(hub)
        (log_path,) = folder.glob("*.mcap")
        with open_log(log_path) as log:
            verdict = reexecute(log)
            assert (verdict.differing, verdict.losses) == (0, [])
            entered += sum(change.entered for _, change in log.read(topics.MERGED))
            entered += len(next(iter(log.read(topics.SEARCH_GOAL)))[1].seats)
    assert entered > 0, "the cells ran at the same time, and their logs tell what came from the other"
    with pytest.raises(InputError, match="--fresh would make every cell forget"):
        launch(Order(config.load(str(cell)), palpate.folder, fresh=True), lambda _progress: None)


def test_what_no_cell_says_is_dropped_and_told(tmp_path: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{unused_port()}"
    foreign = zenoh.Config()
    for key, value in (("mode", "client"), ("connect/endpoints", [endpoint]), ("scouting/multicast/enabled", False)):
        foreign.insert_json5(key, json.dumps(value))
    with (
        PosteriorStore(tmp_path / "hub.sqlite3") as hub,
        PosteriorStore(tmp_path / "liar.sqlite3") as liar,
        EvidenceExchange(hub, "hub", router([endpoint], None), endpoint, at_once=True) as exchange,
    ):
        assert hub.record("driver", found(1), "here", tries(1), scope=REAL)
        liar.record("driver", found(1, x=9e-4), "here", tries(1), scope=REAL)
        liar.record("driver", found(2), "there", tries(2), scope=REAL)
        liar.forget()
        conflict, good = liar.evidence(forgotten=True)
        answer = b"\xff\n{}\n" + f"{text_of(conflict)}\n{text_of(good)}\n".encode()
        with zenoh.open(foreign) as session:
            queryable = session.declare_queryable(
                "palpate/posterior/1/lacking/liar", lambda query: query.reply(query.key_expr, answer)
            )
            for format_, payload in (("9", b""), ("1", b"not a checksum"), ("1", b"\xff" * 32), ("1", b"0" * 32)):
                session.put(f"palpate/posterior/{format_}/known/liar", payload)
            assert [
                reply for reply in session.get("palpate/posterior/1/lacking/hub", payload=b"liar\n[[1") if reply.ok
            ] == []
            wait_until(lambda: len(hub.digest().runs) == 2, "what is right in an answer is taken over")
            queryable.undeclare()
        texts: list[str] = []
        wait_until(
            lambda: bool(texts.extend(text for text, _ in exchange.reports(last=True)) or len(texts) > 3), "told"
        )
    said = "\n".join(texts)
    assert "left out" in said
    assert "search 1 of session here, from liar" in said
    assert "which this palpate cannot read" in said
    assert [item for item in evidence_in(tmp_path / "hub.sqlite3") if item.session == "there"] == [good]


def test_who_has_no_keys_of_the_same_authority_shares_nothing(tmp_path: Path) -> None:
    endpoint = f"tls/127.0.0.1:{unused_port()}"
    make_keys(tmp_path / "ours", ["router", "posterior", "guest"])
    make_keys(tmp_path / "theirs", ["router", "posterior"])
    for kind in ("pem", "key"):  # a guest of the same authority, who would pass for a posterior
        (tmp_path / "guest").mkdir(exist_ok=True)
        shutil.copy(tmp_path / "ours" / f"guest.{kind}", tmp_path / "guest" / f"posterior.{kind}")
    shutil.copy(tmp_path / "ours" / "ca.pem", tmp_path / "guest")
    with ExitStack() as held:
        stores = {name: held.enter_context(PosteriorStore(tmp_path / f"{name}.db")) for name in ("hub", "a", "b", "c")}
        for name, store in stores.items():
            store.record("driver", found(1), name, tries(1), scope=REAL)
        join = router([endpoint], tmp_path / "ours")
        hub = held.enter_context(EvidenceExchange(stores["hub"], "hub", join, endpoint, at_once=True))
        b = held.enter_context(EvidenceExchange(stores["b"], "b", client([endpoint], tmp_path / "theirs"), endpoint))
        c = held.enter_context(EvidenceExchange(stores["c"], "c", client([endpoint], tmp_path / "guest"), endpoint))
        wait_until(lambda: any("shares no evidence" in text for text, _ in b.reports()), "strangers are kept out")
        wait_until(lambda: any("shares evidence" in text for text, _ in c.reports()), "a guest comes in")
        held.enter_context(EvidenceExchange(stores["a"], "a", client([endpoint], tmp_path / "ours"), endpoint))
        wait_until(lambda: len(stores["hub"].digest().runs) == 2, "who has keys is heard")
        stores["hub"].record("driver", found(2), "hub", tries(2), scope=REAL)
        hub.changed()
        wait_until(lambda: len(stores["a"].evidence()) == 3, "who has keys hears")
        assert {run.session for run in stores["hub"].digest().runs} == {"hub", "a"}
        assert {run.session for name in "bc" for run in stores[name].digest().runs} == {"b", "c"}


def test_boards_of_other_cells_have_numbers_of_their_own(tmp_path: Path) -> None:
    """Evidence that comes during a session is let in after a search, under numbers that no other board has."""
    cell = config.load("igbt", {"boards": 3, "board": {"type": "driver"}}).cell
    with PosteriorStore(tmp_path / "own.db") as store, PosteriorStore(tmp_path / "other.db") as other:
        store.record("driver", found(1), "past", tries(1), scope=REAL)
        known = KnownEvidence(store, cell, "now")
        assert [seat.board for seat in known.seats()] == [1]
        for search in (1, 11, 12):  # boards 1 and 2
            other.record("driver", found(search), "elsewhere", tries(search), scope=REAL)
        store.add(other.evidence())
        assert [seat.session for seat in known.seats()] == ["past"], "nothing changes in the middle of a search"
        assert known.record(found(11), tries(11))
        assert not known.record(found(11), tries(11)), "a search is recorded once"
        change = known.merged(11, 5)
        assert change is not None
        assert (change.after_search, change.entered, change.withdrawn) == (11, 3, 0)
        numbers = {(seat.session, seat.board) for seat in change.seats}
        assert numbers == {("past", 1), ("now", 2), ("elsewhere", 5), ("elsewhere", 6)}  # own boards are 2, 3 and 4
        assert {miss.board for miss in change.misses} == {1, 2, 5, 6}
        assert known.merged(11, 5) is None
        assert (known.seats(), known.misses()) == (change.seats, change.misses)
        assert KnownEvidence(store, cell, "now").misses() != [], "after a restart the store tells the same"
        other.forget()
        store.add(other.evidence(forgotten=True))
        assert known.record(found(12), tries(12))
        gone = known.merged(12, 6)
        assert gone is not None
        assert (gone.entered, gone.withdrawn) == (0, 3)
        assert [(seat.session, seat.board) for seat in gone.seats] == [("past", 1), ("now", 2), ("now", 2)]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"share": "192.168.0.2"}, "posterior.share: '192.168.0.2' is no address of a router"),
        ({"share": ["tcp/a:1", "udp/b:1"]}, "'udp/b:1' is no address"),
        ({"share": "tcp/a:70000"}, "'tcp/a:70000' is no address"),
        ({"share": "tls/192.168.0.2:7460"}, "needs keys"),
        ({"share": "tcp/192.168.0.2:7460", "keys": "keys"}, "in the clear"),
    ],
)
def test_a_wrong_address_to_share_through_is_refused(settings: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=r"igbt\.toml: posterior") as failure:
        config.load("igbt", {"posterior": settings})
    assert message in str(failure.value)
