"""Somebody on a cell's bus whom nobody invited: says what makes no sense, or what another has the right to say."""

from __future__ import annotations

import dataclasses
import math
import random
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from runtime.benchmark.small_cell import SmallCell
from runtime.bus import decode, encode
from runtime.clock import Stopwatch, pause
from runtime.closing import Closing
from runtime.errors import BusError
from runtime.messages import (
    NANOSECONDS,
    EmergencyStop,
    Muting,
    Outcome,
    header,
    stamp_of,
)
from runtime.network.zenoh_bus import ZenohBus
from runtime.topics import (
    ATTEMPT,
    CANDIDATE,
    CLOCK,
    EMERGENCY_STOP,
    MUTING,
    OSSD,
    PERMIT,
    RESET,
    SEARCH_GOAL,
    SEARCH_RESULT,
    SESSION,
    Topic,
)

# What the plugins of a cell listen to; recorder and viewer hear everything.
INPUTS: tuple[Topic[Any], ...] = (
    *(CLOCK, OSSD, RESET, EMERGENCY_STOP, MUTING, PERMIT, SESSION),
    *(SEARCH_GOAL, CANDIDATE, ATTEMPT, SEARCH_RESULT),
)
LASTS = 2.0  # [s] of machine time that a stranger talks
PAUSE = 0.1  # [s] between two rounds
AHEAD = 3600 * NANOSECONDS  # [ns] of a clock that jumps
_HELD = 200_000_000  # [ns] for which a forged permit would hold
_LARGE, _LARGE_BYTE = 2**31 - 1, 255
_UNHEARD: dict[str, Any] = {
    EMERGENCY_STOP.name: EmergencyStop(header(0), "a stranger's", pressed=False),
    MUTING.name: Muting(header(0), sensor_1=False, sensor_2=False),
}

Round = Callable[["Stranger", random.Random], None]


class Stranger(Closing):
    """A client of a cell's router."""

    def __init__(self, cell: SmallCell) -> None:
        self.ear = cell.ear
        self._strangers = cell.strangers
        self._bus = ZenohBus("stranger", cell.port)

    def say(self, topic: Topic[Any], payload: bytes, stamp: int | None = None) -> None:
        """Publish bytes on a topic, by default with the present session time [ns]."""
        publisher = self._bus.publisher(topic)
        self._strangers.add(publisher.identity)
        publisher.send_raw(payload, self.ear.now if stamp is None else stamp)

    def known(self, topic: Topic[Any]) -> Any:
        """A message of a topic: the last one that was heard and can be read; None if there is none."""
        for heard in reversed(self.ear.heard(topic)):
            try:
                return decode(heard.item.payload, topic.type)
            except BusError:  # a stranger's own
                continue
        return _UNHEARD.get(topic.name)

    def close(self) -> None:
        """Leave the bus."""
        self._bus.close()


def talk(cell: SmallCell, dice: random.Random, say: Round, seconds: float = LASTS) -> None:
    """Let a stranger speak for a while, or until the cell has ended."""
    with Stranger(cell) as stranger:
        watch = Stopwatch()
        while cell.running and watch.seconds < seconds:
            say(stranger, dice)
            pause(PAUSE)


def malformed(stranger: Stranger, dice: random.Random) -> None:
    """Bytes at random and cut messages on every input, and on a key that no topic has."""
    for topic in INPUTS:
        message = stranger.known(topic)
        whole = bytes(40) if message is None else encode(message)
        stranger.say(topic, dice.randbytes(dice.randrange(200)))
        stranger.say(topic, whole[: dice.randrange(len(whole))])


def not_numbers(stranger: Stranger, _dice: random.Random) -> None:
    """The last message of every input that has numbers, with none of them a number."""
    for topic, message in _known(stranger):
        spoilt = _spoilt(message, number=math.nan, integer=None)
        if encode(spoilt) != encode(message):
            stranger.say(topic, encode(spoilt))


