"""One contract for every installed driver: it waits its turn, speaks as the map says, and ends when asked."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, fields, is_dataclass, replace
from importlib.util import find_spec
from typing import Any

import numpy as np
import pytest
from robots import Robot

from runtime import config, registry, roles, topics
from runtime.assembly import goal_for
from runtime.bus import Envelope
from runtime.context import Context
from runtime.local_bus import LocalBus, LocalExchange
from runtime.messages import (
    Belief,
    Candidate,
    Clock,
    ControlTrace,
    Gaussian,
    Permit,
    Phase,
    Proposal,
    SessionState,
    header,
    nanoseconds_of,
    stamp_of,
)
from runtime.plugin import Driver

PATIENCE = 30.0
ROLES = {name: roles.CURTAIN if name == roles.CURTAIN else roles.ARM for name in registry.names(registry.DRIVERS)}
ON_THE_NETWORK = "ur_rtde"
LOCKSTEP = [name for name, role in ROLES.items() if role == roles.ARM and name != ON_THE_NETWORK]
WIRED = pytest.param(
    ON_THE_NETWORK, marks=pytest.mark.skipif(find_spec("rtde_control") is None, reason="needs ur-rtde")
)
OURS = {topic.name for topic in (topics.SESSION, topics.SEARCH_GOAL, topics.CANDIDATE, topics.PERMIT)}
SECOND = 1_000_000_000
SESSION_NAME = "test"


@dataclass
class Stage:
    """A driver at work, alone with a test that plays the rest of the cell."""

    role: str
    exchange: LocalExchange
    context: Context
    thread: threading.Thread
    audience: LocalBus
    failure: list[BaseException]
    permits: int = 0

    def begin(self) -> None:
        session = self.audience.publisher(topics.SESSION)
        session.send(SessionState(header(0), SESSION_NAME, Phase.STARTING, ""), 0)

    def hear(self, timeout: float = PATIENCE) -> Envelope | None:
        """The next thing the driver says."""
        while (item := self.audience.inbox.receive(timeout)) is not None:
            assert isinstance(item, Envelope)
            if item.topic not in OURS:
                return item
        return None

    def ask_for_a_part(self, granted: bool, until: int) -> None:
        """A search with its first candidate, and the interlock's word on it."""
        cell = self.context.cell
        belief = Belief(header(0), cell.board.type, "1", 0, Gaussian(), [])
        say = self.audience.publisher
        say(topics.SEARCH_GOAL).send(goal_for(cell, cell.board.holes[0], belief, 1, 1, 0), 0)
        say(topics.CANDIDATE).send(Candidate(header(0), 1, 1, False, "", Proposal(0.0, 0.0)), 0)
        self.permit(granted, 0, until)

    def permit(self, granted: bool, since: int, until: int) -> None:
        self.permits += 1
        reason = "" if granted else "locked"
        word = Permit(
            header(since), granted, int(granted), reason, stamp_of(until), ossd=self.permits, session=SESSION_NAME
        )
        self.audience.publisher(topics.PERMIT).send(word, since)

    def traces(self, until: int) -> list[ControlTrace]:
        """Every control cycle that is told until a session time [ns], or until nothing more is said."""
        found = []
        while (envelope := self.hear(timeout=0.5)) is not None and envelope.stamp < until:
            if envelope.topic == topics.TRACE.name:
                found.append(envelope.read(topics.TRACE))
        return found

    def end(self) -> None:
        self.context.stop()
        self.thread.join(PATIENCE)
        assert not self.thread.is_alive()


@pytest.fixture
def stage(request: pytest.FixtureRequest) -> Iterator[Stage]:
    with ExitStack() as stack:
        settings: dict[str, Any] = {}
        if request.param == ON_THE_NETWORK:
            robot = stack.enter_context(Robot("igbt"))
            settings = {"address": robot.host, "simulated": True, "watchdog": "2 Hz"}
        yield from staged(request.param, settings)


def staged(name: str, settings: dict[str, Any]) -> Iterator[Stage]:
    role = ROLES[name]
    cell = config.load("igbt").cell
    cell = replace(cell, safety=replace(cell.safety, deadline=2.0))
    exchange = LocalExchange()
    audience = LocalBus(exchange, roles.RECORDER)
    audience.subscribe_all()
    context = Context(role, LocalBus(exchange, role), cell, SESSION_NAME)
    plugin: Driver = registry.driver(name, settings, "test")
    failure: list[BaseException] = []

    def run() -> None:
        try:
            plugin.run(context)
        except BaseException as error:
            failure.append(error)
        finally:
            context.close()

    thread = threading.Thread(target=run)
    thread.start()
    assert exchange.wait_for({role}, PATIENCE) == set(), failure
    made = Stage(role, exchange, context, thread, audience, failure)
    yield made
    made.end()


