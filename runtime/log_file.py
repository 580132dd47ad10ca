"""Reads recorded logs (MCAP), those too whose recorder was killed before it could finish them."""

from __future__ import annotations

import contextlib
import struct
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import cached_property
from pathlib import Path
from typing import IO, Any, TypeVar

from mcap.exceptions import EndOfFile, McapError
from mcap.reader import SeekingReader
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    Message,
    Metadata,
    MetadataIndex,
    Schema,
)
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.summary import Summary
from mcap.well_known import MessageEncoding
from mcap.writer import MCAP0_MAGIC
from rosbags.typesys import get_types_from_msg
from zstandard import ZstdError

from runtime.bus import Envelope
from runtime.closing import Closing
from runtime.declaration import type_name
from runtime.errors import LogError
from runtime.messages import typestore
from runtime.rmw_zenoh import type_hash
from runtime.topics import Topic, topics

MessageT = TypeVar("MessageT")

UNKNOWN_PUBLISHER = bytes(16)  # MCAP keeps no identity of publishers
_DAMAGE = (
    McapError,
    ValueError,
    struct.error,
    RuntimeError,
    KeyError,
    IndexError,
    OverflowError,
    MemoryError,
    ZstdError,
)


@dataclass(frozen=True)
class LogTopic:
    """One topic of a log."""

    name: str
    type: str  # ROS type name
    count: int
    encoding: str = MessageEncoding.CDR
    definition: str = ""  # .msg text with dependencies; empty if the log has none
    hash: str = ""  # RIHS01 of the type as it was recorded; empty if the log has none


class LogTopicHandle(Topic[Any]):
    """A topic of a log that is none of the map's, and stays out of it."""

    def __post_init__(self) -> None:
        """Leave the map alone."""


def open_log(path: Path | str) -> LogFile:
    """Open a log. Raises LogError in one line if there is nothing to read."""
    path = Path(path)
    if path.is_dir():
        raise LogError(f"{path} is a directory, not a log; {_logs_in(path, '')}")
    if not path.exists():
        folder = path.parent
        where = _logs_in(folder, path.name) if folder.is_dir() else f"the directory {folder} does not exist either"
        raise LogError(f"there is no log {path}; {where}")
    try:
        file = path.open("rb")
    except OSError as error:
        raise LogError(f"{path} cannot be read: {error.strerror or error}") from None
    try:
        return LogFile(path, file)
    except BaseException:
        file.close()
        raise


def _logs_in(folder: Path, wanted: str) -> str:
    names = sorted(item.name for item in folder.glob("*.mcap"))
    if not names:
        return f"{folder} holds no .mcap file"
    nearest = get_close_matches(wanted, names, n=3, cutoff=0.5) or names[-3:]
    return f"{folder} holds {', '.join(nearest)}" + (
        f" and {len(names) - len(nearest)} more" * (len(names) > len(nearest))
    )


