"""A bus within one process, for tests and sweeps. Messages travel as CDR here too, so that both buses behave alike."""

from __future__ import annotations

import hashlib
import queue
import threading
from collections import deque
from dataclasses import dataclass, field
from typing import Any, Generic

from runtime.bus import BACKLOG, Envelope, Inbox, MessageT, Request, check_readable, decode, encode
from runtime.closing import Closing
from runtime.declaration import type_name
from runtime.errors import BusError
from runtime.messages import PublisherCount
from runtime.topics import ReplyT, RequestT, Service, Topic


@dataclass(eq=False)
class _Ring:
    """The latest messages of a topic."""

    kept: deque[Envelope]

    def put(self, item: Envelope) -> None:
        self.kept.append(item)


@dataclass
class LocalExchange:
    """Where the buses of one process meet."""

    lock: threading.Lock = field(default_factory=threading.Lock)
    subscribers: dict[str, list[Inbox | _Ring]] = field(default_factory=dict)
    everything: list[Inbox] = field(default_factory=list)
    servers: dict[str, Inbox] = field(default_factory=dict)
    latched: dict[tuple[str, bytes], Envelope] = field(default_factory=dict)
    present: set[str] = field(default_factory=set)
    arrivals: threading.Condition = field(default_factory=threading.Condition)

    def deliver(self, envelope: Envelope, latched: bool) -> None:
        """Hand an envelope to everybody who subscribed."""
        with self.lock:
            if latched:
                self.latched[envelope.topic, envelope.publisher] = envelope
            for inbox in (*self.subscribers.get(envelope.topic, ()), *self.everything):
                inbox.put(envelope)

    def listened(self, name: str) -> bool:
        """Whether anybody subscribed to a topic."""
        with self.lock:
            return bool(self.subscribers.get(name) or self.everything)

    def wait_for(self, roles: set[str], timeout: float) -> set[str]:
        """Wait until these roles have announced themselves; return those that have not."""
        with self.arrivals:
            self.arrivals.wait_for(lambda: roles <= self.present, timeout)
            return roles - self.present


class LocalPublisher(Generic[MessageT]):
    """Publishes on a LocalExchange."""

    def __init__(self, exchange: LocalExchange, topic: Topic[MessageT], identity: bytes) -> None:
        self.topic = topic
        self.sent = 0
        self._exchange = exchange
        self._identity = identity
        self._type = type_name(topic.type)

    def send(self, message: MessageT, stamp: int) -> None:
        """Publish at session time `stamp` [ns]."""
        self.send_raw(encode(message), stamp)

    def send_raw(self, payload: bytes, stamp: int) -> None:
        """Publish a message that is CDR already."""
        self.sent += 1
        envelope = Envelope(self.topic.name, self._type, payload, stamp, self.sent, self._identity)
        self._exchange.deliver(envelope, self.topic.latched)

    @property
    def matched(self) -> bool:
        """Whether anybody listens."""
        return self._exchange.listened(self.topic.name)


class LocalBus(Closing):
    """One plugin's access to a LocalExchange."""

    def __init__(self, exchange: LocalExchange, role: str) -> None:
        self.inbox = Inbox()
        self._exchange = exchange
        self._role = role
        self._publishers: dict[str, LocalPublisher[Any]] = {}
        self._rings: list[_Ring] = []

    def publisher(self, topic: Topic[MessageT]) -> LocalPublisher[MessageT]:
        """Declare that this plugin publishes `topic`."""
        if topic.name not in self._publishers:
            identity = hashlib.blake2b(f"{self._role} {topic.name}".encode(), digest_size=16).digest()
            self._publishers[topic.name] = LocalPublisher(self._exchange, topic, identity)
        return self._publishers[topic.name]

    def subscribe(self, *topics: Topic[Any]) -> None:
        """Let messages of these topics arrive in `inbox`."""
        for topic in topics:
            check_readable(self._role, topic)
            with self._exchange.lock:
                self._exchange.subscribers.setdefault(topic.name, []).append(self.inbox)
                for (name, _), envelope in self._exchange.latched.items():
                    if name == topic.name:
                        self.inbox.put(envelope)

    def subscribe_latest(self, depth: int, *topics: Topic[Any]) -> None:
        """Keep the last `depth` messages of each topic until the inbox is looked into."""
        for topic in topics:
            check_readable(self._role, topic)
            ring = _Ring(deque(maxlen=depth))
            self._rings.append(ring)
            with self._exchange.lock:
                self._exchange.subscribers.setdefault(topic.name, []).append(ring)
        self.inbox.fetch_by(self._fetch_latest)

    def _fetch_latest(self) -> None:
        for ring in self._rings:
            while ring.kept:
                self.inbox.put(ring.kept.popleft())

    def subscribe_all(self, backlog: int = BACKLOG) -> None:  # noqa: ARG002 - the inbox takes any number
        """Let every message arrive in `inbox`."""
        with self._exchange.lock:
            self._exchange.everything.append(self.inbox)
            for envelope in self._exchange.latched.values():
                self.inbox.put(envelope)

    def serve(self, service: Service[Any, Any]) -> None:
        """Let requests to `service` arrive in `inbox`."""
        with self._exchange.lock:
            self._exchange.servers[service.name] = self.inbox

    def request(self, service: Service[RequestT, ReplyT], message: RequestT, timeout: float) -> ReplyT:
        """Ask and wait."""
        replies: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        with self._exchange.lock:
            server = self._exchange.servers.get(service.name)
        if server is None:
            raise BusError(f"nobody answers {service.name}; {service.server!r} should")
        server.put(Request(service.name, encode(message), replies.put))
        try:
            return decode(replies.get(timeout=timeout), service.reply)
        except queue.Empty:
            raise BusError(f"{service.name} gave no answer within {timeout:g} s") from None

    def announce(self) -> None:
        """Tell the cell that everything is declared."""
        with self._exchange.arrivals:
            self._exchange.present.add(self._role)
            self._exchange.arrivals.notify_all()

    def settle(self) -> None:
        """Publishers know at once."""

    def counts(self) -> list[PublisherCount]:
        """What was published so far."""
        return [PublisherCount(name, publisher.sent) for name, publisher in sorted(self._publishers.items())]

    def close(self) -> None:
        """Leave the exchange."""
        with self._exchange.lock:
            for receivers in self._exchange.subscribers.values():
                receivers[:] = [item for item in receivers if item is not self.inbox and item not in self._rings]
            while self.inbox in self._exchange.everything:
                self._exchange.everything.remove(self.inbox)
            for name in [name for name, inbox in self._exchange.servers.items() if inbox is self.inbox]:
                del self._exchange.servers[name]