def out_of_range(stranger: Stranger, dice: random.Random) -> None:
    """The last message of every input, with numbers beyond all that a cell can have."""
    for topic, message in _known(stranger):
        sign = dice.choice((-1, 1))
        stranger.say(topic, encode(_spoilt(message, number=sign * 1e12, integer=_LARGE)))


def out_of_order(stranger: Stranger, dice: random.Random) -> None:
    """What has been heard on every input, the latest first, with its old stamps."""
    for topic in INPUTS:
        heard = stranger.ear.heard(topic)
        for one in reversed(dice.sample(heard, min(3, len(heard)))):
            stranger.say(topic, one.item.payload, one.item.stamp)


def clock_ahead(stranger: Stranger, _dice: random.Random) -> None:
    """Session time an hour from now."""
    then = stranger.ear.now + AHEAD
    stranger.say(CLOCK, encode(dataclasses.replace(stranger.known(CLOCK), clock=stamp_of(then))), then)


def clock_back(stranger: Stranger, _dice: random.Random) -> None:
    """Session time at its beginning."""
    stranger.say(CLOCK, encode(dataclasses.replace(stranger.known(CLOCK), clock=stamp_of(0))), 0)


def second_interlock(stranger: Stranger, _dice: random.Random) -> None:
    """Permits that follow the last one, as whoever hears it could make them."""
    permit, now = stranger.known(PERMIT), stranger.ear.now
    for number in range(1, 20):
        since = now + number * _HELD // 4
        word = dataclasses.replace(
            permit, header=header(since), valid_until=stamp_of(since + _HELD), ossd=permit.ossd + number
        )
        stranger.say(PERMIT, encode(word), since)


def second_arm(stranger: Stranger, _dice: random.Random) -> None:
    """An attempt that nobody made: the last candidate is said to be blocked."""
    candidate, attempt = stranger.known(CANDIDATE), stranger.known(ATTEMPT)
    if candidate is None or attempt is None:
        return
    made = dataclasses.replace(
        attempt,
        search=candidate.search,
        number=candidate.number,
        x=candidate.proposal.x,
        y=candidate.proposal.y,
        outcome=Outcome.BLOCKED,
        path=[],
    )
    stranger.say(ATTEMPT, encode(made))


def second_strategy(stranger: Stranger, dice: random.Random) -> None:
    """Candidates for the search that is under way, somewhere else."""
    candidate = stranger.known(CANDIDATE)
    if candidate is None or candidate.exhausted:
        return
    proposal = dataclasses.replace(candidate.proposal, x=dice.uniform(-1e-3, 1e-3), y=dice.uniform(-1e-3, 1e-3))
    stranger.say(CANDIDATE, encode(dataclasses.replace(candidate, number=candidate.number + 1, proposal=proposal)))


def _known(stranger: Stranger) -> Iterator[tuple[Topic[Any], Any]]:
    for topic in INPUTS:
        message = stranger.known(topic)
        if message is not None:
            yield topic, message


def _spoilt(message: Any, number: float, integer: int | None) -> Any:
    """A message with every number replaced: floats by `number`, integers by one as large as their field can hold."""
    changes: dict[str, Any] = {}
    for field in dataclasses.fields(message):
        value = getattr(message, field.name)
        if isinstance(value, bool | str):
            continue
        if isinstance(value, float):
            changes[field.name] = number
        elif isinstance(value, int):
            if integer is not None:
                changes[field.name] = _LARGE_BYTE if "UInt8" in str(field.type) else integer
        elif isinstance(value, np.ndarray):
            changes[field.name] = np.full_like(value, number)
        elif isinstance(value, list):
            changes[field.name] = [
                _spoilt(item, number, integer) if dataclasses.is_dataclass(item) else item for item in value
            ]
        elif dataclasses.is_dataclass(value):
            changes[field.name] = _spoilt(value, number, integer)
    return dataclasses.replace(message, **changes)
