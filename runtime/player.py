"""Plays a recorded log back onto the bus, with the timing it was recorded with."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase

from runtime.bus import Bus, Envelope, Publisher
from runtime.clock import Pacer
from runtime.errors import InputError, LogError, alternatives
from runtime.log_file import LogFile


@dataclass(frozen=True)
class PlaySummary:
    """What was played."""

    sent: Counter[str] = field(default_factory=Counter)  # messages by topic
    skipped: dict[str, str] = field(default_factory=dict)  # topics that could not be played, and why
    until: int = 0  # [ns] session time of the last message
    stopped: bool = False  # whether it was asked to end early


def chosen(log: LogFile, include: Sequence[str]) -> list[str]:
    """Topics of the log that match one of the patterns (`/search/*`), all if there are none.

    Raises InputError for a pattern that matches no topic of the log.
    """
    names = sorted({topic.name for topic in log.topics})
    for pattern in include:
        if not any(fnmatchcase(name, pattern) for name in names):
            raise InputError(f"no topic of {log.path.name} matches {pattern!r}; {alternatives(pattern, names)}")
    return [name for name in names if not include or any(fnmatchcase(name, pattern) for pattern in include)]


def play(
    log: LogFile,
    bus: Bus,
    rate: float | None = 1.0,
    include: Sequence[str] = (),
    start: int | None = None,
    end: int | None = None,
    stop: threading.Event | None = None,
) -> PlaySummary:
    """Publish the messages with start <= stamp < end [ns] at `rate` times real time.

    Without a rate they go out as fast as receivers take them. Messages keep their stamps and get new sequence numbers.
    All publishers are declared before the first message, so that whoever has subscribed by then misses nothing. What a
    latched topic last said before `start` comes first. `stop` ends it at once. Raises InputError for a pattern without
    a match, LogError for a damaged log.
    """
    halt = stop or threading.Event()
    summary = _Progress(log, halt)
    names = chosen(log, include)
    publishers = {name: publisher for name in names if (publisher := summary.declare(name, bus)) is not None}
    bus.announce()
    for envelope in _latched_before(log, publishers, start):
        summary.send(publishers, envelope)
    pace = Pacer(rate, halt)
    for envelope in log.messages(publishers, start, end):
        if not pace.wait_until(envelope.stamp):
            break
        summary.send(publishers, envelope)
    return PlaySummary(summary.sent, summary.skipped, summary.until, halt.is_set())


def _latched_before(log: LogFile, publishers: dict[str, Publisher[object]], start: int | None) -> list[Envelope]:
    """The last message before `start` of each topic that keeps one for late subscribers."""
    latched = [name for name in publishers if log.handle(name).latched]
    if start is None or not latched:
        return []
    last = {envelope.topic: envelope for envelope in log.messages(latched, None, start)}
    return sorted(last.values(), key=lambda envelope: envelope.stamp)


@dataclass
class _Progress:
    """What has been played so far."""

    log: LogFile
    halt: threading.Event
    sent: Counter[str] = field(default_factory=Counter)
    skipped: dict[str, str] = field(default_factory=dict)
    until: int = 0

    def declare(self, name: str, bus: Bus) -> Publisher[object] | None:
        try:
            publisher: Publisher[object] = bus.publisher(self.log.handle(name))
        except LogError as error:
            self.skipped[name] = str(error)
            return None
        return publisher

    def send(self, publishers: dict[str, Publisher[object]], envelope: Envelope) -> None:
        publishers[envelope.topic].send_raw(envelope.payload, envelope.stamp)
        self.sent[envelope.topic] += 1
        self.until = envelope.stamp
