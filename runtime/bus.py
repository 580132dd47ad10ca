"""Publish, subscribe, request: the seam between plugins and transport.

A plugin works in one thread. Whatever it subscribes to or serves arrives in one `Inbox`, in order of arrival, as
`Envelope` or `Request`. What one plugin sends arrives in the order in which it was sent, latched topics apart; between
plugins no order is promised, so whoever combines two of them waits until both have spoken. Every envelope carries its
publisher and a sequence number from 1, so that an inbox can count what never arrived.
"""

from __future__ import annotations

import queue
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Generic, Protocol, Self, TypeVar

from runtime.clock import Stopwatch, pause
from runtime.declaration import type_name
from runtime.errors import BusError
from runtime.messages import PublisherCount, typestore
from runtime.topics import ReplyT, RequestT, Service, Topic

MessageT = TypeVar("MessageT")
MessageT_contra = TypeVar("MessageT_contra", contravariant=True)


def encode(message: Any) -> bytes:
    """CDR of a message (little endian, with encapsulation header)."""
    return bytes(typestore().serialize_cdr(message, type_name(type(message))))


def decode(payload: bytes, cls: type[MessageT]) -> MessageT:
    """Message from CDR. Raises BusError if the bytes are no such message."""
    try:
        message = typestore().deserialize_cdr(payload, type_name(cls))
    except Exception as error:  # rosbags raises several types on malformed bytes
        raise BusError(f"{len(payload)} bytes are no {type_name(cls)}: {error}") from None
    assert isinstance(message, cls)
    return message


@dataclass(frozen=True, slots=True)
class Envelope:
    """One message as it travelled."""

    topic: str
    type: str  # ROS type name
    payload: bytes  # CDR
    stamp: int  # session time of sending [ns]
    sequence: int  # of its publisher on its topic, from 1
    publisher: bytes  # (16,) identity of the publisher
    _message: Any = field(default=None, init=False, repr=False, compare=False)  # once it is decoded

    def read(self, topic: Topic[MessageT]) -> MessageT:
        """The message, if it belongs to `topic`."""
        if topic.name != self.topic:
            raise BusError(f"a message of {self.topic} was read as one of {topic.name}")
        if isinstance(self._message, topic.type):
            return self._message
        return decode(self.payload, topic.type)

    def decoded(self, topic: Topic[MessageT]) -> MessageT:
        """Like `read`, and whoever reads this envelope again gets the same message."""
        message = self.read(topic)
        object.__setattr__(self, "_message", message)
        return message


@dataclass(frozen=True, slots=True)
class Request:
    """A question that waits for its answer."""

    service: str
    payload: bytes
    answer: Callable[[bytes], None]

    def read(self, service: Service[RequestT, Any]) -> RequestT:
        """The question, if it was put to `service`."""
        if service.name != self.service:
            raise BusError(f"a request to {self.service} was read as one to {service.name}")
        return decode(self.payload, service.request)

    def reply(self, message: Any) -> None:
        """Answer."""
        self.answer(encode(message))


BACKLOG = 100_000  # messages that may wait for one who hears everything, before their senders are held up
_LOOK = 0.02  # [s] between looks for messages that are kept elsewhere
_PUBLISHERS = 10_000  # of one topic each, that are told apart
_GATHERED = 4_000  # items that are gathered at most, so that a flood is worked off while it lasts


