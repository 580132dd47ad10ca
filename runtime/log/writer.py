"""Writes one MCAP file that other tools open as it is.

Profile `ros2`, CDR messages, `ros2msg` schemas with their dependencies, channel metadata as rosbag2 writes it. Session
time stamps the messages. What was written is handed to the operating system several times a second, so that a killed
process leaves a readable file.
"""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import LIBRARY_IDENTIFIER, Writer
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2.metadata import dump_qos_v8

from runtime.bus import Envelope
from runtime.clock import Stopwatch, wall_nanoseconds
from runtime.closing import Closing
from runtime.errors import SessionError
from runtime.log.output import LogOutput
from runtime.log.split import RESTATED
from runtime.messages import typestore
from runtime.network.rmw_zenoh import type_hash
from runtime.topics import topics

PROFILE = "ros2"
LIBRARY = f"palpate {LIBRARY_IDENTIFIER}"
SESSION_RECORD = "palpate.session"  # metadata record of what was run
VERSIONS_RECORD = "palpate.versions"
SUMMARY = "palpate.recording"  # metadata record that a finished recording ends with
CHUNK_SIZE = 64 * 1024  # [byte] what a crash may cost at most, besides FLUSH_INTERVAL
FLUSH_INTERVAL = 0.1  # [s] of machine time
_UINT32 = 0xFFFF_FFFF
_NO_TIME = QosTime(0, 0)


class LogWriter(Closing):
    """One MCAP file being written. Raises SessionError in one line if the file cannot be made or the disk is full.

    A file that ran into an error ends with the last chunk that was written whole; everything before it is readable.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.messages = 0  # restated ones not counted
        self.undefined: Counter[str] = Counter()  # messages by type that palpate has no definition of
        self._schemas: dict[str, int] = {}
        self._channels: dict[tuple[str, str, bool], int] = {}
        self._ordinary: dict[tuple[str, str], int] = {}  # channels of messages that are not restated
        self._flushed = Stopwatch()
        self._pending = False  # whether something waits for a flush
        self._kept = 0  # messages in the file
        self._output = LogOutput(path)
        self._size = 0  # of the file after the last message [byte]
        stream: Any = self._output
        self._writer: Any = Writer(stream, chunk_size=CHUNK_SIZE)  # its methods are only partly annotated
        with self._explained():
            self._writer.start(PROFILE, LIBRARY)

    @property
    def size(self) -> int:
        """Bytes in the file."""
        return self._output.size

    def write(self, envelope: Envelope) -> None:
        """Append a message; session time becomes its log time."""
        ros_type = envelope.type
        channel = self._ordinary.get((envelope.topic, ros_type))
        if channel is None:
            channel = self._ordinary[envelope.topic, ros_type] = self._channel(envelope, restated=False)
        stamp = envelope.stamp if envelope.stamp > 0 else 0  # MCAP has no time before zero
        try:
            self._writer.add_message(channel, stamp, envelope.payload, stamp, envelope.sequence & _UINT32)
        except OSError as error:
            raise self._failure(error) from None
        self.messages += 1
        self._pending = True
        if self._output.size != self._size:  # a chunk was full and has been written, with this message in it
            self._size, self._kept = self._output.size, self.messages
        if not self._schemas[ros_type]:
            self.undefined[ros_type] += 1

    def restate(self, envelope: Envelope, stamp: int) -> None:
        """Repeat a latched message of an earlier part at session time `stamp` [ns], so that this file stands alone.

        It has a channel of its own whose metadata say so (RESTATED), its log time is that of the repetition, and its
        publish time is the original stamp.
        """
        with self._explained():
            channel = self._channel(envelope, restated=True)
            original = max(envelope.stamp, 0)
            sequence = envelope.sequence & _UINT32
            self._writer.add_message(channel, max(stamp, 0), envelope.payload, original, sequence)
        self._pending = True

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Append a metadata record. It is in the file at once, before messages that wait for a flush."""
        with self._explained():
            self._writer.add_metadata(name, values)

    def attach(self, name: str, text: str, media_type: str = "text/plain") -> None:
        """Append an attachment, likewise."""
        with self._explained():
            self._writer.add_attachment(wall_nanoseconds(), 0, name, media_type, text.encode())

    @property
    def due(self) -> float:
        """Seconds of machine time until what waits has to be flushed; 0 if it has been due."""
        return max(0.0, FLUSH_INTERVAL - self._flushed.seconds) if self._pending else FLUSH_INTERVAL

    def flush_if_due(self) -> None:
        """Hand everything to the operating system if that was last done FLUSH_INTERVAL ago."""
        if self._pending and self._flushed.seconds >= FLUSH_INTERVAL:
            self.flush()

    def flush(self) -> None:
        """Hand everything written so far to the operating system."""
        with self._explained():
            self._writer.flush()
        self._size, self._kept, self._pending = self._output.size, self.messages, False
        self._flushed = Stopwatch()

    def close(self) -> None:
        """Write index and end of the file. Idempotent; does nothing after an error."""
        if not self._output.closed:
            self.flush()
            with self._explained():
                self._writer.finish()
            self._output.close()

    def _channel(self, envelope: Envelope, *, restated: bool) -> int:
        key = (envelope.topic, envelope.type, restated)
        if key not in self._channels:
            with self._explained():
                self._channels[key] = self._open_channel(envelope, restated=restated)
        return self._channels[key]

    def _open_channel(self, envelope: Envelope, *, restated: bool) -> int:
        if envelope.type not in self._schemas:
            self._schemas[envelope.type] = self._open_schema(envelope.type)
        schema = self._schemas[envelope.type]
        known = topics().get(envelope.topic)
        metadata = {
            "offered_qos_profiles": _offered_qos(latched=known is not None and known.latched),
            "topic_type_hash": type_hash(envelope.type) if schema else "",
            # rosbag2 has no place for the type of a message without a definition
            **({} if schema else {"type": envelope.type}),
            **({RESTATED: "true"} if restated else {}),
        }
        return int(self._writer.register_channel(envelope.topic, MessageEncoding.CDR, schema, metadata))

    def _open_schema(self, ros_type: str) -> int:
        """Number of a schema; 0, MCAP's word for none, if palpate does not know the type."""
        text = definition_of(ros_type)
        return int(self._writer.register_schema(ros_type, SchemaEncoding.ROS2, text.encode())) if text else 0

    @contextlib.contextmanager
    def _explained(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise self._failure(error) from None

    def _failure(self, error: OSError) -> SessionError:
        self._output.close()
        return SessionError(
            f"{self.path} cannot be written any further: {error.strerror or error}; it holds {self._kept} messages"
        )


def definition_of(ros_type: str) -> str:
    """The .msg text of a type with those that it is made of; empty if palpate does not know the type."""
    try:
        text, _ = typestore().generate_msgdef(ros_type, ros_version=2)
    except Exception:  # rosbags raises several types for names it does not know or cannot parse
        return ""
    return text


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
