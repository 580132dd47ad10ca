"""What counts as a failure of a cell, so that a recording that is kept in memory gets written down.

    a session that ends in Phase.FAILED, as when a plugin dies    the launcher's or anybody's ERROR line on /rosout
    an attempt that was aborted, whatever the reason              a fault of the interlock: its channels disagree
    a protective or emergency stop, violation or fault of the arm

An interrupted light field is none: the arm stands still and goes on. Nor is a hole that was given up.
"""

from __future__ import annotations

import logging
from collections.abc import Callable

from runtime.bus import Envelope
from runtime.messages import Outcome, Phase, SafetyState
from runtime.topics import ARM_STATUS, ATTEMPT, PERMIT, ROSOUT, SESSION

_UNDISTURBED = frozenset({1, 2, 5})  # UR safety modes: normal, reduced, safeguard stop


def _session(item: Envelope) -> str:
    state = item.read(SESSION)
    return f"the session failed: {state.text}" if state.phase == Phase.FAILED else ""


def _line(item: Envelope) -> str:
    line = item.read(ROSOUT)
    return f"{line.name}: {line.msg}" if line.level >= logging.ERROR else ""


def _attempt(item: Envelope) -> str:
    attempt = item.read(ATTEMPT)
    if attempt.outcome != Outcome.ABORTED:
        return ""
    return f"attempt {attempt.number} at board {attempt.board} hole {attempt.hole} was aborted: {attempt.reason}"


def _arm(item: Envelope) -> str:
    status = item.read(ARM_STATUS)
    undisturbed = status.safety_mode in _UNDISTURBED
    return "" if undisturbed else f"the arm stopped in safety mode {status.safety_mode}: {status.activity}"


def _permit(item: Envelope) -> str:
    permit = item.read(PERMIT)
    return f"the interlock is in fault: {permit.reason}" if permit.state == SafetyState.FAULT else ""


_SIGNS: dict[str, Callable[[Envelope], str]] = {
    SESSION.name: _session,
    ROSOUT.name: _line,
    ATTEMPT.name: _attempt,
    ARM_STATUS.name: _arm,
    PERMIT.name: _permit,
}


def failure_in(item: Envelope) -> str:
    """What failed, in words; empty if the message tells of no failure. Raises BusError for a malformed message."""
    sign = _SIGNS.get(item.topic)
    return sign(item) if sign is not None else ""