class LogFile(Closing):
    """A recorded session. Times are session time [ns]."""

    def __init__(self, path: Path, file: IO[bytes]) -> None:
        self.path = path
        self._file = file
        self._contents, self.complete = _contents(path, file)
        self._reader = _Reader(file, self._contents.summary)
        self._decodable: dict[tuple[str, str], str] = {}  # why a topic cannot be decoded, empty if it can

    def check_complete(self, used: str) -> None:
        """Raise LogError if the log is cut short; `used` says what became of what it does hold."""
        if not self.complete:
            raise LogError(f"{self.path.name} is cut short, as when its recorder was killed: {used}")

    @property
    def start(self) -> int:
        """Stamp of the earliest message [ns]; 0 for a log without messages."""
        return self._contents.start

    @property
    def end(self) -> int:
        """Stamp of the latest message [ns]; 0 for a log without messages."""
        return self._contents.end

    @cached_property
    def topics(self) -> tuple[LogTopic, ...]:
        """What the log holds, by name of topic."""
        summary = self._contents.summary
        found = [
            _log_topic(channel, summary.schemas.get(channel.schema_id), self._contents.counts[channel.id])
            for channel in summary.channels.values()
        ]
        return tuple(sorted(found, key=lambda topic: (topic.name, topic.type)))

    @cached_property
    def metadata(self) -> dict[str, dict[str, str]]:
        """Metadata records by name; of two with one name the later."""
        with _explained(self.path):
            return {record.name: dict(record.metadata) for record in self._reader.iter_metadata()}

    @cached_property
    def attachments(self) -> dict[str, bytes]:
        """Attached files by name; of two with one name the later."""
        with _explained(self.path):
            return {record.name: record.data for record in self._reader.iter_attachments()}

    def messages(
        self, wanted: Iterable[str] | None = None, start: int | None = None, end: int | None = None
    ) -> Iterator[Envelope]:
        """Messages of the topics `wanted` (all by default) with start <= stamp < end [ns], earliest first.

        Messages with equal stamps come in the order in which they were recorded. Raises LogError where the file is
        damaged.
        """
        names = None if wanted is None else set(wanted)
        if start is not None and end is not None and start >= end:
            return
        summary = self._contents.summary
        types = {
            channel.id: _type_of(channel, summary.schemas.get(channel.schema_id))
            for channel in summary.channels.values()
        }
        with _explained(self.path):
            for _, channel, message in self._reader.iter_messages(names, starting_at=start, ending_before=end):
                yield Envelope(
                    channel.topic,
                    types[channel.id],
                    message.data,
                    message.log_time,
                    message.sequence,
                    UNKNOWN_PUBLISHER,
                )

    def read(
        self, topic: Topic[MessageT], start: int | None = None, end: int | None = None
    ) -> Iterator[tuple[int, MessageT]]:
        """Stamps [ns] and messages of a topic of the map, earliest first."""
        for envelope in self.messages([topic.name], start, end):
            if envelope.type != type_name(topic.type):
                raise LogError(
                    f"{self.path}: {topic.name} carries {envelope.type} in this log, not {type_name(topic.type)}"
                )
            yield envelope.stamp, self.decode(envelope)

    def decode(self, envelope: Envelope) -> Any:
        """The message in an envelope of this log. Raises LogError naming the type if palpate cannot."""
        key = (envelope.topic, envelope.type)
        if key not in self._decodable:
            self._decodable[key] = self._obstacle(*key)
        if self._decodable[key]:
            raise LogError(f"{self.path}: {envelope.topic}: {self._decodable[key]}")
        try:
            return typestore().deserialize_cdr(envelope.payload, envelope.type)
        except Exception as error:  # rosbags raises several types on malformed bytes
            raise LogError(
                f"{self.path}: {envelope.topic} at {envelope.stamp / 1e9:.3f} s: "
                f"{len(envelope.payload)} bytes are no {envelope.type}: {error}"
            ) from None

    def handle(self, name: str) -> Topic[Any]:
        """A topic to publish this log's messages of that name on. Raises LogError if the type is not known."""
        topic = next(topic for topic in self.topics if topic.name == name)
        obstacle = self._obstacle(topic.name, topic.type)
        if obstacle:
            raise LogError(f"{self.path}: {name}: {obstacle}")
        known = topics().get(name)
        if known is not None and type_name(known.type) == topic.type:
            return known
        return LogTopicHandle(name, typestore().types[topic.type], "any", "as recorded", "a topic of a log")

    def _obstacle(self, name: str, ros_type: str) -> str:
        topic = next(topic for topic in self.topics if (topic.name, topic.type) == (name, ros_type))
        if topic.encoding != MessageEncoding.CDR:
            return f"{ros_type or 'the type'} is encoded as {topic.encoding!r}; palpate reads ROS 2 messages (cdr)"
        if ros_type not in typestore().types and not _learn(ros_type, topic.definition):
            return f"palpate does not know the type {ros_type}, and the log has no definition of it"
        if topic.hash and topic.hash != type_hash(ros_type):
            return f"{ros_type} was recorded by a version of palpate that defined it differently"
        return ""

    def close(self) -> None:
        """Close the file. Idempotent."""
        self._file.close()


def _learn(ros_type: str, definition: str) -> bool:
    """Add a type that only the log defines; whether it is known now."""
    if not definition.strip():
        return False
    try:
        typestore().register(get_types_from_msg(definition, ros_type))
    except Exception:  # rosbags raises several types for text that is no definition or contradicts a known one
        return False
    return ros_type in typestore().types


def _type_of(channel: Channel, schema: Schema | None) -> str:
    return schema.name if schema is not None else channel.metadata.get("type", "")


def _log_topic(channel: Channel, schema: Schema | None, count: int) -> LogTopic:
    text = schema.data.decode("utf-8", "replace") if schema is not None and schema.encoding == "ros2msg" else ""
    kind = _type_of(channel, schema)
    return LogTopic(
        channel.topic, kind, count, channel.message_encoding, text, channel.metadata.get("topic_type_hash", "")
    )


