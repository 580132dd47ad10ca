"""The bus on Zenoh.

Plugins are clients of one router, which the launcher runs: on loopback, or with TLS and access control for a network.
A client's declarations reach the router in the order they were made, so once the router has seen a plugin's
announcement it knows all its subscriptions, and nothing published afterwards can miss them. A publisher sends nothing
until it hears of a subscriber, so plugins keep silent until the session begins: that word reaches each of them behind
everybody's subscriptions.
"""

from __future__ import annotations

import threading
from typing import Any, Generic

import zenoh
from zenoh import ext

from runtime.bus import BACKLOG, Envelope, Inbox, MessageT, Request, check_readable, decode, encode
from runtime.clock import Stopwatch
from runtime.closing import Closing
from runtime.errors import BusError, InputError
from runtime.messages import PublisherCount
from runtime.network import access, rmw_zenoh
from runtime.network.access import service_key
from runtime.network.meeting_point import DEFAULT_PORT, MeetingPoint
from runtime.network.zenoh_session import config, shown
from runtime.topics import ReplyT, RequestT, Service, Topic

CONNECT_TIMEOUT = 10.0  # [s]
_HEARTBEAT = 0.5  # [s] after which a latched publisher tells once more which message was its last, as rmw_zenoh's do
_FETCHED = 2_000  # messages that are fetched at once, so that a flood is worked off while it lasts


class ZenohRouter(Closing):
    """The meeting point of a cell's plugins, or with `playback` of a log's listeners.

    Raises InputError for a port or an address that it cannot have, or for keys that are not right.
    """

    def __init__(self, point: MeetingPoint | int = DEFAULT_PORT, *, playback: bool = False) -> None:
        self.point = point = point if isinstance(point, MeetingPoint) else MeetingPoint(point)
        self._present: set[str] = set()
        self._left: dict[str, Stopwatch] = {}  # since each went for the first time
        self._changed = threading.Condition()
        settings: dict[str, Any] = {
            "mode": "router",
            "listen/endpoints": [point.endpoint(host) for host in point.hosts],
            "connect/endpoints": [],
        }
        if point.keys is not None:
            settings |= shown(access.ROUTER, point.keys, "listen", point.hosts)
            settings["access_control"] = access.control(point.domain, playback=playback)
        try:
            self._session = zenoh.open(config(settings))
        except zenoh.ZError as error:
            raise InputError(
                f"port {point.port} on {', '.join(point.hosts)} is in use or not allowed; is another cell running? "
                f"End it, or choose another port with --port ({str(error).splitlines()[0][:120]})"
            ) from None
        self._tokens = self._session.liveliness().declare_subscriber(
            rmw_zenoh.node_tokens(point.domain), self._on_token, history=True
        )

    def _on_token(self, sample: zenoh.Sample) -> None:
        node = str(sample.key_expr).rsplit("/", 1)[1]
        with self._changed:
            if sample.kind == zenoh.SampleKind.PUT:
                self._present.add(node)
            else:
                self._present.discard(node)
                self._left.setdefault(node, Stopwatch())
            self._changed.notify_all()

    def wait_for(self, roles: set[str], timeout: float) -> set[str]:
        """Wait until these roles have announced themselves; return those that have not within `timeout` seconds."""
        with self._changed:
            self._changed.wait_for(lambda: roles <= self._present, timeout)
            return roles - self._present

    def lost_touch(self, roles: set[str], grace: float) -> set[str]:
        """Those of these roles that went more than `grace` seconds ago, even if they have come back since.

        A client that says nothing for ten seconds has gone, and so has one whose connection broke: what was on its way
        to it is lost.
        """
        with self._changed:
            return {role for role in roles & self._left.keys() if self._left[role].seconds > grace}

    def close(self) -> None:
        """Stop routing."""
        if not self._session.is_closed():
            self._session.close()


