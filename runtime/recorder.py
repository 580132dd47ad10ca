"""Records everything that travels on the bus in one MCAP file that other tools open as it is.

Profile `ros2`, CDR messages, `ros2msg` schemas with their dependencies, channel metadata as rosbag2 writes it. Session
time stamps the messages. What arrived is handed to the operating system several times a second, so that a killed
recorder leaves a readable file. At the end the file says how many messages it holds and which never arrived.
"""

from __future__ import annotations

import contextlib
import json
import logging
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import LIBRARY_IDENTIFIER, Writer
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2.metadata import dump_qos_v8

from runtime.bus import Envelope, Inbox
from runtime.clock import Stopwatch, wall_nanoseconds
from runtime.closing import Closing
from runtime.context import Context
from runtime.errors import BusError, SessionError
from runtime.messages import PublisherCount, typestore
from runtime.rmw_zenoh import type_hash
from runtime.topics import COUNTS, ROBOT_DESCRIPTION, topics

PROFILE = "ros2"
LIBRARY = f"palpate {LIBRARY_IDENTIFIER}"
SUMMARY = "palpate.recording"  # metadata record that a finished recording ends with
DESCRIPTION_FILE = "robot_description.urdf"  # attachment
CHUNK_SIZE = 64 * 1024  # [byte] what a crash may cost at most, besides FLUSH_INTERVAL
FLUSH_INTERVAL = 0.15  # [s] of machine time
LINGER = 0.02  # [s] of machine time in which messages gather before they are written together
QUIET = 2.0  # [s] of machine time without an arrival after which nothing more is expected
DRAIN_LIMIT = 15.0  # [s] of machine time for which a stopped recorder goes on receiving at most
_UINT32 = 0xFFFF_FFFF
_NO_TIME = QosTime(0, 0)


class LogWriter(Closing):
    """One MCAP file being written. Raises SessionError in one line if the file cannot be made or the disk is full.

    A file that ran into an error ends with the last message that was flushed; everything before it is readable.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.messages = 0
        self.undefined: Counter[str] = Counter()  # messages by type that palpate has no definition of
        self._schemas: dict[str, int] = {}
        self._channels: dict[tuple[str, str], int] = {}
        self._flushed = Stopwatch()
        self._kept = (0, 0)  # bytes and messages in the file after the last flush
        if path.exists():
            raise SessionError(f"{path} exists already; a recording is never overwritten")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("xb")
        except OSError as error:
            raise SessionError(f"{path} cannot be written: {error.strerror or error}") from None
        self._writer: Any = Writer(self._file, chunk_size=CHUNK_SIZE)  # its methods are only partly annotated
        with self._explained():
            self._writer.start(PROFILE, LIBRARY)

    def write(self, envelope: Envelope) -> None:
        """Append a message; session time becomes its log time."""
        stamp = max(envelope.stamp, 0)  # MCAP has no time before zero
        with self._explained():
            channel = self._channels.get((envelope.topic, envelope.type)) or self._open_channel(envelope)
            self._writer.add_message(channel, stamp, envelope.payload, stamp, envelope.sequence & _UINT32)
        self.messages += 1
        if not self._schemas[envelope.type]:
            self.undefined[envelope.type] += 1

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Append a metadata record."""
        with self._explained():
            self._writer.add_metadata(name, values)

    def attach(self, name: str, text: str, media_type: str = "text/plain") -> None:
        """Append an attachment."""
        with self._explained():
            self._writer.add_attachment(wall_nanoseconds(), 0, name, media_type, text.encode())

    def flush_if_due(self) -> None:
        """Hand everything to the operating system if that was last done FLUSH_INTERVAL ago."""
        if self._flushed.seconds >= FLUSH_INTERVAL:
            self.flush()

    def flush(self) -> None:
        """Hand everything written so far to the operating system."""
        with self._explained():
            self._writer.flush()
            self._kept = (self._file.tell(), self.messages)
        self._flushed = Stopwatch()

    def close(self) -> None:
        """Write index and end of the file. Idempotent; does nothing after an error."""
        if not self._file.closed:
            self.flush()
            with self._explained():
                self._writer.finish()
                self._file.close()

    def _open_channel(self, envelope: Envelope) -> int:
        if envelope.type not in self._schemas:
            self._schemas[envelope.type] = self._open_schema(envelope.type)
        schema = self._schemas[envelope.type]
        known = topics().get(envelope.topic)
        metadata = {
            "offered_qos_profiles": _offered_qos(latched=known is not None and known.latched),
            "topic_type_hash": type_hash(envelope.type) if schema else "",
            # rosbag2 has no place for the type of a message without a definition
            **({} if schema else {"type": envelope.type}),
        }
        channel = int(self._writer.register_channel(envelope.topic, MessageEncoding.CDR, schema, metadata))
        self._channels[envelope.topic, envelope.type] = channel
        return channel

    def _open_schema(self, ros_type: str) -> int:
        """Number of a schema; 0, MCAP's word for none, if palpate does not know the type."""
        try:
            text, _ = typestore().generate_msgdef(ros_type, ros_version=2)
        except Exception:  # rosbags raises several types for names it does not know or cannot parse
            return 0
        return int(self._writer.register_schema(ros_type, SchemaEncoding.ROS2, text.encode()))

    @contextlib.contextmanager
    def _explained(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            length, messages = self._kept
            with contextlib.suppress(OSError):
                self._file.raw.truncate(length)  # a part of a chunk would be of no use
                self._file.raw.close()  # without the buffer, which could not be written again
            raise SessionError(
                f"{self.path} cannot be written any further: {error.strerror or error}; it holds {messages} messages"
            ) from None


@dataclass
class Ledger:
    """What was sent, as far as the publishers said so, against what arrived."""

    inbox: Inbox
    sent: Counter[str] = field(default_factory=Counter)

    def note(self, counts: list[PublisherCount]) -> None:
        """Take note of a closing plugin's last word."""
        for count in counts:
            self.sent[count.topic] += count.sent

    def accounted(self) -> Counter[str]:
        """Messages by topic that arrived or are known to be lost. /session/counts is left out: it counts itself not."""
        total = Counter(dict(list(self.inbox.lost.items())))
        for (topic, _), number in list(self.inbox.received.items()):
            total[topic] += number
        del total[COUNTS.name]
        return total

    def complete(self) -> bool:
        """Whether every publisher that was heard of has said its last word and all it sent has arrived."""
        sent = self.sent.copy()
        del sent[COUNTS.name]
        return +sent == +self.accounted()

    def lost(self) -> dict[str, int]:
        """Messages that never arrived, by topic: gaps in the sequence and what is missing at the end."""
        lost = Counter(dict(list(self.inbox.lost.items())))
        lost.update(self.sent - self.accounted())
        return {topic: number for topic, number in sorted(lost.items()) if number and topic != COUNTS.name}

    def unsigned(self) -> list[str]:
        """Topics of which some publisher never said how much it sent, so that their end may be missing."""
        return sorted(self.accounted() - self.sent)


@dataclass(frozen=True)
class Recorder:
    """Writes every message of the session to an MCAP file."""

    path: Path
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)  # records by name
    attachments: dict[str, str] = field(default_factory=dict)  # texts by file name

    def run(self, context: Context) -> None:
        """Record until stopped, then until everything that was sent has arrived."""
        with LogWriter(self.path) as log:
            for name, values in self.metadata.items():
                log.add_metadata(name, values)
            for name, text in self.attachments.items():
                log.attach(name, text)
            log.flush()
            context.bus.subscribe_all()
            context.ready()
            taken = _Taken(log, Ledger(context.bus.inbox), context)
            while not context.stopping:
                taken.next(FLUSH_INTERVAL)
            taken.drain()


