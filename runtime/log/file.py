"""Reads recorded logs (MCAP), those too whose recorder was killed before it could finish them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from difflib import get_close_matches
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

from mcap.records import Channel, Schema
from mcap.well_known import MessageEncoding

from runtime.bus import Envelope
from runtime.closing import Closing
from runtime.declaration import type_name
from runtime.errors import LogError
from runtime.log.decoding import Decoding, Recorded, decoding_of, unpublishable
from runtime.log.part import UNKNOWN_PUBLISHER, LogPart, merged, type_of
from runtime.log.split import later_parts, part_number, part_path
from runtime.messages import typestore
from runtime.topics import ANYBODY, Topic, topics

MessageT = TypeVar("MessageT")

__all__ = ["UNKNOWN_PUBLISHER", "LogFile", "LogTopic", "LogTopicHandle", "open_log"]


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
    first = LogPart(path)
    parts, broken = [first], ""
    try:
        for number, later in later_parts(path).items():
            expected = part_path(path, number - 1)
            if parts[-1].path != expected:
                broken = broken or f"{expected.name} is missing"
            try:
                parts.append(LogPart(later))
            except LogError as error:
                broken = broken or str(error)
        return LogFile(parts, broken)
    except BaseException:
        for part in parts:
            part.close()
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
    """A recorded session, in one file or in several. Times are session time [ns]."""

    def __init__(self, parts: list[LogPart], broken: str = "") -> None:
        self.path = parts[0].path
        self._parts = parts
        self._broken = broken or self._shortcoming()  # why the log is not complete; empty if it is
        self._decodings: dict[tuple[str, str], Decoding | LogError] = {}  # by topic and type
        if len(parts) > 1:
            for part in parts:
                part.rest()

    def _shortcoming(self) -> str:
        cut = next((part for part in self._parts if not part.complete), None)
        if cut is not None:
            return f"{cut.path.name} is cut short, as when its recorder was killed"
        if self._parts[-1].continued and part_number(self.path) == 1:
            return f"{part_path(self.path, len(self._parts) + 1).name} is missing"
        return ""

    @property
    def complete(self) -> bool:
        """Whether the recorder closed the log in good order, and all its files are here."""
        return not self._broken

    def check_complete(self, used: str) -> None:
        """Raise LogError if the log is cut short; `used` says what became of what it does hold."""
        if self._broken:
            raise LogError(f"{self._broken}: {used}")

    @property
    def files(self) -> tuple[Path, ...]:
        """The files that the log is made of, in order."""
        return tuple(part.path for part in self._parts)

    def check_sound(self) -> None:
        """Raise LogError if anything that the files hold is damaged; for readers that would pass over it."""
        for part in self._parts:
            part.check_sound()

    @property
    def start(self) -> int:
        """Stamp of the earliest message [ns]; 0 for a log without messages."""
        return min((part.contents.start for part in self._parts if part.contents.counts), default=0)

    @property
    def end(self) -> int:
        """Stamp of the latest message [ns]; 0 for a log without messages."""
        return max(part.contents.end for part in self._parts)

    @cached_property
    def topics(self) -> tuple[LogTopic, ...]:
        """What the log holds, by name of topic. Latched messages that a later file repeats are counted once."""
        found: dict[LogTopic, int] = {}
        for index, part in enumerate(self._parts):
            without = part.restated if index else frozenset()
            for channel, schema, count in part.channels():
                topic = _log_topic(channel, schema)
                found[topic] = found.get(topic, 0) + (0 if channel.id in without else count)
        counted = [replace(topic, count=count) for topic, count in found.items()]
        return tuple(sorted(counted, key=lambda topic: (topic.name, topic.type)))

    @cached_property
    def metadata(self) -> dict[str, dict[str, str]]:
        """Metadata records by name; of two with one name the later."""
        return {name: values for part in self._parts for name, values in part.metadata().items()}

    @cached_property
    def attachments(self) -> dict[str, bytes]:
        """Attached files by name; of two with one name the later."""
        return {name: data for part in self._parts for name, data in part.attachments().items()}

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
        first, *later = self._parts
        if not later:
            yield from first.messages(names, start, end)
            return
        chosen = [
            (part.contents.start, part.messages(names, start, end, without=part.restated if index else ()))
            for index, part in enumerate(self._parts)
            if (end is None or part.contents.start < end) and (start is None or part.contents.end >= start)
        ]
        yield from merged(chosen)

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
        try:
            return self._decoding(envelope.topic, envelope.type).decode(envelope.payload)
        except LogError:
            raise
        except Exception as error:  # rosbags raises several types on malformed bytes
            raise LogError(
                f"{self.path}: {envelope.topic} at {envelope.stamp / 1e9:.3f} s: "
                f"{len(envelope.payload)} bytes are no {envelope.type}: {error}"
            ) from None

    def recorded_fields(self, envelope: Envelope) -> Recorded:
        """Fields that this log has of those classes in a message that it defines differently from today."""
        return self._decoding(envelope.topic, envelope.type).recorded

    def _decoding(self, name: str, ros_type: str) -> Decoding:
        key = (name, ros_type)
        if key not in self._decodings:
            topic = next(topic for topic in self.topics if (topic.name, topic.type) == key)
            try:
                self._decodings[key] = decoding_of(ros_type, topic.encoding, topic.definition, topic.hash)
            except LogError as error:
                self._decodings[key] = error
        found = self._decodings[key]
        if isinstance(found, LogError):
            raise LogError(f"{self.path}: {name}: {found}")
        return found

    def handle(self, name: str) -> Topic[Any]:
        """A topic to publish this log's messages of that name on. Raises LogError if the type is not known."""
        topic = next(topic for topic in self.topics if topic.name == name)
        obstacle = unpublishable(topic.type, topic.encoding, topic.definition, topic.hash)
        if obstacle:
            raise LogError(f"{self.path}: {name}: {obstacle}")
        known = topics().get(name)
        if known is not None and type_name(known.type) == topic.type:
            return known
        return LogTopicHandle(name, typestore().types[topic.type], ANYBODY, "as recorded", "a topic of a log")

    def close(self) -> None:
        """Close the files. Idempotent."""
        for part in self._parts:
            part.close()


def _log_topic(channel: Channel, schema: Schema | None) -> LogTopic:
    text = schema.data.decode("utf-8", "replace") if schema is not None and schema.encoding == "ros2msg" else ""
    kind, hashed = type_of(channel, schema), channel.metadata.get("topic_type_hash", "")
    return LogTopic(channel.topic, kind, 0, channel.message_encoding, text, hashed)
