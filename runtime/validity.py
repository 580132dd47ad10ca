"""What makes no sense in a message that could be decoded: pure checks, one for each type that something follows from.

    Clock                 a time of a session
    Ossd, Permit          times of a session, the word good for an hour at most, known states; granted as its state says
    Reset, EmergencyStop, Muting    a time of a session, a known edge, a name of sane length
    SearchGoal            a pose within reach, positive radii, a known component, finite evidence
    Candidate             finite and within reach, unless it is exhausted
    Attempt, SearchResult a known outcome; finite places where a part went in
    SessionState          a known phase, of this session
    BeliefRequest         a name of sane length
    InterventionAnswer    a name of sane length
    PublisherCounts       counts that a session can reach

What arrives out of order is no matter of one message: see `runtime.network.admission`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from enum import IntEnum
from typing import Any

from runtime.component import COMPONENTS
from runtime.messages import (
    NANOSECONDS,
    Attempt,
    BeliefRequest,
    Candidate,
    Clock,
    EmergencyStop,
    Ending,
    InterventionAnswer,
    Muting,
    Ossd,
    Outcome,
    Permit,
    Phase,
    PublisherCounts,
    Reset,
    ResetEdge,
    SafetyState,
    SearchGoal,
    SearchResult,
    SessionState,
    Time,
    nanoseconds_of,
)

LONGEST_SESSION = 315_360_000  # [s] ten years
LONGEST_WORD = 3600 * NANOSECONDS  # [ns] that curtain and interlock speak for ahead
REACH = 3.0  # [m] from base_link, beyond that of every arm that a cell can have
OFFSET = 0.1  # [m] from a nominal hole, beyond every search radius
NARROWEST = 1e-6  # [m] of a feasible area: below it a search would have no end
MOST_ATTEMPTS = 10_000  # in a search
MOST_WAYPOINTS = 10_000  # of a slide
LONGEST_NAME = 200  # characters
MOST_MESSAGES = 2**40  # of one publisher
_GRANTING = (SafetyState.PERMITTED, SafetyState.MUTED)


def fault(message: Any, session: str = "") -> str:
    """What makes no sense in a message, in words; empty if nothing is found.

    With `session`, what is said about another session makes none either.
    """
    if session and isinstance(message, SessionState) and message.session != session:
        return f"it is about session {message.session[:LONGEST_NAME]!r}"
    check = _CHECKS.get(type(message))
    return "" if check is None else next(check(message), "")


def _time(stamp: Time, name: str = "stamp") -> Iterator[str]:
    if not (0 <= stamp.sec <= LONGEST_SESSION and 0 <= stamp.nanosec < NANOSECONDS):
        yield f"{name} {stamp.sec} s {stamp.nanosec} ns is no time of a session"


def _known(value: int, kind: type[IntEnum], name: str) -> Iterator[str]:
    known = [int(member) for member in kind]
    if value not in known:
        yield f"{name} {value} is none of {', '.join(map(str, known))}"


def _numbered(value: int, name: str) -> Iterator[str]:
    if value < 1:
        yield f"{name} {value} is below 1"


def _named(text: str, name: str) -> Iterator[str]:
    if len(text) > LONGEST_NAME:
        yield f"{name} has {len(text)} characters"


def _within(values: Iterable[float], limit: float, name: str) -> Iterator[str]:
    for value in values:
        if not abs(value) <= limit:  # so that what is not a number fails
            yield f"{name} {value:g} m is not within {limit:g} m"


def _word(stamp: Time, until: Time) -> Iterator[str]:
    yield from _time(stamp)
    yield from _time(until, "valid_until")
    if nanoseconds_of(until) - nanoseconds_of(stamp) > LONGEST_WORD:
        yield f"it would hold until {until.sec} s, more than {LONGEST_WORD // NANOSECONDS} s ahead"


def _clock(clock: Clock) -> Iterator[str]:
    yield from _time(clock.clock, "clock")


def _ossd(ossd: Ossd) -> Iterator[str]:
    yield from _word(ossd.header.stamp, ossd.valid_until)
    for number, tested in ((1, ossd.channel_1_tested), (2, ossd.channel_2_tested)):
        yield from _time(tested, f"channel_{number}_tested")
        if nanoseconds_of(tested) > nanoseconds_of(ossd.header.stamp):
            yield f"channel_{number}_tested {tested.sec} s is yet to come"


def _permit(permit: Permit) -> Iterator[str]:
    yield from _word(permit.header.stamp, permit.valid_until)
    yield from _known(permit.state, SafetyState, "state")
    if permit.granted != (permit.state in _GRANTING):
        yield f"granted is {permit.granted} in state {SafetyState(permit.state).name}"
    if permit.stop_category > 2:
        yield f"stop category {permit.stop_category} is none of 0, 1, 2"


def _reset(reset: Reset) -> Iterator[str]:
    yield from _time(reset.header.stamp)
    yield from _known(reset.edge, ResetEdge, "edge")
    yield from _named(reset.source, "source")


def _emergency_stop(stop: EmergencyStop) -> Iterator[str]:
    yield from _time(stop.header.stamp)
    yield from _named(stop.device, "device")


def _muting(muting: Muting) -> Iterator[str]:
    yield from _time(muting.header.stamp)


def _goal(goal: SearchGoal) -> Iterator[str]:
    yield from _time(goal.header.stamp)
    yield from _numbered(goal.search, "search")
    yield from _numbered(goal.board, "board")
    yield from _named(goal.hole, "hole")
    if goal.component not in COMPONENTS:
        yield f"component {goal.component[:LONGEST_NAME]!r} is not known"
    position, turn = goal.nominal.position, goal.nominal.orientation
    yield from _within((position.x, position.y, position.z), REACH, "nominal position")
    if not math.isclose(turn.x**2 + turn.y**2 + turn.z**2 + turn.w**2, 1.0, abs_tol=1e-3):
        yield "nominal orientation is no unit quaternion"
    for radius, name in ((goal.feasible_radius, "feasible_radius"), (goal.search_radius, "search_radius")):
        if not NARROWEST <= radius <= OFFSET:
            yield f"{name} {radius:g} m is not from {NARROWEST:g} to {OFFSET:g} m"
    if not 1 <= goal.max_attempts <= MOST_ATTEMPTS:
        yield f"max_attempts {goal.max_attempts} is not from 1 to {MOST_ATTEMPTS}"
    yield from _within((goal.prior.x, goal.prior.y), OFFSET, "prior")
    if any(math.isinf(value) for value in (goal.prior.xx, goal.prior.xy, goal.prior.yy)):
        yield "prior has an infinite covariance"
    for seat in goal.seats:
        yield from _within((seat.x, seat.y, seat.seated_x, seat.seated_y), OFFSET, "seat")
    for miss in goal.misses:
        yield from _within((value for point in miss.path for value in (point.x, point.y)), OFFSET, "miss")
    yield from _within((value for place in goal.layout for value in (place.x, place.y)), REACH, "place")


def _candidate(candidate: Candidate) -> Iterator[str]:
    yield from _time(candidate.header.stamp)
    yield from _numbered(candidate.search, "search")
    yield from _numbered(candidate.number, "number")
    if candidate.exhausted:
        return
    proposal = candidate.proposal
    if len(proposal.path) > MOST_WAYPOINTS:
        yield f"its path has {len(proposal.path)} points"
    yield from _within((proposal.x, proposal.y), OFFSET, "proposal")
    yield from _within((value for point in proposal.path for value in (point.x, point.y)), OFFSET, "path")


def _attempt(attempt: Attempt) -> Iterator[str]:
    yield from _time(attempt.header.stamp)
    yield from _numbered(attempt.search, "search")
    yield from _numbered(attempt.number, "number")
    yield from _named(attempt.hole, "hole")
    yield from _known(attempt.outcome, Outcome, "outcome")
    if attempt.outcome != Outcome.ABORTED:
        position = attempt.pose.position
        yield from _within((attempt.x, attempt.y), OFFSET, "attempt")
        yield from _within((position.x, position.y, position.z), REACH, "pose")
        yield from _within((value for point in attempt.path for value in (point.x, point.y)), OFFSET, "path")


def _result(result: SearchResult) -> Iterator[str]:
    yield from _time(result.header.stamp)
    yield from _numbered(result.search, "search")
    yield from _named(result.hole, "hole")
    yield from _known(result.ending, Ending, "ending")
    if result.attempts > MOST_ATTEMPTS:
        yield f"{result.attempts} attempts are more than {MOST_ATTEMPTS}"
    if result.ending == Ending.INSERTED:
        yield from _within((result.x, result.y, result.seated_x, result.seated_y), OFFSET, "place")


def _state(state: SessionState) -> Iterator[str]:
    yield from _time(state.header.stamp)
    yield from _known(state.phase, Phase, "phase")


def _question(question: BeliefRequest) -> Iterator[str]:
    yield from _named(question.hole, "hole")


def _answer(answer: InterventionAnswer) -> Iterator[str]:
    yield from _named(answer.who, "who")  # a choice that is none is refused in words, by the assembly


def _counts(counts: PublisherCounts) -> Iterator[str]:
    yield from _named(counts.plugin, "plugin")
    for count in counts.counts:
        yield from _named(count.topic, "topic")
        if count.sent > MOST_MESSAGES:
            yield f"{count.sent} messages of {count.topic} are more than a session has"


_CHECKS: dict[type[Any], Callable[[Any], Iterator[str]]] = {
    Clock: _clock,
    Ossd: _ossd,
    Permit: _permit,
    Reset: _reset,
    EmergencyStop: _emergency_stop,
    Muting: _muting,
    SearchGoal: _goal,
    Candidate: _candidate,
    Attempt: _attempt,
    SearchResult: _result,
    SessionState: _state,
    BeliefRequest: _question,
    InterventionAnswer: _answer,
    PublisherCounts: _counts,
}
