"""Fixtures that several tests share."""

from __future__ import annotations

import fcntl
import os
import socket
import tempfile
import threading
from collections.abc import Callable, Generator, Iterator
from functools import cache
from pathlib import Path

import pytest
from hypothesis import settings

from runtime.linear_algebra import ONE_THREAD

os.environ.update(ONE_THREAD)  # before anything loads linear algebra, as in every process of a cell

from runtime.bus import Bus, Request
from runtime.local_bus import LocalBus, LocalExchange
from runtime.messages import BeliefRequest
from runtime.network.zenoh_bus import ZenohBus, ZenohRouter
from runtime.topics import Service

settings.register_profile("untimed", deadline=None)  # how long an example takes tells of the machine
settings.load_profile("untimed")

# Tests against a controller that keeps the machine's time: with `pytest -n 2` they have the machine to themselves.
REAL_TIME = (
    "control_box",
    "dashboard",
    "drivers",
    "ports",
    "primary",
    "real_time",
    "reverse",
    "robot",
    "rtde",
    "ur_rtde",
    "wired",
)

BARRIER = Service("/test/barrier", BeliefRequest, BeliefRequest, "clerk", "an answer that comes after all before it")
MakeBus = Callable[[str], Bus]


def group_of(item: pytest.Item) -> str:
    """What shares fixtures, or the machine's time."""
    name = item.path.stem.removeprefix("test_")
    return "real time" if name.startswith(REAL_TIME) else name


@pytest.hookimpl(tryfirst=True)  # before xdist looks for groups
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """With `pytest -n 2`, keep each group in one process."""
    for item in items:
        item.add_marker(pytest.mark.xdist_group(group_of(item)))


class Floor:
    """Two locks among the processes of one `pytest -n 2`: a test in real time waits until nobody else is at work."""

    def __init__(self, run: str) -> None:
        folder = Path(tempfile.gettempdir())
        self.files = [folder / f"palpate-{run}.{name}" for name in ("door", "room")]
        self._door, self._room = (os.open(file, os.O_CREAT | os.O_RDWR) for file in self.files)
        self.alone = False

    def enter(self, alone: bool) -> None:
        fcntl.flock(self._door, fcntl.LOCK_EX)  # who waits to be alone lets nobody else in meanwhile
        fcntl.flock(self._room, fcntl.LOCK_EX if alone else fcntl.LOCK_SH)
        fcntl.flock(self._door, fcntl.LOCK_UN)
        self.alone = alone

    def leave(self) -> None:
        fcntl.flock(self._room, fcntl.LOCK_UN)
        self.alone = False


@cache
def floor() -> Floor | None:
    """None where tests run in one process."""
    run = os.environ.get("PYTEST_XDIST_TESTRUNUID")
    return Floor(run) if run and "PYTEST_XDIST_WORKER" in os.environ else None


def pytest_sessionfinish() -> None:
    place = floor()
    if place is not None:
        for file in place.files:  # whoever is still at work has them open
            file.unlink(missing_ok=True)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> Generator[None, object, object]:
    """Tests in real time run while no other does; one after another without a pause between."""
    place = floor()
    if place is None:
        return (yield)
    alone = group_of(item) == "real time"
    if not place.alone:
        place.enter(alone)
    try:
        return (yield)
    finally:
        if not (alone and nextitem is not None and group_of(nextitem) == "real time"):
            place.leave()


def unused_port() -> int:
    """A port on loopback that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture
def free_port() -> int:
    return unused_port()


def _answer(clerk: Bus, count: int) -> None:
    for _ in range(count):
        question = clerk.inbox.receive(20.0)
        assert isinstance(question, Request)
        question.reply(question.read(BARRIER))


class Meeting:
    """Buses that can talk to each other, with a way to wait until all of them are declared."""

    def __init__(self, make: MakeBus, wait_for: Callable[[set[str], float], set[str]]) -> None:
        self._make = make
        self._wait_for = wait_for
        self._roles: set[str] = set()
        self.buses: list[Bus] = []

    def join(self, role: str) -> Bus:
        bus = self._make(role)
        self._roles.add(role)
        self.buses.append(bus)
        return bus

    def begin(self) -> None:
        """Let every bus announce itself, and wait until all are known."""
        for bus in self.buses:
            bus.announce()
        assert self._wait_for(self._roles, 20.0) == set()
        # A publisher sends nothing until it hears of a subscriber. What the router knew before it forwarded a request
        # has reached a bus by the time the answer does.
        clerk = self._make("clerk")
        clerk.serve(BARRIER)
        clerk.announce()
        assert self._wait_for({"clerk"}, 20.0) == set()
        thread = threading.Thread(target=_answer, args=(clerk, len(self.buses)))
        thread.start()
        for bus in self.buses:
            bus.request(BARRIER, BeliefRequest("", 0, 0), timeout=20.0)
        thread.join()
        clerk.close()


@pytest.fixture(params=["local", "zenoh"])
def meeting(request: pytest.FixtureRequest) -> Iterator[Meeting]:
    if request.param == "local":
        exchange = LocalExchange()
        yield Meeting(lambda role: LocalBus(exchange, role), exchange.wait_for)
        return
    port = unused_port()
    with ZenohRouter(port) as router:
        made = Meeting(lambda role: ZenohBus(role, port), router.wait_for)
        yield made
        for bus in made.buses:
            bus.close()
