"""The safety state machine, its table, and what no sequence of inputs may bring about."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from drivers.light_curtain.script import Script, events_of
from runtime.cell import Interruption
from runtime.interlock import REASONS, Interlock
from runtime.messages import SafetyState

MS = 1_000_000
DISCREPANCY = 50 * MS


def interlock(state: SafetyState, *, clear: bool) -> Interlock:
    return Interlock(DISCREPANCY, state, clear)


def test_it_begins_without_a_permit_and_needs_a_reset() -> None:
    now = Interlock(DISCREPANCY)
    assert not now.permits
    assert not now.on_reset().permits
    now = now.on_ossd(True, True, 0)
    assert now.state is SafetyState.LOCKED
    assert now.on_reset().permits


def test_the_table_of_transitions() -> None:
    locked, permitted, tripped, fault = (
        SafetyState.LOCKED,
        SafetyState.PERMITTED,
        SafetyState.TRIPPED,
        SafetyState.FAULT,
    )
    table = {
        locked: (locked, tripped, fault, permitted, locked),
        permitted: (permitted, tripped, fault, permitted, permitted),
        tripped: (locked, tripped, fault, tripped, tripped),
        fault: (fault, fault, fault, locked, fault),
    }
    for state, (both, one_off, too_long, reset_clear, reset_else) in table.items():
        before = interlock(state, clear=state in (locked, permitted))
        assert before.on_ossd(True, True, 0).state is both
        assert before.on_ossd(True, False, 0).state is one_off
        assert before.on_ossd(False, False, 0).state is one_off
        disagreeing = before.on_ossd(False, True, 0)
        assert disagreeing.on_ossd(False, True, DISCREPANCY + 1).state is too_long
        assert interlock(state, clear=True).on_reset().state is reset_clear
        assert interlock(state, clear=False).on_reset().state is reset_else
    assert set(REASONS) == set(SafetyState)


def test_channels_may_disagree_briefly_while_they_switch() -> None:
    switching = interlock(SafetyState.PERMITTED, clear=True).on_ossd(False, True, 0)
    assert switching.state is SafetyState.TRIPPED
    assert switching.on_ossd(False, True, DISCREPANCY).state is SafetyState.TRIPPED
    assert switching.on_ossd(False, False, DISCREPANCY + 1).state is SafetyState.TRIPPED


ossd = st.tuples(st.booleans(), st.booleans())
inputs = st.lists(st.tuples(st.one_of(ossd, st.none()), st.integers(0, 80 * MS)), max_size=40)


@given(inputs)
def test_no_sequence_permits_with_a_broken_beam_or_without_a_reset_since(sequence: list[tuple[object, int]]) -> None:
    now, state = 0, Interlock(DISCREPANCY)
    broken_since_reset = True  # a stop that no reset has answered
    last = (False, False)
    for given_input, wait in sequence:
        now += wait
        if given_input is None:
            state = state.on_reset()
            if last == (True, True) and state.permits:
                broken_since_reset = False
        else:
            assert isinstance(given_input, tuple)
            last = given_input
            state = state.on_ossd(*given_input, now)
            if last != (True, True):
                broken_since_reset = True
        if state.permits:
            assert last == (True, True)
            assert not broken_since_reset


@given(st.lists(ossd, max_size=20), st.integers(1, 5))
def test_a_fault_is_left_by_reset_alone(states: list[tuple[bool, bool]], step: int) -> None:
    state = interlock(SafetyState.FAULT, clear=False)
    for index, channels in enumerate(states):
        state = state.on_ossd(*channels, index * step * MS)
        assert state.state is SafetyState.FAULT


times = st.floats(0.01, 20.0)


@given(st.lists(st.builds(Interruption, times, times, times), max_size=4), st.integers(0, 60_000), st.integers(1, 200))
def test_a_scripted_curtain_keeps_its_word(interruptions: list[Interruption], at: int, horizon: int) -> None:
    script = Script(events_of(interruptions), horizon * MS)
    now = at * MS
    until = script.valid_until(now)
    assert now < until <= now + horizon * MS
    for later in (now, (now + until) // 2, until - 1):
        assert script.clear_at(later) == script.clear_at(now)
        assert script.resets(now, later) == []


def test_a_script_breaks_clears_and_resets() -> None:
    script = Script(events_of([Interruption(at=1.0, clear_after=2.0, reset_after=0.5)]), 100 * MS)
    assert [script.clear_at(t * MS) for t in (999, 1000, 2999, 3000)] == [True, False, False, True]
    assert script.valid_until(950 * MS) == 1000 * MS
    assert script.valid_until(3450 * MS) == 3500 * MS
    assert script.resets(3480 * MS, 3500 * MS) == [3500 * MS]
    assert script.resets(3500 * MS, 3600 * MS) == []