class ZenohPublisher(Generic[MessageT]):
    """Publishes one topic on Zenoh."""

    def __init__(self, session: zenoh.Session, topic: Topic[MessageT], token: str, domain: int) -> None:
        self.topic = topic
        self.sent = 0
        self.identity = rmw_zenoh.identity(token)  # (16,) in every envelope
        name = rmw_zenoh.key(topic, domain)
        # An advanced publisher does not tell whether anybody listens, a plain one of the same key does.
        self._plain = session.declare_publisher(name, congestion_control=zenoh.CongestionControl.BLOCK)
        self._publisher: zenoh.Publisher | ext.AdvancedPublisher = self._plain
        if topic.latched:
            self._publisher = ext.declare_advanced_publisher(
                session,
                name,
                cache=ext.CacheConfig(1),
                publisher_detection=True,
                sample_miss_detection=ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=_HEARTBEAT),
                congestion_control=zenoh.CongestionControl.BLOCK,
            )
        self._token = session.liveliness().declare_token(token)

    def send(self, message: MessageT, stamp: int) -> None:
        """Publish at session time `stamp` [ns]."""
        self.send_raw(encode(message), stamp)

    def send_raw(self, payload: bytes, stamp: int) -> None:
        """Publish a message that is CDR already."""
        self.sent += 1
        attachment = rmw_zenoh.Attachment(self.sent, stamp, self.identity).pack()
        try:
            self._publisher.put(payload, attachment=attachment)
        except zenoh.ZError as error:
            raise BusError(f"{self.topic.name} could not be published: {error}") from None

    @property
    def matched(self) -> bool:
        """Whether the router has told of a subscriber. It routes to those that it has told of."""
        status: Any = self._plain.matching_status  # zenoh's stub calls it a bool, which it is not
        return bool(status.matching)


