"""The bus on Zenoh: the only file that imports zenoh.

Plugins are clients of one router, which the launcher runs on loopback. A client's declarations reach the router in the
order they were made, so once the router has seen a plugin's announcement it knows all its subscriptions, and nothing
published afterwards can miss them. A publisher sends nothing until it hears of a subscriber, so plugins keep silent
until the session begins: that word reaches each of them behind everybody's subscriptions.
"""

from __future__ import annotations

import json
import threading
from typing import Any, Generic

import zenoh
from zenoh import ext

from runtime import rmw_zenoh
from runtime.bus import Envelope, Inbox, MessageT, Request, check_readable, decode, encode
from runtime.closing import Closing
from runtime.errors import BusError, InputError
from runtime.messages import PublisherCount
from runtime.topics import ReplyT, RequestT, Service, Topic

DEFAULT_PORT = 7447  # the router port of rmw_zenoh
LOOPBACK = "127.0.0.1"
CONNECT_TIMEOUT = 10.0  # [s]
_BACKLOG = 100_000  # messages that may wait for a recorder before its senders are held up
_BLOCKED_FOR = (
    60_000_000  # [us] a slow receiver may hold a sender up before the transport gives up; zenoh's default is 5 s
)


def _config(settings: dict[str, Any]) -> zenoh.Config:
    config = zenoh.Config()
    common = {
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": True,
        "timestamping/enabled": True,
        "transport/link/tx/queue/congestion_control/block/wait_before_close": _BLOCKED_FOR,
    }
    for name, value in (common | settings).items():
        config.insert_json5(name, json.dumps(value))
    return config


def _service_key(service: Service[Any, Any]) -> str:
    return f"palpate{service.name}"


class ZenohRouter(Closing):
    """The meeting point of a cell's plugins. Listens on loopback only."""

    def __init__(self, port: int = DEFAULT_PORT, domain: int = rmw_zenoh.DOMAIN) -> None:
        self.port = port
        self._present: set[str] = set()
        self._changed = threading.Condition()
        try:
            self._session = zenoh.open(
                _config({"mode": "router", "listen/endpoints": [f"tcp/{LOOPBACK}:{port}"], "connect/endpoints": []})
            )
        except zenoh.ZError as error:
            raise InputError(
                f"port {port} on {LOOPBACK} is in use or not allowed; is another cell running? "
                f"End it, or choose another port with --port ({str(error).splitlines()[0][:120]})"
            ) from None
        self._tokens = self._session.liveliness().declare_subscriber(
            rmw_zenoh.node_tokens(domain), self._on_token, history=True
        )

    def _on_token(self, sample: zenoh.Sample) -> None:
        node = str(sample.key_expr).rsplit("/", 1)[1]
        with self._changed:
            if sample.kind == zenoh.SampleKind.PUT:
                self._present.add(node)
            else:
                self._present.discard(node)
            self._changed.notify_all()

    def wait_for(self, roles: set[str], timeout: float) -> set[str]:
        """Wait until these roles have announced themselves; return those that have not within `timeout` seconds."""
        with self._changed:
            self._changed.wait_for(lambda: roles <= self._present, timeout)
            return roles - self._present

    def close(self) -> None:
        """Stop routing."""
        if not self._session.is_closed():
            self._session.close()


class ZenohPublisher(Generic[MessageT]):
    """Publishes one topic on Zenoh."""

    def __init__(self, session: zenoh.Session, topic: Topic[MessageT], token: str, domain: int) -> None:
        self.topic = topic
        self.sent = 0
        self._identity = rmw_zenoh.identity(token)
        name = rmw_zenoh.key(topic, domain)
        self._publisher: zenoh.Publisher | ext.AdvancedPublisher
        if topic.latched:
            self._publisher = ext.declare_advanced_publisher(
                session,
                name,
                cache=ext.CacheConfig(1),
                publisher_detection=True,
                congestion_control=zenoh.CongestionControl.BLOCK,
            )
        else:
            self._publisher = session.declare_publisher(name, congestion_control=zenoh.CongestionControl.BLOCK)
        self._token = session.liveliness().declare_token(token)

    def send(self, message: MessageT, stamp: int) -> None:
        """Publish at session time `stamp` [ns]."""
        self.send_raw(encode(message), stamp)

    def send_raw(self, payload: bytes, stamp: int) -> None:
        """Publish a message that is CDR already."""
        self.sent += 1
        attachment = rmw_zenoh.Attachment(self.sent, stamp, self._identity).pack()
        try:
            self._publisher.put(payload, attachment=attachment)
        except zenoh.ZError as error:
            raise BusError(f"{self.topic.name} could not be published: {error}") from None


