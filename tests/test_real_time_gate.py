"""The permit for an arm that moves by itself: whatever arrives, and whenever, no motion without a fresh permit."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.ur3e.real_time_gate import TICK, RealTimeGate
from runtime import config, roles, topics
from runtime.bus import Envelope
from runtime.context import Context
from runtime.errors import SessionError
from runtime.local_bus import LocalBus, LocalExchange
from runtime.messages import Candidate, Permit, Proposal, header, stamp_of

CYCLE = 2_000_000  # [ns]
MS = 1_000_000
CELL = config.load("igbt").cell
DEADLINE = round(CELL.safety.deadline * 1e9)
PATIENCE = round(CELL.safety.patience * 1e9)


class Play:
    """A gate, with a test in the interlock's place."""

    def __init__(self) -> None:
        exchange = LocalExchange()
        self.others = LocalBus(exchange, roles.INTERLOCK)
        self.others.subscribe(topics.CLOCK)
        bus = LocalBus(exchange, roles.ARM)
        bus.subscribe(topics.PERMIT, topics.CANDIDATE)
        self.context = Context(roles.ARM, bus, CELL, "test")
        self.context.ready()
        self.gate = RealTimeGate(self.context, bus.publisher(topics.CLOCK))
        self._permits = self.others.publisher(topics.PERMIT)
        self.candidates = self.others.publisher(topics.CANDIDATE)
        self._said = 0

    def say(self, granted: bool, since: int, until: int) -> None:
        self._said += 1
        word = Permit(header(since), granted, int(granted), "", stamp_of(until), ossd=self._said, session="test")
        self._permits.send(word, since)

    def ticks(self) -> list[int]:
        found = []
        while (item := self.others.inbox.poll()) is not None:
            assert isinstance(item, Envelope)
            found.append(item.stamp)
        return found


@dataclass(frozen=True)
class Word:
    granted: bool
    holds: int  # [ns] from the tick that it answers


words = st.builds(Word, st.booleans(), st.integers(0, DEADLINE // MS).map(lambda t: t * MS))
steps = st.lists(
    st.tuples(st.integers(1, 200), st.lists(words, max_size=3), st.sampled_from([False] * 19 + [True])), max_size=60
)


@given(steps)
@settings(deadline=None, max_examples=60)
def test_motion_needs_a_grant_that_still_holds_and_nothing_else(steps: list[tuple[int, list[Word], bool]]) -> None:
    play = Play()
    play.gate(0)
    now, ticked, granted, until, stopped = 0, 0, False, -1, False
    heard, lost = 0, False
    for cycles, said, stop in steps:
        now += cycles * CYCLE
        for word in said:
            granted, until = word.granted, ticked + word.holds
            play.say(granted, ticked, until)
            heard = now
        lost = lost or now - heard > PATIENCE
        if now - ticked >= TICK:
            ticked = now
        if stop:
            play.context.stop()
            stopped = True
        moves = play.gate(now)
        assert moves == (granted and now < until and not stopped and not lost)


def test_a_grant_ends_by_itself_and_the_next_one_resumes() -> None:
    play = Play()
    assert not play.gate(0)
    play.say(True, 0, 200 * MS)
    assert play.gate(CYCLE)
    assert play.gate(198 * MS)
    assert not play.gate(200 * MS)
    assert not play.gate(260 * MS)
    play.say(True, 260 * MS, 460 * MS)
    assert play.gate(262 * MS)
    play.say(False, 260 * MS, 460 * MS)
    assert not play.gate(266 * MS)


def test_session_time_is_told_often_enough_for_every_permit() -> None:
    play = Play()
    for cycle in range(500):
        play.gate(cycle * CYCLE)
    ticks = play.ticks()
    assert ticks[0] == 0
    assert {later - earlier for earlier, later in pairwise(ticks)} == {TICK}
    assert DEADLINE >= 5 * TICK


def test_what_is_not_for_the_gate_is_kept_in_order() -> None:
    play = Play()
    play.gate(0)
    for number in (1, 2):
        play.candidates.send(Candidate(header(0), 1, number, False, "", Proposal(0.0, 0.0)), 0)
        play.say(True, 0, 100 * MS)
    assert play.gate(CYCLE)
    assert [item.read(topics.CANDIDATE).number for item in play.gate.waiting] == [1, 2]


def test_an_interlock_that_fell_silent_is_lost_for_good() -> None:
    play = Play()
    play.gate(0)
    play.say(True, 0, DEADLINE)
    assert play.gate(CYCLE)
    assert not play.gate(CYCLE + PATIENCE)
    play.gate.check()
    assert not play.gate(2 * CYCLE + PATIENCE)
    with pytest.raises(SessionError, match="no permit within 15 s: interlock or light curtain is silent"):
        play.gate.check()
    play.say(True, CYCLE + PATIENCE, CYCLE + PATIENCE + DEADLINE)
    assert not play.gate(3 * CYCLE + PATIENCE)
