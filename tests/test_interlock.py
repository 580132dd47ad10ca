"""The safety state machine: its table cell by cell, its times to a nanosecond, and what no sequence may bring about."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from runtime.messages import SafetyState
from runtime.safety import interlock as machine
from runtime.safety.interlock import Channel, Fault, Interlock, Reading, Times

MS = 1_000_000
S = 1000 * MS
TIMES = Times(
    filter_time=1 * MS,
    discrepancy=50 * MS,
    test_interval=1 * S,
    watch=30 * S,
    shortest_reset=30 * MS,
    longest_reset=3 * S,
    muting_concurrency=4 * S,
    muting_limit=20 * S,
)
PANEL = "panel"


def on(now: int, off_for: int = 0) -> Reading:
    """A channel that is on and was tested just now."""
    return Reading(True, off_for, now)


OFF = Reading(False)


def clear(state: Interlock, now: int | None = None) -> Interlock:
    now = state.now if now is None else now
    return state.on_ossd(on(now), on(now), now)


def broken(state: Interlock, now: int | None = None) -> Interlock:
    return state.on_ossd(OFF, OFF, state.now if now is None else now)


def one_off(state: Interlock, now: int | None = None) -> Interlock:
    now = state.now if now is None else now
    return state.on_ossd(on(now), OFF, now)


def muted(state: Interlock) -> Interlock:
    return state.on_muting(True, True, state.now)


def stopped(state: Interlock) -> Interlock:
    return state.on_emergency_stop(PANEL, True, state.now)


def later(change: Callable[[Interlock, int], Interlock], wait: int) -> Callable[[Interlock], Interlock]:
    return lambda state: change(state, state.now + wait)


START = Interlock(TIMES)
LOCKED = clear(START, 10 * S)
PERMITTED = LOCKED.on_reset(LOCKED.now)
FAULT = one_off(one_off(PERMITTED), PERMITTED.now + 51 * MS)

COLUMNS: dict[str, tuple[Interlock, ...]] = {
    "T": (broken(START, 10 * S), broken(LOCKED), broken(PERMITTED), START),
    "L": (LOCKED, clear(broken(PERMITTED)), stopped(PERMITTED).on_emergency_stop(PANEL, False, PERMITTED.now)),
    "P": (PERMITTED,),
    "M": (muted(PERMITTED), clear(broken(muted(PERMITTED)))),
    "m": (broken(muted(PERMITTED)),),
    "F": (FAULT, broken(FAULT)),
    "f": (clear(FAULT),),
    "E": (stopped(LOCKED), stopped(PERMITTED), stopped(muted(PERMITTED)), clear(stopped(START))),
    "e": (stopped(broken(LOCKED)), broken(stopped(PERMITTED)), stopped(START)),
    "x": (stopped(clear(FAULT)),),
}


def letter(state: Interlock) -> str:
    """The column of the table that a state belongs to."""
    match state.state:
        case SafetyState.EMERGENCY_STOP:
            return "x" if state.fault else ("E" if state.clear else "e")
        case SafetyState.FAULT:
            return "f" if state.resettable else "F"
        case SafetyState.MUTED:
            return "M" if state.clear else "m"
    return state.state.name[0]


def disagree_too_long(state: Interlock) -> Interlock:
    since = one_off(state)
    return one_off(since, since.now + TIMES.discrepancy + 1)


def untested(state: Interlock) -> Interlock:
    now = state.now + 2 * S
    return state.on_ossd(on(now), Reading(True, 0, now - TIMES.test_interval - 1), now)


def pulse_begins(state: Interlock) -> Interlock:
    return state.on_ossd(on(state.now), Reading(False, 1, state.now), state.now)


def press(held: int) -> Callable[[Interlock], Interlock]:
    return lambda state: state.on_reset_pressed(state.now - held).on_reset_released(state.now)


def too_early(state: Interlock) -> Interlock:
    """The button has been down since before the state was reached."""
    return replace(state, held=True, pressed_at=None).on_reset_released(state.now)


def too_far_apart(state: Interlock) -> Interlock:
    state = state.on_muting(False, False, state.now).on_muting(True, False, state.now)
    after = state.now + TIMES.muting_concurrency + 1
    fresh = Reading(state.channel_1.on, 0, after), Reading(state.channel_2.on, 0, after)
    return state.on_ossd(*fresh, after).on_muting(True, True, after)


def limit_passes(state: Interlock) -> Interlock:
    after = state.now + TIMES.muting_limit + 1
    fresh = Reading(state.channel_1.on, 0, after), Reading(state.channel_2.on, 0, after)
    return state.on_ossd(*fresh, after)


INPUTS: dict[str, tuple[Callable[[Interlock], Interlock], ...]] = {
    "both channels on": (clear, later(clear, 40 * MS)),
    "off pulse up to the filter time, on again": (
        lambda state: state.on_ossd(on(state.now, 1 * MS), on(state.now, 300_000), state.now),
    ),
    "off pulse beyond the filter time, on again": (
        lambda state: state.on_ossd(on(state.now), on(state.now, 1 * MS + 1), state.now),
        lambda state: state.on_ossd(on(state.now, 1 * MS + 1), on(state.now), state.now),
    ),
    "off pulse that may yet stay in the filter time": (
        pulse_begins,
        lambda state: state.on_ossd(Reading(False, 1 * MS, state.now), Reading(False, 1, state.now), state.now),
    ),
    "off pulse outlasts the filter time": (
        lambda state: state.on_ossd(on(state.now), Reading(False, 1 * MS + 1, state.now), state.now),
        lambda state: pulse_begins(state).advance(state.now + 1 * MS),
    ),
    "both channels off": (broken, later(broken, 40 * MS)),
    "one channel off": (
        lambda state: state.on_ossd(OFF, on(state.now), state.now),
        lambda state: state.on_ossd(on(state.now), OFF, state.now),
    ),
    "one channel off beyond the discrepancy time": (
        disagree_too_long,
        lambda state: one_off(state).advance(state.now + TIMES.discrepancy + 1),
    ),
    "one channel's off pulse beyond discrepancy time": (
        lambda state: state.on_ossd(on(state.now, TIMES.discrepancy + 1), on(state.now), state.now),
        lambda state: state.on_ossd(on(state.now), on(state.now, TIMES.discrepancy + 1), state.now),
    ),
    "on without a test pulse beyond the test interval": (untested,),
    "nothing heard beyond the watch time": (lambda state: state.advance((state.heard or 0) + TIMES.watch + 1),),
    "reset": (lambda state: state.on_reset(state.now), press(30 * MS), press(3 * S)),
    "reset button pressed": (lambda state: state.on_reset_pressed(state.now),),
    "reset button released after too short a time": (press(30 * MS - 1), press(0), press(-1 * S)),
    "reset button released after too long a time": (press(3 * S + 1), press(9 * S)),
    "reset button pressed too early, released now": (
        too_early,
        lambda state: too_early(state.on_reset_pressed(state.now - 100 * MS)),
        lambda state: state.on_reset_released(state.now),
    ),
    "emergency stop pressed": (stopped, lambda state: state.on_emergency_stop("other", True, state.now)),
    "emergency stop released": (lambda state: state.on_emergency_stop(PANEL, False, state.now),),
    "muting sensors actuated within concurrency": (muted,),
    "muting sensors actuated too far apart": (too_far_apart,),
    "a muting sensor released": (
        lambda state: state.on_muting(False, True, state.now),
        lambda state: state.on_muting(True, False, state.now),
        lambda state: state.on_muting(False, False, state.now),
    ),
    "muting limit passes": (limit_passes,),
}


def written_table() -> list[tuple[str, str, str]]:
    """Input, state before and state after, for every cell of the table in the docstring."""
    rows = re.findall(r"^    (\S.*?) +\|((?:  \w)+)$", machine.__doc__ or "", flags=re.M)
    (_, columns), *cells = rows
    return [
        (name, before, after)
        for name, line in cells
        for before, after in zip(columns.split(), line.split(), strict=True)
    ]


def test_the_written_table_is_whole() -> None:
    table = written_table()
    assert {name for name, _, _ in table} == set(INPUTS)
    assert {before for _, before, _ in table} == set(COLUMNS)
    assert len(table) == len(INPUTS) * len(COLUMNS) == 220
    assert {state.state for states in COLUMNS.values() for state in states} == set(SafetyState)


@pytest.mark.parametrize("name", INPUTS)
def test_the_table_cell_by_cell(name: str) -> None:
    for row, before, after in written_table():
        if row != name:
            continue
        for state in COLUMNS[before]:
            assert letter(state) == before
            for give in INPUTS[name]:
                assert letter(give(state)) == after, (name, before, state)
                assert give(state).permits == (after in "PMm")


def test_a_late_word_finds_discrepancy_and_silence_passed() -> None:
    """What was heard last holds until something else is heard."""
    since = one_off(PERMITTED).now
    assert clear(one_off(PERMITTED), since + 50 * MS).state is SafetyState.LOCKED
    assert clear(one_off(PERMITTED), since + 50 * MS + 1).state is SafetyState.FAULT
    assert clear(PERMITTED, PERMITTED.now + TIMES.watch).state is SafetyState.PERMITTED
    assert clear(PERMITTED, PERMITTED.now + TIMES.watch + 1).state is SafetyState.LOCKED


def test_channels_may_disagree_briefly_while_they_switch() -> None:
    assert one_off(PERMITTED).advance(PERMITTED.now + 50 * MS).state is SafetyState.TRIPPED
    switching = one_off(PERMITTED)
    for step in range(5):  # the first moment counts, not the last
        switching = one_off(switching, PERMITTED.now + 12 * step * MS)
    assert one_off(switching, PERMITTED.now + 51 * MS).state is SafetyState.FAULT
    again = one_off(clear(one_off(PERMITTED), PERMITTED.now + 30 * MS), PERMITTED.now + 40 * MS)
    assert again.advance(PERMITTED.now + 90 * MS).state is SafetyState.TRIPPED


def test_channels_that_disagree_in_turn_disagree_all_the_while() -> None:
    since = one_off(PERMITTED).now
    swapped = one_off(PERMITTED).on_ossd(OFF, on(since + 30 * MS, 2 * MS), since + 30 * MS)
    assert swapped.disagree_since == since
    assert swapped.advance(since + 50 * MS + 1).state is SafetyState.FAULT
    both_off = one_off(PERMITTED).on_ossd(on(since + 30 * MS, 2 * MS), OFF, since + 30 * MS)
    assert both_off.disagree_since == since, "between two words, whether they agreed for a while cannot be told"
    parted = PERMITTED.on_ossd(OFF, on(since, 2 * MS), since + 1)
    assert parted.disagree_since == since + 1


def test_it_begins_without_a_permit_and_needs_a_reset() -> None:
    assert START.state is SafetyState.TRIPPED
    assert START.reason == "no word from the light curtain"
    assert START.changes_at is None
    assert (START.now, START.restarted, START.pressed_at) == (0, False, None)
    assert START.on_ossd(Reading(True), Reading(True), 1 * S).state is SafetyState.LOCKED
    assert START.on_ossd(Reading(True), Reading(True), 1 * S + 1).fault is Fault.CHANNEL_1_STUCK
    assert not START.on_reset(0).permits
    assert not clear(START, 0).permits
    assert clear(START, 0).on_reset(0).permits


def test_a_test_pulse_passes_while_it_is_short() -> None:
    now = PERMITTED.now
    pulse = PERMITTED.on_ossd(Reading(False, 200_000, now), on(now), now)
    assert (pulse.state, pulse.changes_at) == (SafetyState.PERMITTED, now + 800_001)
    assert pulse.advance(now + 800_000).permits
    assert not pulse.advance(now + 800_001).permits
    ended = pulse.on_ossd(on(now + 80 * MS, 300_000), on(now + 80 * MS, 300_000), now + 80 * MS)
    assert ended.permits
    assert ended.changes_at == now + 80 * MS + TIMES.test_interval + 1
    lasting = pulse.on_ossd(Reading(False, 1 * MS + 1), on(now + MS), now + MS)
    assert lasting.state is SafetyState.TRIPPED
    back = broken(PERMITTED).on_ossd(Reading(False, 1), Reading(False, 1), now)
    assert back.state is SafetyState.TRIPPED, "a channel that is off does not come on by a pulse"


def test_a_channel_without_an_off_time_is_off() -> None:
    assert PERMITTED.on_ossd(on(PERMITTED.now), Reading(False, 0), PERMITTED.now).state is SafetyState.TRIPPED


@pytest.mark.parametrize(
    ("stuck", "fault"),
    [((True, False), Fault.CHANNEL_1_STUCK), ((False, True), Fault.CHANNEL_2_STUCK)],
    ids=["channel 1", "channel 2"],
)
def test_a_channel_that_shows_no_test_pulses_is_stuck(stuck: tuple[bool, bool], fault: Fault) -> None:
    tested = PERMITTED.now

    def read(state: Interlock, now: int) -> Interlock:
        return state.on_ossd(*(Reading(True, 0, tested if is_stuck else now) for is_stuck in stuck), at=now)

    just = read(PERMITTED, tested + 1 * S)
    assert just.permits
    assert just.changes_at == tested + 1 * S + 1
    assert just.advance(tested + 1 * S + 1).permits, "nothing was heard that could have told of a pulse"
    late = read(PERMITTED, tested + 1 * S + 1)
    assert late.fault is fault
    assert late.reason == f"{fault.value}; reset once both are on and tested"
    assert late.on_reset(late.now).state is SafetyState.FAULT
    healed = clear(late, late.now + 1)
    assert healed.reason == f"{fault.value}; reset"
    assert healed.on_reset(healed.now).state is SafetyState.LOCKED


def test_being_off_is_a_test_too_and_a_test_in_the_future_is_none() -> None:
    now = PERMITTED.now
    back = broken(PERMITTED, now + 5 * S).on_ossd(Reading(True), Reading(True), now + 6 * S)
    assert back.state is SafetyState.LOCKED
    assert back.on_ossd(Reading(True), Reading(True), now + 6 * S + 1).fault is Fault.CHANNEL_1_STUCK
    ahead = PERMITTED.on_ossd(Reading(True, 0, now + 99 * S), Reading(True, 0, now + 99 * S), now)
    assert ahead.on_ossd(Reading(True), Reading(True), now + 1 * S).permits
    assert ahead.on_ossd(Reading(True), Reading(True), now + 1 * S + 1).fault is Fault.CHANNEL_1_STUCK


def test_off_times_of_both_channels_together_are_no_discrepancy() -> None:
    def pulses(first: int, second: int) -> Interlock:
        return PERMITTED.on_ossd(on(PERMITTED.now, first), on(PERMITTED.now, second), PERMITTED.now)

    assert pulses(60 * MS, 60 * MS).state is SafetyState.LOCKED
    assert pulses(51 * MS, 1 * MS).state is SafetyState.LOCKED
    assert pulses(1 * MS, 51 * MS + 1).state is SafetyState.FAULT


def test_a_channel_that_is_switched_off_keeps_when_it_was_tested() -> None:
    assert Channel(True, 5, 7).off() == Channel(False, None, 7)
    silent = PERMITTED.advance(PERMITTED.now + TIMES.watch + 1)
    assert silent.channel_1 == silent.channel_2 == Channel(False, None, PERMITTED.now)


def test_a_word_older_than_the_last_is_not_heard() -> None:
    assert clear(broken(PERMITTED, PERMITTED.now + 1), PERMITTED.now).state is SafetyState.TRIPPED
    assert broken(PERMITTED, PERMITTED.now - 1) == PERMITTED


def test_a_word_that_is_late_is_still_heard_at_the_latest_moment() -> None:
    ahead = PERMITTED.on_muting(False, False, PERMITTED.now + 100 * MS)
    late = one_off(ahead, PERMITTED.now + 1)
    assert (late.now, late.heard) == (PERMITTED.now + 100 * MS, PERMITTED.now + 1)
    assert late.advance(late.now + 50 * MS).state is SafetyState.TRIPPED
    assert late.advance(late.now + 50 * MS + 1).state is SafetyState.FAULT
    assert ahead.advance(0) == ahead


def test_a_reset_held_from_before_the_field_was_clear_does_nothing() -> None:
    for before in (broken(PERMITTED), stopped(PERMITTED), FAULT, untested(PERMITTED)):
        held = before.on_reset_pressed(before.now)
        ready = clear(held.on_emergency_stop(PANEL, False, held.now), held.now + 100 * MS)
        released = ready.on_reset_released(ready.now + 100 * MS)
        assert released.state is ready.state
        assert released.held is False
        again = released.on_reset_pressed(released.now).on_reset_released(released.now + 100 * MS)
        assert again.state is not released.state


def test_a_press_is_void_once_the_field_was_interrupted_during_it() -> None:
    held = LOCKED.on_reset_pressed(LOCKED.now)
    for interrupted in (
        clear(broken(held), held.now + 50 * MS),
        held.on_ossd(on(held.now + 9 * MS, 2 * MS), on(held.now + 9 * MS, 2 * MS), held.now + 9 * MS),
        stopped(held).on_emergency_stop(PANEL, False, held.now),
        clear(held.advance(held.now + TIMES.watch + 1)),
    ):
        assert interrupted.state is SafetyState.LOCKED
        assert not interrupted.on_reset_released(held.now + 100 * MS).permits


def test_a_button_that_says_twice_that_it_is_down_is_down_since_the_first() -> None:
    early = broken(PERMITTED).on_reset_pressed(PERMITTED.now)
    repeated = clear(early).on_reset_pressed(PERMITTED.now)
    assert not repeated.on_reset_released(PERMITTED.now + 100 * MS).permits
    long = LOCKED.on_reset_pressed(LOCKED.now).on_reset_pressed(LOCKED.now + 10 * MS)
    assert long.on_reset_released(LOCKED.now + 30 * MS).permits


def test_one_press_is_one_reset() -> None:
    short = LOCKED.on_reset_pressed(LOCKED.now).on_reset_released(LOCKED.now + 10 * MS)
    assert not short.on_reset_released(LOCKED.now + 100 * MS).permits, "the button came up twice"
    ready = clear(FAULT)
    held = ready.on_reset_pressed(ready.now).on_reset(ready.now)
    assert held.state is SafetyState.LOCKED
    assert not held.on_reset_released(held.now + 100 * MS).permits
    both = LOCKED.on_reset_pressed(LOCKED.now).on_reset(LOCKED.now)
    assert both.pressed_at is None
    once = ready.on_reset_pressed(ready.now).on_reset_released(ready.now + 100 * MS)
    assert once.on_reset_released(once.now).state is SafetyState.LOCKED


def test_the_stop_category_is_1_from_an_emergency_stop_until_motion_is_permitted_again() -> None:
    assert [state.stop_category for state in (START, PERMITTED, broken(PERMITTED), FAULT)] == [2, 2, 2, 2]
    released = stopped(PERMITTED).on_emergency_stop(PANEL, False, PERMITTED.now)
    assert [state.stop_category for state in (stopped(PERMITTED), released, broken(released))] == [1, 1, 1]
    assert released.reason == "emergency stop released, field clear, waiting for reset"
    restarted = released.on_reset(released.now)
    assert (restarted.stop_category, restarted.permits) == (2, True)
    assert restarted == PERMITTED
    assert LOCKED.reason == "field clear, waiting for reset"


def test_every_pressed_emergency_stop_must_be_released() -> None:
    two = stopped(PERMITTED).on_emergency_stop("door", True, PERMITTED.now)
    assert two.reason == "emergency stop pressed: door, panel"
    one = two.on_emergency_stop("door", False, two.now)
    assert one.state is SafetyState.EMERGENCY_STOP
    assert one.on_emergency_stop("door", False, one.now) == one
    assert not one.on_reset(one.now).on_emergency_stop(PANEL, False, one.now).permits


def test_muting_begins_as_the_second_sensor_follows_the_first_in_time() -> None:
    def second_after(wait: int, first: tuple[bool, bool]) -> Interlock:
        state = PERMITTED.on_muting(*first, PERMITTED.now)
        return clear(state, PERMITTED.now + wait).on_muting(True, True, PERMITTED.now + wait)

    for first in ((True, False), (False, True)):
        assert second_after(4 * S, first).state is SafetyState.MUTED
        assert second_after(4 * S + 1, first).state is SafetyState.PERMITTED
    assert PERMITTED.on_muting(True, False, PERMITTED.now).state is SafetyState.PERMITTED


def test_sensors_that_were_actuated_before_motion_was_permitted_do_not_mute() -> None:
    waiting = muted(LOCKED)
    restarted = waiting.on_reset(waiting.now)
    assert restarted.state is SafetyState.PERMITTED
    assert muted(restarted).state is SafetyState.PERMITTED
    half = LOCKED.on_muting(True, False, LOCKED.now).on_reset(LOCKED.now)
    assert muted(half).state is SafetyState.MUTED, "the second sensor is what begins it"


def test_muting_ends_after_its_limit_and_does_not_begin_again_by_itself() -> None:
    begin = muted(PERMITTED)
    kept = clear(begin, begin.now + 20 * S)
    assert kept.state is SafetyState.MUTED
    assert kept.changes_at == begin.now + 20 * S + 1
    over = clear(kept, begin.now + 20 * S + 1)
    assert over.state is SafetyState.PERMITTED
    assert muted(over).state is SafetyState.PERMITTED
    one_anew = muted(over.on_muting(False, True, over.now))
    assert one_anew.state is SafetyState.PERMITTED, "the other has been actuated for too long"
    assert muted(over.on_muting(False, False, over.now)).state is SafetyState.MUTED


def test_muting_passes_over_neither_fault_nor_silence() -> None:
    material = broken(muted(PERMITTED))
    assert material.reason == "light field interrupted, muted"
    assert muted(PERMITTED).reason == "field clear, muting"
    parted = one_off(material)
    assert parted.permits
    assert parted.changes_at == parted.now + 50 * MS + 1
    assert parted.advance(parted.now + 50 * MS + 1).state is SafetyState.FAULT
    assert untested(material).state is SafetyState.FAULT
    silent = material.advance(material.now + TIMES.watch + 1)
    assert (silent.state, silent.reason) == (SafetyState.TRIPPED, "no word from the light curtain")
    assert not clear(stopped(material).on_emergency_stop(PANEL, False, material.now)).permits
    long_muting = replace(PERMITTED, times=replace(TIMES, muting_limit=99 * S))
    assert not muted(long_muting).advance(long_muting.now + TIMES.watch + 1).permits


def test_what_was_heard_can_hold_until_the_first_limit_of_all() -> None:
    now = PERMITTED.now
    silence_first = replace(PERMITTED, times=replace(TIMES, watch=900 * MS))
    assert silence_first.changes_at == now + 900 * MS + 1
    assert one_off(PERMITTED).changes_at == now + 50 * MS + 1
    assert broken(PERMITTED).changes_at == now + TIMES.watch + 1
    assert broken(PERMITTED).advance(now + TIMES.watch + 1).changes_at is None
    second_later = PERMITTED.on_ossd(Reading(True, 0, now + 5), Reading(True, 0, now + 7), now + 9)
    assert second_later.changes_at == now + 5 + TIMES.test_interval + 1


def test_a_pulse_of_one_channel_that_was_long_does_not_switch_the_other() -> None:
    now = PERMITTED.now
    back = one_off(PERMITTED).on_ossd(Reading(False, 1, now + 9 * MS), on(now + 9 * MS, 9 * MS), now + 9 * MS)
    assert (back.state, back.clear) == (SafetyState.LOCKED, True)


def test_reasons_in_words() -> None:
    assert PERMITTED.reason == "field clear"
    assert broken(PERMITTED).reason == "light field interrupted"
    assert [fault.value for fault in Fault] == [
        "the two channels disagree",
        "channel 1 shows no test pulses: it may be stuck on",
        "channel 2 shows no test pulses: it may be stuck on",
    ]
    assert FAULT.reason == "the two channels disagree; reset once both are on and tested"
    assert clear(FAULT).reason == "the two channels disagree; reset"
    assert PERMITTED.advance(PERMITTED.now + TIMES.watch + 1).reason == "no word from the light curtain"


def test_the_limits_that_hold_unless_a_cell_says_otherwise() -> None:
    assert Times() == Times(
        filter_time=1 * MS,
        discrepancy=50 * MS,
        test_interval=1 * S,
        watch=2 * S,
        shortest_reset=30 * MS,
        longest_reset=3 * S,
        muting_concurrency=4 * S,
        muting_limit=30 * S,
    )


# What no sequence of inputs may bring about

SHORT = replace(TIMES, watch=2 * S, muting_limit=3 * S)
WAITS = st.one_of(
    st.integers(0, 5 * S),
    st.sampled_from([0, 1, 1 * MS, 30 * MS, 50 * MS, 50 * MS + 1, 1 * S, 1 * S + 1, 2 * S + 1, 3 * S + 1]),
)
PULSES = st.sampled_from([0, 1, 300_000, 1 * MS, 1 * MS + 1, 60 * MS])
AGES = st.sampled_from([0, 40 * MS, 1 * S, 1 * S + 1, 9 * S])


@dataclass
class Seen:
    """What an onlooker with a watch of his own knows of what the interlock was told."""

    channels: tuple[bool, bool] = (False, False)
    stop_unanswered: bool = True  # a stop that no proper reset has followed
    emergency: set[str] = field(default_factory=set)
    sensors: tuple[int | None, int | None] = (None, None)  # actuated since
    last_word: int | None = None


@st.composite
def readings(draw: st.DrawFn, now: int) -> Reading:
    return Reading(draw(st.booleans()), draw(PULSES), now - draw(AGES))


class AnySequence(RuleBasedStateMachine):
    """Gives the interlock anything, at any time, and checks after each input what must hold always."""

    @initialize()
    def begin(self) -> None:
        self.now = 10 * S
        self.state = Interlock(SHORT)
        self.seen = Seen()

    def give(self, following: Interlock, *, reset: bool = False) -> None:
        before, self.state = self.state, following
        if not before.permits and following.permits:
            assert reset, "motion is permitted by a reset alone"
            assert before.state is SafetyState.LOCKED
        if before.state is SafetyState.FAULT and following.state not in (SafetyState.FAULT, SafetyState.EMERGENCY_STOP):
            assert reset, "a fault is left by a reset alone"
            assert following.state is SafetyState.LOCKED
            assert before.clear
        if before.fault is not None and following.fault is None:
            assert reset
        if following.state is SafetyState.MUTED and before.state is not SafetyState.MUTED:
            assert before.state is SafetyState.PERMITTED
        if following.permits:
            assert following.advance(following.now) == following

    @rule(wait=WAITS, data=st.data())
    def word(self, wait: int, data: st.DataObject) -> None:
        self.now += wait
        first, second = data.draw(readings(self.now)), data.draw(readings(self.now))
        following = self.state.on_ossd(first, second, self.now)
        assert following == following.on_ossd(first, second, self.now), "said twice is said once"
        self.seen.last_word = self.now
        self.seen.channels = first.on, second.on
        for reading in (first, second):
            really_off = not reading.on and not 0 < reading.off_for <= SHORT.filter_time
            if (really_off or reading.off_for > SHORT.filter_time) and following.state is not SafetyState.MUTED:
                assert not following.permits
        self.give(following)

    @rule(wait=WAITS, tested=st.integers(0, 900 * MS))
    def good_word(self, wait: int, tested: int) -> None:
        self.now += wait
        reading = Reading(True, 300_000, self.now - tested)
        following = self.state.on_ossd(reading, reading, self.now)
        self.seen.last_word, self.seen.channels = self.now, (True, True)
        if self.state.state is SafetyState.PERMITTED and wait <= min(SHORT.watch, SHORT.discrepancy):
            assert following.permits, "a test pulse within the filter time does not trip"
        self.give(following)

    @rule(wait=WAITS)
    def silence(self, wait: int) -> None:
        self.now += wait
        self.give(self.state.advance(self.now))

    @rule()
    def reset(self) -> None:
        self.give(self.state.on_reset(self.now), reset=True)

    @rule(held=WAITS)
    def press(self, held: int) -> None:
        pressed = self.state.on_reset_pressed(self.now)
        assert pressed == pressed.on_reset_pressed(self.now)
        self.give(pressed)
        self.now += held
        in_time = SHORT.shortest_reset <= held <= SHORT.longest_reset
        released = self.state.on_reset_released(self.now)
        assert released.on_reset_released(self.now) == released
        if not in_time:
            assert not released.permits or self.state.permits
        self.give(released, reset=in_time)

    @rule(device=st.sampled_from(["panel", "door"]), pressed=st.booleans())
    def emergency(self, device: str, pressed: bool) -> None:
        following = self.state.on_emergency_stop(device, pressed, self.now)
        assert following == following.on_emergency_stop(device, pressed, self.now)
        (self.seen.emergency.add if pressed else self.seen.emergency.discard)(device)
        self.give(following)

    @rule(wait=WAITS, sensor_1=st.booleans(), sensor_2=st.booleans())
    def muting(self, wait: int, sensor_1: bool, sensor_2: bool) -> None:
        self.now += wait
        following = self.state.on_muting(sensor_1, sensor_2, self.now)
        assert following == following.on_muting(sensor_1, sensor_2, self.now)
        first, second = (
            (self.now if since is None else since) if actuated else None
            for since, actuated in zip(self.seen.sensors, (sensor_1, sensor_2), strict=True)
        )
        self.seen.sensors = first, second
        self.give(following)

    @invariant()
    def holds_always(self) -> None:
        state, seen = self.state, self.seen
        assert bool(seen.emergency) == (state.state is SafetyState.EMERGENCY_STOP)
        if state.state is SafetyState.PERMITTED:
            assert state.channel_1.on
            assert state.channel_2.on
        if state.state is SafetyState.MUTED:
            first, second = seen.sensors
            assert first is not None
            assert second is not None
            assert abs(first - second) <= SHORT.muting_concurrency
            assert state.now <= max(first, second) + SHORT.muting_limit
        if state.permits:
            assert seen.last_word is not None
            assert state.now - seen.last_word <= SHORT.watch
            assert state.disagree_since is None or state.now - state.disagree_since <= SHORT.discrepancy
            for channel in (state.channel_1, state.channel_2):
                assert not channel.on or seen.last_word - channel.tested <= SHORT.test_interval
            assert state.stop_category == 2
        if state.state is SafetyState.EMERGENCY_STOP:
            assert state.stop_category == 1

    @invariant()
    def changes_at_nothing_but_the_moment_it_names(self) -> None:
        moment = self.state.changes_at
        if moment is None:
            return
        assert moment > self.state.now
        assert self.state.advance(moment - 1) == replace(self.state, now=moment - 1)


AnySequence.TestCase.settings = settings(max_examples=40, stateful_step_count=25, deadline=None)
TestAnySequence = AnySequence.TestCase
