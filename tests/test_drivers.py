"""One contract for every installed driver: it waits its turn, speaks as the map says, and ends when asked."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass

import pytest

from runtime import config, registry, roles, topics
from runtime.assembly import goal_for
from runtime.bus import Envelope
from runtime.context import Context
from runtime.local_bus import LocalBus, LocalExchange
from runtime.messages import (
    Belief,
    Candidate,
    Clock,
    Gaussian,
    Permit,
    Phase,
    Proposal,
    SessionState,
    header,
    stamp_of,
)
from runtime.plugin import Driver

PATIENCE = 30.0
ROLES = {name: roles.CURTAIN if name == roles.CURTAIN else roles.ARM for name in registry.names(registry.DRIVERS)}
ARMS = [name for name, role in ROLES.items() if role == roles.ARM]
OURS = {topic.name for topic in (topics.SESSION, topics.SEARCH_GOAL, topics.CANDIDATE, topics.PERMIT)}
SECOND = 1_000_000_000


@dataclass
class Stage:
    """A driver at work, alone with a test that plays the rest of the cell."""

    role: str
    exchange: LocalExchange
    context: Context
    thread: threading.Thread
    audience: LocalBus
    failure: list[BaseException]

    def begin(self) -> None:
        session = self.audience.publisher(topics.SESSION)
        session.send(SessionState(header(0), "test", Phase.STARTING, ""), 0)

    def hear(self, timeout: float = PATIENCE) -> Envelope | None:
        """The next thing the driver says."""
        while (item := self.audience.inbox.receive(timeout)) is not None:
            assert isinstance(item, Envelope)
            if item.topic not in OURS:
                return item
        return None

    def end(self) -> None:
        self.context.stop()
        self.thread.join(PATIENCE)
        assert not self.thread.is_alive()


@pytest.fixture
def stage(request: pytest.FixtureRequest) -> Iterator[Stage]:
    role = ROLES[request.param]
    cell = config.load("igbt").cell
    exchange = LocalExchange()
    audience = LocalBus(exchange, roles.RECORDER)
    audience.subscribe_all()
    context = Context(role, LocalBus(exchange, role), cell, "test")
    plugin: Driver = registry.driver(request.param, {}, "test")
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


every_driver = pytest.mark.parametrize("stage", ROLES, indirect=True)
every_arm = pytest.mark.parametrize("stage", ARMS, indirect=True)


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
    assert ticked.stamp == 0
    cell = stage.context.cell
    belief = Belief(header(0), cell.board.type, "1", 0, Gaussian(), [])
    stage.audience.publisher(topics.SEARCH_GOAL).send(goal_for(cell, cell.board.holes[0], belief, 1, 1, 0), 0)
    stage.audience.publisher(topics.CANDIDATE).send(Candidate(header(0), 1, 1, False, "", Proposal(0.0, 0.0)), 0)
    refusal = Permit(header(0), False, 0, "locked", stamp_of(SECOND))
    stage.audience.publisher(topics.PERMIT).send(refusal, 0)
    assert stage.hear(timeout=0.5) is None


@every_arm
def test_it_moves_no_further_than_its_permit_and_says_when_it_needs_the_next(stage: Stage) -> None:
    stage.begin()
    cell = stage.context.cell
    belief = Belief(header(0), cell.board.type, "1", 0, Gaussian(), [])
    permits = stage.audience.publisher(topics.PERMIT)
    stage.audience.publisher(topics.SEARCH_GOAL).send(goal_for(cell, cell.board.holes[0], belief, 1, 1, 0), 0)
    granted_until = SECOND // 2
    permits.send(Permit(header(0), True, 1, "", stamp_of(granted_until)), 0)
    last: Clock | None = None
    stamps = []
    while (envelope := stage.hear(timeout=2.0)) is not None:
        stamps.append(envelope.stamp)
        if envelope.topic == topics.CLOCK.name:
            last = envelope.read(topics.CLOCK)
    assert last is not None
    assert last.clock == stamp_of(granted_until)
    assert max(stamps) == granted_until
    permits.send(Permit(header(granted_until), True, 1, "", stamp_of(SECOND)), granted_until)
    following = stage.hear()
    assert following is not None
    assert following.stamp > granted_until