@dataclass(eq=False)
class Inbox:
    """What arrives for one plugin, in order of arrival."""

    lost: Counter[str] = field(default_factory=Counter)  # messages that never arrived, by topic
    before: Counter[str] = field(default_factory=Counter)  # those of them that came before a publisher's first
    received: Counter[tuple[str, bytes]] = field(default_factory=Counter)  # by topic and publisher
    malformed: int = 0  # messages that a bus could not read: their key, their attachment, or too many publishers
    _queue: queue.SimpleQueue[Any] = field(default_factory=queue.SimpleQueue)
    _last: dict[tuple[str, bytes], int] = field(default_factory=dict)
    _fetch: Callable[[], None] | None = None
    _read: Callable[[Any], Envelope | None] | None = None
    _admits: Callable[[Envelope | Request], bool] | None = None
    _refuse: Callable[[str, str], None] | None = None
    _flooded: bool = False  # more was waiting than was gathered last time

    def fetch_by(self, fetch: Callable[[], None]) -> None:
        """Let `fetch` put what waits elsewhere whenever this inbox is looked into.

        For a flood of messages: a transport that keeps them until then need not disturb this process for each.
        """
        self._fetch = fetch

    def read_by(self, read: Callable[[Any], Envelope | None]) -> Callable[[Any], None]:
        """A callback for a transport whose samples `read` turns into envelopes, or None, when they are taken.

        It runs no Python: a transport's thread that still holds the interpreter when the plugin's own wakes up costs
        more than all the rest of a message's way.
        """
        self._read = read
        return self._queue.put

    def admit_by(self, admits: Callable[[Envelope | Request], bool], refuse: Callable[[str, str], None]) -> None:
        """Let `admits` say what may be taken from here; `refuse` hears under which name a bus drops something, and why.

        Both are called in the thread that takes.
        """
        self._admits, self._refuse = admits, refuse

    def refuse(self, name: str, reason: str) -> None:
        """Count what a bus could not read."""
        self.malformed += 1
        if self._refuse is not None:
            self._refuse(name, reason)

    def put(self, item: Envelope | Request) -> None:
        """Called by a bus, from any thread: only counts and enqueues, since a slow callback stalls the transport."""
        if not isinstance(item, Envelope) or self._count(item):
            self._queue.put(item)

    def _count(self, envelope: Envelope) -> bool:
        """Take note of a message; False if there are more publishers than a cell can have, to keep memory bounded."""
        key = (envelope.topic, envelope.publisher)
        sequence, last = envelope.sequence, self._last
        if key not in last and len(last) >= _PUBLISHERS:
            self.malformed += 1
            return False
        missing = sequence - last.get(key, 0) - 1
        if missing > 0:
            self.lost[envelope.topic] += missing
            if key not in last:
                self.before[envelope.topic] += missing
        last[key] = sequence
        self.received[key] += 1
        return True

    def _taken(self, item: Any) -> Envelope | Request | None:
        """What was in the queue, read if the transport left that to do; None for a `wake` and what is not let in."""
        if item is None:
            return None
        if not isinstance(item, (Envelope, Request)):
            assert self._read is not None, "only what it is to read comes unread"
            envelope = self._read(item)
            if envelope is None or not self._count(envelope):
                return None
            item = envelope
        return item if self._admits is None or self._admits(item) else None

    def wake(self) -> None:
        """Make a waiting `receive` return None."""
        self._queue.put(None)

    def receive(self, timeout: float | None = None) -> Envelope | Request | None:
        """The next item; None after `timeout` seconds of waiting or after a `wake`."""
        watch = Stopwatch()
        while True:
            wait = timeout
            if self._fetch is not None:
                self._fetch()
                wait = _LOOK if timeout is None else min(_LOOK, max(0.0, timeout - watch.seconds))
            try:
                item = self._queue.get(timeout=wait)
            except queue.Empty:
                if timeout is not None and watch.seconds >= timeout:
                    return None
                continue
            taken = self._taken(item)
            if taken is not None or item is None or (timeout is not None and watch.seconds >= timeout):
                return taken

    def poll(self) -> Envelope | Request | None:
        """The next item if one is there."""
        if self._fetch is not None and self._queue.empty():
            self._fetch()
        try:
            while (item := self._queue.get_nowait()) is not None:
                if (taken := self._taken(item)) is not None:
                    return taken
        except queue.Empty:
            pass
        return None

    def gather(self, timeout: float, linger: float) -> list[Envelope | Request]:
        """What has come `linger` seconds after the first item; nothing after `timeout` seconds or a `wake`.

        For those who are in no hurry: to be woken once for many messages costs far less than once for each.
        """
        first = self.receive(timeout)
        if first is None:
            return []
        if not self._flooded:
            pause(linger)
        items = [first]
        while len(items) < _GATHERED and (item := self.poll()) is not None:
            items.append(item)
        self._flooded = len(items) == _GATHERED
        return items

    def __len__(self) -> int:
        if self._fetch is not None:
            self._fetch()
        return self._queue.qsize()


class Publisher(Protocol, Generic[MessageT_contra]):
    """Sends messages on one topic."""

    def send(self, message: MessageT_contra, stamp: int) -> None:
        """Publish at session time `stamp` [ns]. Waits rather than drops when receivers are slow."""
        ...

    def send_raw(self, payload: bytes, stamp: int) -> None:
        """Publish a message that is CDR already, as a recording holds it."""
        ...

    @property
    def matched(self) -> bool:
        """Whether anybody is known to listen."""
        ...


class Bus(Protocol):
    """What every transport offers. One instance belongs to one plugin."""

    def publisher(self, topic: Topic[MessageT]) -> Publisher[MessageT]:
        """Declare that this plugin publishes `topic`."""
        ...

    def subscribe(self, *topics: Topic[Any]) -> None:
        """Let messages of these topics arrive in `inbox`. Raises BusError for one that is hidden from the plugin."""
        ...

    def subscribe_latest(self, depth: int, *topics: Topic[Any]) -> None:
        """Keep the last `depth` messages of each topic until the inbox is looked into; older ones cost nothing.

        For who only wants to see how things are: messages of different topics come in no order. Not for latched topics.
        """
        ...

    def subscribe_all(self, backlog: int = BACKLOG) -> None:
        """Let every message of the cell arrive in `inbox`, hidden ones too. For recorder and viewer.

        So many messages may wait before their senders are held up; within one process no sender is.
        """
        ...

    def serve(self, service: Service[Any, Any]) -> None:
        """Let requests to `service` arrive in `inbox`."""
        ...

    def request(self, service: Service[RequestT, ReplyT], message: RequestT, timeout: float) -> ReplyT:
        """Ask and wait. Raises BusError if no answer came within `timeout` seconds."""
        ...

    def announce(self) -> None:
        """Tell the cell that everything is declared."""
        ...

    def settle(self) -> None:
        """Wait until publishers know of all who had subscribed by now."""
        ...

    def counts(self) -> list[PublisherCount]:
        """What was published so far."""
        ...

    @property
    def inbox(self) -> Inbox:
        """Where everything arrives."""
        ...

    def close(self) -> None:
        """Leave the bus. Idempotent."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


READS_HIDDEN = frozenset({"recorder", "viewer"})


def check_readable(role: str, topic: Topic[Any]) -> None:
    """Raise BusError where a plugin of this role must not read a topic."""
    if topic.hidden and role not in READS_HIDDEN:
        raise BusError(f"{topic.name} is hidden from {role!r}: only {', '.join(sorted(READS_HIDDEN))} may read it")