class ZenohBus(Closing):
    """One plugin's session with the cell's router."""

    def __init__(
        self,
        role: str,
        port: int = DEFAULT_PORT,
        domain: int = rmw_zenoh.DOMAIN,
        patience: float = CONNECT_TIMEOUT,  # [s] for the router to answer
    ) -> None:
        self.inbox = Inbox()
        self.malformed = 0  # messages whose key or attachment could not be read, and were dropped
        self._role = role
        self._domain = domain
        self._publishers: dict[str, ZenohPublisher[Any]] = {}
        self._declared: list[Any] = []
        try:
            self._session = zenoh.open(
                _config(
                    {
                        "mode": "client",
                        "connect/endpoints": [f"tcp/{LOOPBACK}:{port}"],
                        "connect/timeout_ms": round(patience * 1000),
                        "listen/endpoints": [],
                    }
                )
            )
        except zenoh.ZError as error:
            raise BusError(f"no cell answers on {LOOPBACK}:{port}: {str(error).splitlines()[0][:120]}") from None
        self._id = str(self._session.zid())
        # Direct: by default every subscriber has a thread of its own, and the order between topics is lost.
        self._handler = zenoh.handlers.Callback(self._on_sample, indirect=False)

    def _entity(self) -> int:
        return len(self._declared) + len(self._publishers) + 1

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

    def subscribe_all(self) -> None:
        """Let every message of the cell arrive in `inbox`."""
        everything = self._session.declare_subscriber(f"{self._domain}/**", zenoh.handlers.FifoChannel(_BACKLOG))
        self._declared.append(everything)

        def fetch() -> None:
            while (sample := everything.try_recv()) is not None:
                self._on_sample(sample)

        self.inbox.fetch_by(fetch)

    def _on_sample(self, sample: zenoh.Sample) -> None:
        try:
            topic, ros_type = rmw_zenoh.parse_key(str(sample.key_expr))
            if sample.attachment is None:
                raise BusError(f"a message of {topic} has no attachment")
            attachment = rmw_zenoh.Attachment.unpack(bytes(sample.attachment))
        except BusError:
            self.malformed += 1
            return
        self.inbox.put(
            Envelope(
                topic, ros_type, bytes(sample.payload), attachment.stamp, attachment.sequence, attachment.publisher
            )
        )

    def serve(self, service: Service[Any, Any]) -> None:
        """Let requests to `service` arrive in `inbox`."""

        def on_query(query: zenoh.Query) -> None:
            def answer(payload: bytes) -> None:
                query.reply(query.key_expr, payload)
                query.drop()

            self.inbox.put(Request(service.name, bytes(query.payload or b""), answer))

        handler = zenoh.handlers.Callback(on_query, indirect=False)
        self._declared.append(self._session.declare_queryable(_service_key(service), handler, complete=True))

    def request(self, service: Service[RequestT, ReplyT], message: RequestT, timeout: float) -> ReplyT:
        """Ask and wait."""
        replies = self._session.get(_service_key(service), payload=encode(message), timeout=timeout)
        for reply in replies:
            if reply.ok is not None:
                return decode(bytes(reply.ok.payload), service.reply)
        raise BusError(f"{service.name} gave no answer within {timeout:g} s; {service.server!r} should")

    def announce(self) -> None:
        """Tell the cell that everything is declared."""
        token = rmw_zenoh.node_token(self._id, self._role, self._domain)
        self._declared.append(self._session.liveliness().declare_token(token))

    def counts(self) -> list[PublisherCount]:
        """What was published so far."""
        return [PublisherCount(name, publisher.sent) for name, publisher in sorted(self._publishers.items())]

    def close(self) -> None:
        """Leave the bus. A session that is left open would keep the process from ending."""
        if not self._session.is_closed():
            self._session.close()
