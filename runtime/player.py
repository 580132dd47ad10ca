"""Plays a recorded log back onto the bus, with the timing it was recorded with, and does as it is told meanwhile."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property

from runtime.bus import Bus, Envelope, Publisher, Request
from runtime.clock import Metronome, Pacer, Stopwatch
from runtime.errors import BusError, InputError
from runtime.log.file import LogFile
from runtime.messages import Clock, PlayerState, stamp_of
from runtime.playback.playlist import Playlist
from runtime.playback.state import Playback
from runtime.topics import CLOCK, PLAYER_CONTROL

_LOOK = 0.02  # [s] between looks for listeners


@dataclass(frozen=True)
class Manner:
    """How a log is to be played."""

    rate: float | None = 1.0  # times the recorded speed; None: as fast as receivers take it
    loop: bool = False
    paused: bool = False  # at the beginning
    clock: float | None = None  # [Hz] of machine time at which /clock follows, in place of the recorded one
    delay: float = 0.0  # [s] before the first message


@dataclass(frozen=True)
class PlaySummary:
    """What was played. Topics by the names they were published under."""

    sent: Counter[str]  # messages
    heard: Counter[str]  # messages that somebody listened to
    skipped: dict[str, str] = field(default_factory=dict)  # topics that could not be played, and why
    until: int = 0  # [ns] session time of the last message


class Player:
    """Plays one log, once or in a loop, and answers /player/control.

    Messages keep their stamps and get new sequence numbers, which go on when session time jumps back. All publishers
    are declared at once, so that whoever has subscribed before the first message misses nothing; receivers that are
    slow hold the player up. Wherever it begins, or goes on after a jump, what latched topics last said comes first.
    Raises InputError for what cannot be played so.
    """

    def __init__(self, log: LogFile, bus: Bus, what: Playlist, manner: Manner | None = None) -> None:
        self._log, self._bus, self._what = log, bus, what
        self._manner = manner = manner or Manner()
        self.playback = Playback(
            log.start, log.end, what.start, what.until, manner.rate, paused=manner.paused, loop=manner.loop
        )
        self._names = {name: topic.name for name, topic in what.topics.items()}
        self._publishers: dict[str, Publisher[object]] = {
            name: bus.publisher(topic) for name, topic in what.topics.items()
        }
        self._clock = bus.publisher(CLOCK) if manner.clock else None
        self._beat = Metronome(1 / manner.clock) if manner.clock else None
        self._pace = Pacer(manner.rate)
        self._upcoming = what.start  # [ns] stamp of the next message
        self._owed: list[tuple[Request, str]] = []  # commands that are carried out and not answered, with what is wrong
        self._until = 0
        self._sent: Counter[str] = Counter()
        self._heard: Counter[str] = Counter()
        bus.serve(PLAYER_CONTROL)
        bus.announce()
        bus.settle()

    def run(self) -> None:
        """Play to the end, or until it is told to quit. Raises LogError for a log that is damaged."""
        self._hold()
        while not self.playback.quitting:
            self._pass()
        self._answer()

    @property
    def state(self) -> PlayerState:
        """How far it is. May be read from any thread."""
        playback = self.playback
        now = playback.position
        if not playback.paused:
            now = max(now, min(self._pace.now, self._upcoming))
        return playback.state(now if playback.target is None else playback.target)

    @property
    def summary(self) -> PlaySummary:
        """What was played so far."""
        return PlaySummary(self._sent, self._heard, self._what.skipped, self._until)

    @property
    def waiting_for(self) -> str:
        """The topics that it waits for somebody to listen to, for people to read; empty if it does not wait."""
        deaf = [name for name in self._what.awaited if not self._publishers[name].matched]
        if self._what.any_will_do:
            return "any topic" if deaf and len(deaf) == len(self._what.awaited) else ""
        return ", ".join(self._names[name] for name in deaf)

    def _hold(self) -> None:
        """Wait for listeners, then for the delay."""
        while self.waiting_for and not self.playback.quitting:
            self._attend(_LOOK)
        watch = Stopwatch()
        while (left := self._manner.delay - watch.seconds) > 0 and not self.playback.quitting:
            self._attend(left)

    def _pass(self) -> None:
        """Play from where it is to be to the end, or until it is to be elsewhere."""
        playback = self.playback
        begun = playback.jump()
        self._upcoming = begun
        for envelope in self._latched_before(begun):
            self._send(envelope)
        self._tell_time()
        self._pace.change(playback.rate, begun)
        empty = True
        for envelope in self._log.messages(self._publishers, begun, playback.until):
            self._upcoming = envelope.stamp
            if not self._released(envelope.stamp):
                return
            self._send(envelope)
            if playback.paused:
                self._tell_time()
            empty = False
        playback.steps = 0
        while playback.paused and not playback.diverted:  # one may still go back from here
            self._attend(None)
        if not playback.diverted:
            playback.finish(empty and begun == playback.start)

    def _released(self, stamp: int) -> bool:
        """Wait until the message of this stamp, which is next, may go out; False if it is not next any more."""
        playback = self.playback
        while True:
            if len(self._bus.inbox):
                self._attend(0.0)
            if playback.diverted:
                return False
            left = 0.0 if playback.paused else self._pace.left(stamp)
            released = playback.releases(stamp, self._pace.now if left else stamp)
            if self._beat is not None and not playback.paused:
                if self._beat.left <= 0:
                    self._beat.wait()
                    self._tell_time()
                left = min(left, max(self._beat.left, 0.0))
            if released:
                if self._owed and not playback.paused:
                    self._answer()
                return True
            self._attend(None if playback.paused else left)

    def _attend(self, timeout: float | None) -> None:
        """Take the next command, if one comes in time [s]; None: wait for it. Answers the one before, which is done."""
        self._answer()
        item = self._bus.inbox.receive(timeout)
        if not isinstance(item, Request):
            return
        playback, error, was_paused = self.playback, "", self.playback.paused
        if not was_paused:
            playback.position = max(playback.position, min(self._pace.now, self._upcoming))
        try:
            playback.obey(item.read(PLAYER_CONTROL))
        except (InputError, BusError) as wrong:
            error = str(wrong)
        else:
            self._pace.change(playback.rate, playback.position)
            if self._beat is not None and was_paused:
                self._beat.restart()
        self._owed.append((item, error))

    def _answer(self) -> None:
        for request, error in self._owed:
            request.reply(replace(self.state, ok=not error, error=error))
        self._owed.clear()

    def _send(self, envelope: Envelope) -> None:
        publisher, name = self._publishers[envelope.topic], self._names[envelope.topic]
        if publisher.matched:
            self._heard[name] += 1
        publisher.send_raw(envelope.payload, envelope.stamp)
        self._sent[name] += 1
        self.playback.sent += 1
        self._until = envelope.stamp

    def _tell_time(self) -> None:
        """Say on /clock which session time is reached."""
        if self._clock is None:
            return
        now = self.playback.position
        if self._clock.matched:
            self._heard[CLOCK.name] += 1
        self._clock.send(Clock(clock=stamp_of(now)), now)
        self._sent[CLOCK.name] += 1

    @cached_property
    def _history(self) -> list[Envelope]:
        """Everything that latched topics say in the log, earliest first."""
        latched = [name for name, topic in self._what.topics.items() if topic.latched]
        return list(self._log.messages(latched)) if latched else []

    def _latched_before(self, stamp: int) -> Iterator[Envelope]:
        """The last message before `stamp` [ns] of each latched topic, earliest first."""
        if stamp <= self._log.start:
            return iter(())
        last = {envelope.topic: envelope for envelope in self._history if envelope.stamp < stamp}
        return iter(sorted(last.values(), key=lambda envelope: envelope.stamp))