every_driver = pytest.mark.parametrize(
    "stage", [WIRED if name == ON_THE_NETWORK else name for name in ROLES], indirect=True
)
every_arm = pytest.mark.parametrize("stage", [*LOCKSTEP, WIRED], indirect=True)
lockstep_arms = pytest.mark.parametrize("stage", LOCKSTEP, indirect=True)
wired_arm = pytest.mark.parametrize("stage", [WIRED], indirect=True)


def speeds_of(traces: list[ControlTrace]) -> dict[int, float]:
    """How fast the quickest joint was told to move [rad/s] in cycles that ended at session times [ns]."""
    found = {}
    for trace in traces:
        period = round(trace.period * SECOND)
        targets = trace.target.reshape(-1, 6)
        for index, speed in enumerate(np.abs(np.diff(targets, axis=0)).max(axis=1) / trace.period, 1):
            found[nanoseconds_of(trace.header.stamp) + index * period] = float(speed)
    return found


@pytest.mark.parametrize("name", ROLES)
def test_settings_are_a_frozen_dataclass_with_defaults(name: str) -> None:
    cls = registry.load(registry.DRIVERS, name)
    assert is_dataclass(cls)
    assert cls.__dataclass_params__.frozen  # type: ignore[attr-defined]
    assert cls() == registry.driver(name, {}, "test")
    assert all(field.type for field in fields(cls))
    assert (cls.__doc__ or "").strip()


@every_driver
def test_it_keeps_silent_until_the_session_begins_and_accounts_for_what_it_said(stage: Stage) -> None:
    assert stage.hear(timeout=0.2) is None
    stage.begin()
    stage.end()
    assert not stage.failure
    said = []
    while (envelope := stage.hear(timeout=0.2)) is not None:
        said.append(envelope)
    assert said[-1].topic == topics.COUNTS.name
    counts = {count.topic: count.sent for count in said[-1].read(topics.COUNTS).counts}
    for name, sent in counts.items():
        heard = [envelope for envelope in said[:-1] if envelope.topic == name]
        assert len(heard) == sent
        assert [envelope.sequence for envelope in heard] == list(range(1, sent + 1))
        assert topics.topics()[name].publisher in (stage.role, "any")


@every_arm
def test_without_a_permit_nothing_moves(stage: Stage) -> None:
    stage.begin()
    ticked = None
    while ticked is None:
        envelope = stage.hear()
        assert envelope is not None
        ticked = envelope if envelope.topic == topics.CLOCK.name else None
    assert ticked.stamp < SECOND // 10
    stage.ask_for_a_part(granted=False, until=SECOND)
    assert set(speeds_of(stage.traces(until=SECOND)).values()) <= {0.0}


@lockstep_arms
def test_a_simulation_waits_for_its_permit(stage: Stage) -> None:
    stage.begin()
    while (envelope := stage.hear(timeout=0.5)) is not None:
        assert envelope.stamp == 0
    stage.ask_for_a_part(granted=False, until=SECOND)
    assert stage.hear(timeout=0.5) is None


@lockstep_arms
def test_it_moves_no_further_than_its_permit_and_says_when_it_needs_the_next(stage: Stage) -> None:
    stage.begin()
    granted_until = SECOND // 2
    stage.ask_for_a_part(granted=True, until=granted_until)
    last: Clock | None = None
    stamps = []
    while (envelope := stage.hear(timeout=2.0)) is not None:
        stamps.append(envelope.stamp)
        if envelope.topic == topics.CLOCK.name:
            last = envelope.read(topics.CLOCK)
    assert last is not None
    assert last.clock == stamp_of(granted_until)
    assert max(stamps) == granted_until
    stage.permit(True, granted_until, SECOND)
    following = stage.hear()
    while following is not None and following.topic == topics.ROSOUT.name:  # it says that it had to wait
        following = stage.hear()
    assert following is not None
    assert following.stamp > granted_until


@wired_arm
def test_an_arm_on_the_network_stands_soon_after_its_permit_ends_and_goes_on_with_the_next(stage: Stage) -> None:
    stage.begin()
    ends = 3 * SECOND // 2
    stage.ask_for_a_part(granted=True, until=ends)
    speeds = speeds_of(stage.traces(until=2 * SECOND))
    assert max(speed for stamp, speed in speeds.items() if stamp <= ends) > 0.1
    assert {speed for stamp, speed in speeds.items() if stamp > ends + SECOND // 5} == {0.0}
    stage.permit(True, 2 * SECOND, 4 * SECOND)
    speeds = speeds_of(stage.traces(until=3 * SECOND))
    assert max(speeds.values()) > 0.1