class ZenohBus(Closing):
    """One plugin's session with the cell's router."""

    def __init__(
        self,
        role: str,
        point: MeetingPoint | int = DEFAULT_PORT,
        patience: float = CONNECT_TIMEOUT,  # [s] for the router to answer
    ) -> None:
        self.inbox = Inbox()
        point = point if isinstance(point, MeetingPoint) else MeetingPoint(point)
        self._role = role
        self._domain = point.domain
        self._publishers: dict[str, ZenohPublisher[Any]] = {}
        self._declared: list[Any] = []
        self._rings: list[Any] = []  # subscribers that keep the latest messages
        settings: dict[str, Any] = {
            "mode": "client",
            "connect/endpoints": [point.endpoint(point.host)],
            "connect/timeout_ms": round(patience * 1000),
            "listen/endpoints": [],
        }
        if point.keys is not None:
            settings |= shown(role, point.keys, "connect")
        try:
            self._session = zenoh.open(config(settings))
        except zenoh.ZError as error:
            reason = str(error).splitlines()[0][:120]
            raise BusError(f"no cell answers on {point}: {reason}") from None
        self._id = str(self._session.zid())
        # Direct: by default every subscriber has a thread of its own, and the order between topics is lost.
        self._handler = zenoh.handlers.Callback(self.inbox.read_by(self._envelope), indirect=False)

    def _entity(self) -> int:
        return len(self._declared) + len(self._rings) + len(self._publishers) + 1

    def publisher(self, topic: Topic[MessageT]) -> ZenohPublisher[MessageT]:
        """Declare that this plugin publishes `topic`."""
        if topic.name not in self._publishers:
            token = rmw_zenoh.entity_token("MP", self._id, self._entity(), self._role, topic, self._domain)
            self._publishers[topic.name] = ZenohPublisher(self._session, topic, token, self._domain)
        return self._publishers[topic.name]

    def subscribe(self, *topics: Topic[Any]) -> None:
        """Let messages of these topics arrive in `inbox`."""
        for topic in topics:
            check_readable(self._role, topic)
            token = rmw_zenoh.entity_token("MS", self._id, self._entity(), self._role, topic, self._domain)
            name = rmw_zenoh.key(topic, self._domain)
            if topic.latched:
                self._declared.append(
                    ext.declare_advanced_subscriber(
                        self._session, name, self._handler, history=ext.HistoryConfig(detect_late_publishers=True)
                    )
                )
            else:
                self._declared.append(self._session.declare_subscriber(name, self._handler))
            self._declared.append(self._session.liveliness().declare_token(token))

    def subscribe_latest(self, depth: int, *topics: Topic[Any]) -> None:
        """Keep the last `depth` messages of each topic until the inbox is looked into."""
        for topic in topics:
            check_readable(self._role, topic)
            name = rmw_zenoh.key(topic, self._domain)
            token = rmw_zenoh.entity_token("MS", self._id, self._entity(), self._role, topic, self._domain)
            self._rings.append(self._session.declare_subscriber(name, zenoh.handlers.RingChannel(depth)))
            self._declared.append(self._session.liveliness().declare_token(token))
        self.inbox.fetch_by(self._fetch_latest)

    def _fetch_latest(self) -> None:
        for ring in self._rings:
            while (sample := ring.try_recv()) is not None:
                self._on_sample(sample)

    def subscribe_all(self, backlog: int = BACKLOG) -> None:
        """Let every message of the cell arrive in `inbox`."""
        everything = self._session.declare_subscriber(f"{self._domain}/**", zenoh.handlers.FifoChannel(backlog))
        self._declared.append(everything)

        def fetch() -> None:
            for _ in range(_FETCHED):
                sample = everything.try_recv()
                if sample is None:
                    break
                self._on_sample(sample)

        self.inbox.fetch_by(fetch)

    def _on_sample(self, sample: zenoh.Sample) -> None:
        envelope = self._envelope(sample)
        if envelope is not None:
            self.inbox.put(envelope)

    def _envelope(self, sample: zenoh.Sample) -> Envelope | None:
        topic = "keys of no topic"
        try:
            topic, ros_type = rmw_zenoh.parse_key(str(sample.key_expr))
            if sample.attachment is None:
                raise BusError(f"a message of {topic} has no attachment")
            sequence, stamp, publisher = rmw_zenoh.unpacked(bytes(sample.attachment))
        except BusError as error:
            self.inbox.refuse(topic, str(error))
            return None
        return Envelope(topic, ros_type, bytes(sample.payload), stamp, sequence, publisher)

    def serve(self, service: Service[Any, Any]) -> None:
        """Let requests to `service` arrive in `inbox`."""

        def on_query(query: zenoh.Query) -> None:
            def answer(payload: bytes) -> None:
                query.reply(query.key_expr, payload)
                query.drop()

            self.inbox.put(Request(service.name, bytes(query.payload or b""), answer))

        handler = zenoh.handlers.Callback(on_query, indirect=False)
        self._declared.append(self._session.declare_queryable(service_key(service), handler, complete=True))

    def request(self, service: Service[RequestT, ReplyT], message: RequestT, timeout: float) -> ReplyT:
        """Ask and wait."""
        watch = Stopwatch()
        replies = self._session.get(service_key(service), payload=encode(message), timeout=timeout)
        for reply in replies:
            if reply.ok is None:
                continue
            try:
                return decode(bytes(reply.ok.payload), service.reply)
            except BusError as error:
                self.inbox.refuse(service.name, str(error))
        when = f"within {timeout:g} s" if watch.seconds >= timeout else "because nobody serves it now"
        raise BusError(f"{service.name} gave no answer {when}; {service.server!r} should")

    def announce(self) -> None:
        """Tell the cell that everything is declared."""
        token = rmw_zenoh.node_token(self._id, self._role, self._domain)
        self._declared.append(self._session.liveliness().declare_token(token))

    def settle(self) -> None:
        """Wait for an answer of the router: what it knew of subscribers comes before."""
        for _ in self._session.liveliness().get(rmw_zenoh.node_tokens(self._domain), timeout=CONNECT_TIMEOUT):
            pass

    def counts(self) -> list[PublisherCount]:
        """What was published so far."""
        return [PublisherCount(name, publisher.sent) for name, publisher in sorted(self._publishers.items())]

    def close(self) -> None:
        """Leave the bus. A session that is left open would keep the process from ending."""
        if not self._session.is_closed():
            self._session.close()
