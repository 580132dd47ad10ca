"""What is let in of all that arrives for a plugin: what can be decoded, makes sense, and comes in order.

The rest is counted by topic, told at a limited rate, and dropped. A message is decoded here once and for all.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any

from runtime.bus import Envelope, Request
from runtime.clock import SessionClock, Stopwatch
from runtime.errors import BusError
from runtime.messages import Clock, Permit, nanoseconds_of
from runtime.topics import ANYBODY, known_service, known_topic
from runtime.validity import fault

INTERVAL = 10.0  # [s] of machine time between two lines about what was dropped
AHEAD = 30 * 86_400 * 1_000_000_000  # [ns] of session time that a message may be ahead of the one before
_TOLD = 160  # characters of a reason
_TOPICS = 100  # that are counted apart; a stranger can make up any number


class Admission:
    """One plugin's doorkeeper; a bus asks it when an item is taken from the inbox."""

    def __init__(
        self,
        say: Callable[[str], None],
        clock: SessionClock | None = None,
        session: str = "",  # what is about another one is dropped
        *,
        judged: frozenset[str] = frozenset(),  # topics that the plugin judges by itself, once they are decoded
        everything: bool = False,  # let all in as it is, as a recorder does, and only count and tell what is refused
    ) -> None:
        self.dropped: Counter[str] = Counter()  # messages and requests, by topic or service
        self._say = say
        self._clock = clock or SessionClock()
        self._session = session
        self._judged = judged
        self._everything = everything
        self._begun = False  # before the first sound message of a session the others may not listen yet
        self._untold: Counter[str] = Counter()
        self._reason = ""  # of the last one
        self._told: Stopwatch | None = None
        self._sequences: dict[tuple[str, bytes], int] = {}
        self._moments: dict[tuple[str, bytes], int] = {}  # [ns] that clock and permit last spoke of
        self._publishers: dict[
            str, bytes
        ] = {}  # of topics that have one publisher in the map: the first that made sense

    def __call__(self, item: Envelope | Request) -> bool:
        """Whether an item is let in."""
        if not self._everything:
            reason = self._fault_of_envelope(item) if isinstance(item, Envelope) else self._fault_of_request(item)
            if reason:
                self.refuse(item.topic if isinstance(item, Envelope) else item.service, reason)
                return False
        self._begun = True
        if self._untold:
            self._tell()
        return True

    def refuse(self, name: str, reason: str) -> None:
        """Count something that came under a topic or a service and is dropped."""
        if name not in self.dropped and len(self.dropped) >= _TOPICS:
            name = "others"
        self.dropped[name] += 1
        self._untold[name] += 1
        self._reason = f"{name}: {reason}"
        self._tell()

    def close(self) -> None:
        """Tell what was not told yet."""
        self._told = None
        self._tell()

    def _tell(self) -> None:
        if not (self._begun and self._untold) or (self._told is not None and self._told.seconds < INTERVAL):
            return
        counts = ", ".join(f"{name} {count}" for name, count in sorted(self._untold.items()))
        reason = " ".join(self._reason.split())[:_TOLD]
        self._untold.clear()
        self._told = Stopwatch()
        what = "could make nothing of" if self._everything else "dropped what makes no sense:"
        self._say(f"{what} {counts}; the last, {reason}")

    def _fault_of_envelope(self, item: Envelope) -> str:
        if item.stamp - self._clock.now > AHEAD:
            return f"its stamp {item.stamp} ns is far ahead of session time"
        topic = known_topic(item.topic)
        if topic is None:  # a stranger's: whoever subscribed to it knows what to do with it
            return ""
        try:
            message = item.decoded(topic)
        except BusError as error:
            return str(error)
        if item.topic in self._judged:
            return ""
        reason = fault(message, self._session) or self._disorder(item, message)
        if reason or topic.publisher == ANYBODY:
            return reason
        first = self._publishers.setdefault(item.topic, item.publisher)
        return "" if first == item.publisher else "it comes from a second publisher; the first is heard"

    def _fault_of_request(self, item: Request) -> str:
        service = known_service(item.service)
        if service is None:
            return ""
        try:
            return fault(item.read(service))
        except BusError as error:
            return str(error)

    def _disorder(self, item: Envelope, message: Any) -> str:
        """What is wrong with the order in which one publisher's messages come."""
        key = (item.topic, item.publisher)
        last = self._sequences.get(key, 0)
        if item.sequence <= last:
            return f"number {item.sequence} came after number {last} of the same publisher"
        if isinstance(message, (Permit, Clock)):
            now = nanoseconds_of(message.header.stamp if isinstance(message, Permit) else message.clock)
            before = self._moments.get(key, 0)
            if now < before:
                return f"its time goes back from {before} to {now} ns"
            self._moments[key] = now
        self._sequences[key] = item.sequence
        return ""
