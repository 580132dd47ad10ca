"""The simulated light curtain with the interlock: each scripted behaviour, and that the curtain keeps its word."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.light_curtain.output import PULSE_PERIOD, PULSE_WIDTH
from drivers.light_curtain.script import script_of
from runtime.cell import CurtainFault, EmergencyStopPress, Interruption, MutingPass, ResetPress, Safety
from runtime.messages import (
    EmergencyStop,
    Muting,
    Ossd,
    Permit,
    Reset,
    ResetEdge,
    SafetyState,
    header,
    nanoseconds_of,
    stamp_of,
)
from runtime.safety.plugin import InterlockDesk

MS = 1_000_000
S = 1000 * MS
CYCLE = 2 * MS
TICK = 80 * MS


@dataclass
class Lockstep:
    """A simulation in lockstep with curtain and interlock, as `permit_gate` keeps it, without arm or bus."""

    safety: Safety
    tick: int = TICK
    cycle: int = CYCLE
    words: int = 0
    permits: list[Permit] = field(default_factory=list)  # at each cycle the one in force

    def run(self, seconds: float) -> Lockstep:
        script, desk = script_of(self.safety), InterlockDesk.of(self.safety, "a session")
        last, ticked, permit = -1, -self.tick, Permit(header(0), False, 0, "", stamp_of(-1))
        for now in range(0, round(seconds * S), self.cycle):
            if now >= nanoseconds_of(permit.valid_until) or now - ticked >= self.tick:
                for _, event in script.said(last, now):
                    desk.hear(event)
                said = desk.hear(script.word(now, last))
                if now == 0:
                    said = desk.hear(Reset(header(0), "operator"))
                assert said is not None
                permit, last, ticked = said, now, now
                self.words += 1
            assert now < nanoseconds_of(permit.valid_until), "a word holds for the moment that it is about"
            self.permits.append(permit)
        return self

    @property
    def story(self) -> list[tuple[float, str]]:
        """When [s] which state began."""
        told: list[tuple[float, str]] = []
        for index, permit in enumerate(self.permits):
            state = SafetyState(permit.state).name
            if not told or told[-1][1] != state:
                told.append((index * self.cycle / S, state))
        return told


BEGIN = (0.0, "PERMITTED")
STORIES: dict[str, tuple[Safety, list[tuple[float, str]]]] = {
    "an undisturbed session": (Safety(), []),
    "interruption": (
        Safety(interruptions=(Interruption(at=1.0),)),
        [(1.0, "TRIPPED"), (3.0, "LOCKED"), (4.0, "PERMITTED")],
    ),
    "emergency stop": (
        Safety(emergency_stops=(EmergencyStopPress(at=1.0),)),
        [(1.0, "EMERGENCY_STOP"), (3.0, "LOCKED"), (4.0, "PERMITTED")],
    ),
    "channel 1 stuck: no test pulse since 0.9713 s": (
        Safety(curtain_faults=(CurtainFault(at=1.0, kind="channel_1_stuck"),)),
        [(1.972, "FAULT"), (4.0, "LOCKED"), (5.0, "PERMITTED")],
    ),
    "channel 2 stuck as the field is interrupted": (
        Safety(
            curtain_faults=(CurtainFault(at=1.0, kind="channel_2_stuck"),),
            interruptions=(Interruption(at=1.2, clear_after=1.0, reset_after=9.0),),
        ),
        [(1.2, "TRIPPED"), (1.252, "FAULT"), (4.0, "LOCKED"), (5.0, "PERMITTED")],
    ),
    "channel 1 stays off": (
        Safety(curtain_faults=(CurtainFault(at=1.0, kind="channel_1_off", ends_after=0.5, reset_after=0.5),)),
        [(1.0, "TRIPPED"), (1.052, "FAULT"), (2.0, "LOCKED"), (2.5, "PERMITTED")],
    ),
    "a discrepancy that is short enough": (
        Safety(curtain_faults=(CurtainFault(at=1.0, kind="channel_2_off", ends_after=0.05, reset_after=0.5),)),
        [(1.0, "TRIPPED"), (1.05, "LOCKED"), (1.55, "PERMITTED")],
    ),
    "material passes while muted": (
        Safety(mutings=(MutingPass(at=1.0),), interruptions=(Interruption(at=2.0, clear_after=1.0, reset_after=90.0),)),
        [(1.5, "MUTED"), (5.0, "PERMITTED")],
    ),
    "the field is still interrupted when muting ends": (
        Safety(mutings=(MutingPass(at=1.0),), interruptions=(Interruption(at=2.0, clear_after=4.0),)),
        [(1.5, "MUTED"), (5.0, "TRIPPED"), (6.0, "LOCKED"), (7.0, "PERMITTED")],
    ),
    "the muting limit": (
        Safety(muting_limit=1.0, mutings=(MutingPass(at=1.0),), interruptions=(Interruption(at=2.0),)),
        [(1.5, "MUTED"), (2.502, "TRIPPED"), (4.0, "LOCKED"), (5.0, "PERMITTED")],
    ),
    "muting sensors too far apart": (
        Safety(mutings=(MutingPass(at=1.0, second_after=4.1, lasts=6.0),)),
        [],
    ),
    "emergency stop while muted": (
        Safety(
            mutings=(MutingPass(at=1.0, lasts=8.0),),
            emergency_stops=(EmergencyStopPress(at=2.0),),
            interruptions=(Interruption(at=1.6, clear_after=2.0, reset_after=90.0),),
        ),
        [(1.5, "MUTED"), (2.0, "EMERGENCY_STOP"), (4.0, "LOCKED"), (5.0, "PERMITTED")],
    ),
    "resets held down and too early, then a proper one": (
        Safety(
            interruptions=(Interruption(at=1.0, reset_after=90.0),),
            resets=(ResetPress(at=2.5, held=1.0), ResetPress(at=3.6, held=3.2), ResetPress(at=7.0, held=0.2)),
        ),
        [(1.0, "TRIPPED"), (3.0, "LOCKED"), (7.2, "PERMITTED")],
    ),
}


@pytest.mark.parametrize("name", STORIES)
def test_a_scripted_session_goes_as_told(name: str) -> None:
    safety, story = STORIES[name]
    went = Lockstep(safety).run(9.0)
    assert went.story == [BEGIN, *story]
    assert {permit.session for permit in went.permits} == {"a session"}
    assert went.words < 9 * S / TICK + 40, "the curtain vouches far ahead"


def test_an_emergency_stop_asks_for_category_1_until_motion_is_permitted_again() -> None:
    went = Lockstep(STORIES["emergency stop"][0]).run(5.0)
    assert [went.permits[round(at * S) // CYCLE].stop_category for at in (0.998, 1.0, 3.5, 4.0)] == [2, 1, 1, 2]


times = st.integers(0, 40).map(lambda n: n / 10 + 0.005)
spans = st.integers(1, 30).map(lambda n: n / 10)
scripts = st.builds(
    Safety,
    deadline=st.sampled_from([0.01, 0.2, 1.0]),
    muting_limit=st.sampled_from([0.7, 30.0]),
    interruptions=st.lists(st.builds(Interruption, times, spans, spans), max_size=2).map(tuple),
    curtain_faults=st.lists(
        st.builds(
            CurtainFault,
            times,
            st.sampled_from(["channel_1_stuck", "channel_2_stuck", "channel_1_off", "channel_2_off"]),
            spans,
            spans,
        ),
        max_size=2,
    ).map(tuple),
    emergency_stops=st.lists(st.builds(EmergencyStopPress, times, spans, spans), max_size=1).map(tuple),
    mutings=st.lists(st.builds(MutingPass, times, spans, spans), max_size=2).map(tuple),
    resets=st.lists(st.builds(ResetPress, times, spans), max_size=2).map(tuple),
)


@settings(max_examples=15, deadline=None)
@given(scripts)
def test_a_permit_in_force_says_what_asking_in_every_cycle_would(safety: Safety) -> None:
    """What the curtain vouches for, and the interlock permits ahead of time, comes true to the cycle."""
    far, near = (Lockstep(safety, tick, 9_700_000).run(6.0) for tick in (TICK, 1))
    assert far.story == near.story
    assert far.words <= near.words


@settings(max_examples=50, deadline=None)
@given(scripts, st.integers(0, 6 * S), st.integers(0, 200 * MS))
def test_what_a_word_tells_of_the_time_before_it_is_what_was(safety: Safety, now: int, since: int) -> None:
    script, before = script_of(safety), max(0, now - since)
    word = script.word(now, before)
    assert nanoseconds_of(word.header.stamp) == now < nanoseconds_of(word.valid_until) <= now + safety.deadline * S
    for output, on, off_time, tested in (
        (script.outputs[0], word.channel_1, word.channel_1_off_time, nanoseconds_of(word.channel_1_tested)),
        (script.outputs[1], word.channel_2, word.channel_2_off_time, nanoseconds_of(word.channel_2_tested)),
    ):
        assert tested <= now
        if tested:
            assert not output.level(max(tested - 1, 0), 0).on
        assert all(output.level(at, 0).on for at in range(tested, now, 50_000)[:200]) or not on
        if on and not off_time:
            assert all(output.level(at, 0).on for at in range(before, now, 100_000))


def test_test_pulses_come_in_turn_and_hold_off_while_a_channel_is_stuck() -> None:
    script = script_of(Safety(curtain_faults=(CurtainFault(at=1.0, kind="channel_1_stuck", ends_after=1.0),)))

    def pulses(output: int, begin: int, end: int) -> list[int]:
        level = script.outputs[output].level
        step = 100_000
        return [at for at in range(begin, end, step) if not level(at, 0).on and level(at - step, 0).on]

    first, second = pulses(0, MS, 200 * MS), pulses(1, MS, 200 * MS)
    assert first == [11 * MS + n * PULSE_PERIOD for n in range(5)]
    assert second == [31 * MS + n * PULSE_PERIOD for n in range(5)]
    assert script.word(first[1] + PULSE_WIDTH, first[1]).channel_1_off_time == PULSE_WIDTH
    assert script.word(first[1] + 100_000, first[1]).channel_1_off_time == 100_000
    assert pulses(0, 990 * MS, 2 * S) == []
    assert len(pulses(1, 990 * MS, 2 * S)) == 26
    assert script.word(2 * S, S).channel_1_tested == stamp_of(971 * MS + PULSE_WIDTH)


def heard(*messages: Ossd | Reset | EmergencyStop | Muting) -> tuple[InterlockDesk, Permit]:
    desk = InterlockDesk.of(Safety(), "a session")
    said = [desk.hear(message) for message in messages][-1]
    assert said is not None
    return desk, said


def clear_at(now: int) -> Ossd:
    return Ossd(header(now), True, True, stamp_of(now + S), 0, 0, stamp_of(now), stamp_of(now))


def reset_at(now: int, edge: ResetEdge = ResetEdge.PRESSED_AND_RELEASED) -> Reset:
    return Reset(header(now), "operator", edge)


def test_a_permit_counts_what_was_heard_before_it() -> None:
    stop = EmergencyStop(header(0), "panel", False)
    _, permit = heard(reset_at(0), clear_at(0), reset_at(0), stop, stop, Muting(header(0), False, False), clear_at(1))
    assert (permit.ossd, permit.resets, permit.emergency_stops, permit.mutings) == (2, 2, 2, 1)
    assert (permit.granted, permit.state, permit.session) == (True, SafetyState.PERMITTED, "a session")
    assert nanoseconds_of(permit.valid_until) == 1 + 200 * MS


def test_nothing_is_said_before_the_curtain_has_spoken() -> None:
    desk = InterlockDesk.of(Safety())
    assert desk.hear(reset_at(0)) is None
    assert desk.hear(EmergencyStop(header(0), "panel", True)) is None
    assert desk.hear(Muting(header(0), True, True)) is None
    permit = desk.hear(clear_at(0))
    assert permit is not None
    assert permit.state == SafetyState.EMERGENCY_STOP


@pytest.mark.parametrize(
    "message",
    [reset_at(10**6 * S), EmergencyStop(header(10**6 * S), "panel", False), Muting(header(10**6 * S), False, False)],
    ids=["reset", "emergency stop", "muting"],
)
def test_a_stamp_from_far_ahead_does_not_carry_the_interlock_along(message: Reset | EmergencyStop | Muting) -> None:
    desk, _ = heard(clear_at(0), reset_at(0), message)
    assert desk.interlock.now <= 2 * S
    permit = desk.hear(clear_at(20 * MS))
    assert permit is not None
    assert permit.granted


def test_a_reset_of_an_unknown_kind_does_nothing() -> None:
    _, permit = heard(clear_at(0), replace(reset_at(0), edge=77))
    assert (permit.state, permit.resets) == (SafetyState.LOCKED, 1)


def test_an_old_word_of_the_curtain_does_not_renew_a_permit() -> None:
    desk, permit = heard(clear_at(100 * MS), reset_at(100 * MS), clear_at(50 * MS))
    assert nanoseconds_of(permit.header.stamp) == 100 * MS
    assert (permit.ossd, permit.granted) == (2, True)
    assert desk.interlock.heard == 100 * MS


def test_a_curtain_that_tells_of_no_test_pulses_is_trusted_for_one_test_interval() -> None:
    def bare(now: int) -> Ossd:
        return Ossd(header(now), True, True, stamp_of(now + S))

    _, permit = heard(bare(0), reset_at(0), bare(900 * MS))
    assert permit.granted
    assert nanoseconds_of(permit.valid_until) == 1 * S + 1
    _, permit = heard(bare(0), reset_at(0), bare(900 * MS), bare(1 * S + 1))
    assert permit.state == SafetyState.FAULT
    _, permit = heard(bare(0), reset_at(0), Ossd(header(1), True, False, stamp_of(S)))
    assert permit.state == SafetyState.TRIPPED