@dataclass
class _Taken:
    """What has come out of the inbox so far."""

    log: LogWriter
    ledger: Ledger
    context: Context
    described: bool = False
    told: set[str] = field(default_factory=set)

    def next(self, timeout: float) -> bool:
        """Record what arrives next, if anything does within `timeout` seconds."""
        items = self.context.bus.inbox.gather(timeout, LINGER)
        for item in items:
            if isinstance(item, Envelope):
                self.context.clock.advance(item.stamp)
                # Last words come from every plugin, each by its own clock: they are stamped as they arrive.
                last_words = item.topic == COUNTS.name
                self.log.write(replace(item, stamp=self.context.clock.now) if last_words else item)
                self._look_at(item)
        self.log.flush_if_due()
        return bool(items)

    def _look_at(self, item: Envelope) -> None:
        try:
            if item.topic == COUNTS.name:
                self.ledger.note(item.read(COUNTS).counts)
            elif item.topic == ROBOT_DESCRIPTION.name and not self.described:
                self.log.attach(DESCRIPTION_FILE, item.read(ROBOT_DESCRIPTION).data, "application/xml")
                self.described = True
        except BusError as error:
            self.context.log(f"{item.topic} is recorded as it came: {error}", logging.WARNING)
        if item.type in self.log.undefined and item.type not in self.told:
            self.told.add(item.type)
            self.context.log(
                f"{item.topic} carries {item.type}, which palpate does not know: recorded without its definition",
                logging.WARNING,
            )

    def drain(self) -> None:
        """Receive until nothing more is to come, and write down what is missing."""
        inbox = self.context.bus.inbox
        own = [count for count in self.context.bus.counts() if count.topic != COUNTS.name]
        self.ledger.note(own)
        total, quiet = Stopwatch(), Stopwatch()
        while not (self.ledger.complete() and not len(inbox)) and quiet.seconds < QUIET and total.seconds < DRAIN_LIMIT:
            if self.next(0.05):
                quiet = Stopwatch()
        while len(inbox):  # the limit was reached, but what is here is here
            self.next(0.0)
        lost = self.ledger.lost()
        self.log.add_metadata(
            SUMMARY,
            {
                "messages": str(self.log.messages),
                "lost": str(sum(lost.values())),
                "lost_topics": json.dumps(lost),
                "unsigned_topics": json.dumps(self.ledger.unsigned()),
                "undefined_types": json.dumps(dict(self.log.undefined)),
            },
        )


def _offered_qos(*, latched: bool) -> str:
    """YAML of the quality of service that rmw_zenoh's publishers of a topic offer."""
    return dump_qos_v8(
        [
            Qos(
                QosHistory.KEEP_LAST,
                1 if latched else 10,
                QosReliability.RELIABLE,
                QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE,
                _NO_TIME,
                _NO_TIME,
                QosLiveliness.AUTOMATIC,
                _NO_TIME,
                False,
            )
        ]
    )