@contextlib.contextmanager
def _explained(path: Path) -> Iterator[None]:
    """Turn what goes wrong while a file is read into a LogError."""
    try:
        yield
    except (*_DAMAGE, OSError) as error:
        raise LogError(f"{path} is damaged: {str(error) or type(error).__name__}") from None


@dataclass
class _Contents:
    """What is where in a log."""

    summary: Summary
    counts: Counter[int] = field(default_factory=Counter)  # messages by channel
    start: int = 0  # [ns]
    end: int = 0


class _Reader(SeekingReader):
    """Reads by an index that was made elsewhere."""

    def __init__(self, file: IO[bytes], summary: Summary) -> None:
        file.seek(0)
        super().__init__(file, validate_crcs=True)
        self._index = summary

    def get_summary(self) -> Summary:
        """The index."""
        return self._index


class _Whole:
    """A file that gives all the bytes asked for or says that it ends: the mcap package would go on with fewer."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file

    def read(self, length: int) -> bytes:
        data = self._file.read(length)
        if len(data) < length:
            raise EndOfFile
        return data


def _contents(path: Path, file: IO[bytes]) -> tuple[_Contents, bool]:
    """The index of a log, read or made, and whether the log was finished."""
    beginning = file.read(len(MCAP0_MAGIC))
    if not beginning:
        raise LogError(f"{path} is empty")
    if not MCAP0_MAGIC.startswith(beginning):
        raise LogError(f"{path} is no MCAP file")
    finished = _finished(file)
    if finished is not None:
        return finished, True
    contents, ended = _scan(file)
    if not ended and not contents.counts:
        raise LogError(f"{path} was never finished and breaks off before its first message")
    return contents, ended


def _finished(file: IO[bytes]) -> _Contents | None:
    """The index at the end of a log, if there is one that is sound."""
    file.seek(0)
    try:
        summary = SeekingReader(file).get_summary()
    except (*_DAMAGE, OSError):
        return None
    if (
        summary is None
        or summary.statistics is None
        or not (summary.chunk_indexes or not summary.statistics.message_count)
    ):
        return None
    statistics = summary.statistics
    counts = Counter(dict(statistics.channel_message_counts))
    return _Contents(summary, counts, statistics.message_start_time, statistics.message_end_time)


def _scan(file: IO[bytes]) -> tuple[_Contents, bool]:
    """Walk through a log from the front as far as it is sound; whether its end was reached."""
    contents = _Contents(Summary())
    file.seek(0)
    stream = StreamReader(_Whole(file), emit_chunks=True)  # type: ignore[arg-type]
    offset = len(MCAP0_MAGIC)
    try:
        for record in stream.records:
            _take(contents, record, offset, file.tell() - offset)
            offset = file.tell()
        return contents, True
    except _DAMAGE:  # what follows was not written or is damaged
        pass
    return contents, False


def _take(contents: _Contents, record: Any, offset: int, length: int) -> None:
    """Enter one record of the data section."""
    summary = contents.summary
    if isinstance(record, Chunk):
        records = breakup_chunk(record, validate_crc=True)
        summary.chunk_indexes.append(
            ChunkIndex(
                chunk_length=length,
                chunk_start_offset=offset,
                compression=record.compression,
                compressed_size=len(record.data),
                message_end_time=record.message_end_time,
                message_index_length=0,
                message_index_offsets={},
                message_start_time=record.message_start_time,
                uncompressed_size=record.uncompressed_size,
            )
        )
        for inner in records:
            _take(contents, inner, offset, length)
    elif isinstance(record, Schema):
        summary.schemas[record.id] = record
    elif isinstance(record, Channel):
        summary.channels[record.id] = record
    elif isinstance(record, Message):
        contents.start = min(contents.start, record.log_time) if contents.counts else record.log_time
        contents.end = max(contents.end, record.log_time)
        contents.counts[record.channel_id] += 1
    elif isinstance(record, Attachment):
        summary.attachment_indexes.append(
            AttachmentIndex(
                offset, length, record.log_time, record.create_time, len(record.data), record.name, record.media_type
            )
        )
    elif isinstance(record, Metadata):
        summary.metadata_indexes.append(MetadataIndex(offset=offset, length=length, name=record.name))
