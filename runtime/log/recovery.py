"""Closes logs that were never finished: what is sound in them gets the index and the end that it lacks."""

from __future__ import annotations

import contextlib
import json
import os
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mcap.records import Attachment, Channel, Header, Message, Metadata, Schema
from mcap.writer import Writer

from runtime.errors import InputError, LogError, SessionError
from runtime.log.file import open_log
from runtime.log.index import records_of
from runtime.log.output import LogOutput, being_written
from runtime.log.part import LogPart
from runtime.log.split import CONTINUED, RESTATED, later_parts, part_number
from runtime.log.writer import CHUNK_SIZE, LIBRARY, PROFILE, SUMMARY
from runtime.messages import NANOSECONDS
from runtime.topics import ANYBODY, topics

Show = Callable[[int, int], None]  # bytes read so far, and in all
_KEPT = ".unfinished"  # what the name of a file that was replaced ends with


@dataclass(frozen=True)
class RecoveredFile:
    """What came out of one file."""

    path: Path  # the whole file
    original: Path  # as it was
    messages: int  # restated ones not counted
    until: float  # [s] session time of the latest
    dropped: int  # [byte] at the end that were of no use


def recover(path: Path, output: Path | None = None, show: Show = lambda _done, _all: None) -> list[RecoveredFile]:
    """Close what was not finished of a log, in place or to `output`. Returns nothing for a complete log.

    In place the old file is kept, with the ending .unfinished; the new one takes its name at once, when it is whole.
    Raises LogError for what is no log, InputError if it is still being recorded or the place is taken, SessionError if
    the disk is full.
    """
    with open_log(path) as log:
        if log.complete:
            return []
    files = [path, *later_parts(path).values()]
    parts: list[LogPart] = []
    useless: list[Path] = []  # files that break off before anything was in them
    try:
        for file in files:
            _check_idle(file)
            try:
                parts.append(LogPart(file))
            except LogError:
                useless.append(file)
        unfinished = [
            part for part in parts if not part.complete or (part is parts[-1] and part.continued and _is_first(path))
        ]
        if output is not None and len(unfinished) > 1:
            raise InputError(f"{len(unfinished)} files of this session were not finished; leave out --output")
        done = []
        for part in unfinished:
            rewriting = _Rewriting(part, parts, show)
            done.append(rewriting.to(output) if output is not None else rewriting.in_place())
    finally:
        for part in parts:
            part.close()
    if output is None:
        for file in useless:
            file.replace(_kept(file))
    if not done:
        raise LogError(f"nothing in the files of {path.name} can be closed, and not all of them are here")
    return done


def _is_first(path: Path) -> bool:
    return part_number(path) == 1


def _check_idle(file: Path) -> None:
    with file.open("rb") as opened:
        if being_written(opened):
            raise InputError(f"{file} is still being recorded; it is closed when its session ends")


def _kept(path: Path) -> Path:
    kept = path.with_name(path.name + _KEPT)
    if kept.exists() and not kept.samefile(path):
        raise InputError(f"{kept} is there already, from an earlier recovery; move it away")
    return kept


@dataclass
class _Account:
    """What the copied messages tell of losses: MCAP keeps no publishers, so only topics with a single one are told."""

    messages: int = 0
    until: int = 0  # [ns]
    lost: Counter[str] = field(default_factory=Counter)
    undefined: Counter[str] = field(default_factory=Counter)
    recorded: set[str] = field(default_factory=set)  # topics
    last: dict[int, int] = field(default_factory=dict)  # sequence by channel

    def note(self, channel: Channel, message: Message) -> None:
        if RESTATED in channel.metadata:
            return
        self.messages += 1
        self.until = max(self.until, message.log_time)
        self.recorded.add(channel.topic)
        if not channel.schema_id:
            self.undefined[channel.metadata.get("type", "")] += 1
        known = topics().get(channel.topic)
        if known is not None and known.publisher != ANYBODY:
            missing = message.sequence - self.last.get(channel.id, message.sequence - 1) - 1
            self.lost[channel.topic] += max(missing, 0)
        self.last[channel.id] = message.sequence

    def summary(self, before: dict[str, str]) -> dict[str, str]:
        """As a recorder's, with what it said `before` in an earlier file."""
        lost = self.lost + Counter(json.loads(before.get("lost_topics", "{}")))
        undefined = self.undefined + Counter(json.loads(before.get("undefined_types", "{}")))
        return {
            "messages": str(self.messages + int(before.get("messages", "0"))),
            "lost": str(lost.total()),
            "lost_topics": json.dumps({topic: lost[topic] for topic in sorted(lost)}),
            "unsigned_topics": json.dumps(sorted(self.recorded | set(json.loads(before.get("unsigned_topics", "[]"))))),
            "undefined_types": json.dumps(dict(undefined)),
        }


class _Rewriting:
    """Copies one file of a log."""

    def __init__(self, part: LogPart, parts: list[LogPart], show: Show) -> None:
        self._part = part
        index = parts.index(part)
        self._before = parts[index - 1] if index else None
        self._after = parts[index + 1] if index + 1 < len(parts) else None
        self._show = show
        self._account = _Account()

    def in_place(self) -> RecoveredFile:
        path = self._part.path
        kept = _kept(path)
        temporary = path.with_name(f".{path.name}.recovering")
        temporary.unlink(missing_ok=True)  # of a recovery that was killed
        dropped = self._write(temporary)
        try:
            os.link(path, kept)
        except FileExistsError:
            pass  # the same file, of a recovery that was killed here
        except OSError:  # a file system without links
            path.replace(kept)
        temporary.replace(path)
        return self._recovered(path, kept, dropped)

    def to(self, output: Path) -> RecoveredFile:
        if output.exists():
            raise InputError(f"{output} exists already; choose another name")
        return self._recovered(output, self._part.path, self._write(output))

    def _recovered(self, path: Path, original: Path, dropped: int) -> RecoveredFile:
        return RecoveredFile(path, original, self._account.messages, self._account.until / NANOSECONDS, dropped)

    def _write(self, target: Path) -> int:
        """Write the file. Returns how many bytes at the end of the old one were of no use."""
        output = LogOutput(target)
        try:
            dropped = self._copy(output)
        except BaseException as error:
            output.close()
            with contextlib.suppress(OSError):
                target.unlink()
            if isinstance(error, OSError):
                raise SessionError(f"{target} cannot be written: {error.strerror or error}") from None
            raise
        output.close()
        with target.open("rb") as written:
            os.fsync(written.fileno())
        return dropped

    def _copy(self, output: LogOutput) -> int:
        """Copy what is sound, in the order in which it was recorded."""
        copy = _Copy(output, self._account, keeps_continued=self._after is not None)
        size, sound = self._part.path.stat().st_size, 0
        with self._part.path.open("rb") as file:
            for record, offset in records_of(file):
                if offset != sound:
                    sound = offset
                    self._show(sound, size)
                copy.take(record)
        account = copy.metadata.get(SUMMARY) or self._account.summary(self._so_far(self._before))
        if self._after is None:
            until = f"{self._account.until / NANOSECONDS:.9f}"
            copy.note(SUMMARY, {**account, "recovered": str(self._account.messages), "until": until})
        elif CONTINUED not in copy.metadata:
            copy.note(CONTINUED, {"file": self._after.path.name, **account})
        copy.finish()
        return 0 if self._part.complete else size - sound

    @staticmethod
    def _so_far(before: LogPart | None) -> dict[str, str]:
        return {} if before is None else before.metadata().get(CONTINUED, {})


class _Copy:
    """The new file."""

    def __init__(self, output: Any, account: _Account, *, keeps_continued: bool) -> None:
        self.metadata: dict[str, dict[str, str]] = {}  # records so far
        self._writer: Any = Writer(output, chunk_size=CHUNK_SIZE)
        self._account = account
        self._keeps_continued = keeps_continued
        self._schemas = {0: 0}  # numbers there by numbers here
        self._channels: dict[int, tuple[int, Channel]] = {}
        self._ways: dict[type, Callable[[Any], None]] = {
            Header: self._start,
            Schema: self._define,
            Channel: self._open,
            Message: self._append,
            Attachment: self._attach,
            Metadata: lambda record: self.note(record.name, record.metadata),
        }

    def take(self, record: Any) -> None:
        """Copy a record; indexes are made anew."""
        way = self._ways.get(type(record))
        if way is not None:
            way(record)

    def note(self, name: str, values: dict[str, str]) -> None:
        """Write a metadata record."""
        if name != CONTINUED or self._keeps_continued:
            self._writer.add_metadata(name, values)
            self.metadata[name] = values

    def finish(self) -> None:
        """Write the index and the end."""
        self._writer.finish()

    def _start(self, record: Header) -> None:
        self._writer.start(record.profile or PROFILE, LIBRARY)

    def _define(self, record: Schema) -> None:
        if record.id not in self._schemas:
            self._schemas[record.id] = self._writer.register_schema(record.name, record.encoding, record.data)

    def _open(self, record: Channel) -> None:
        if record.id not in self._channels:
            schema = self._schemas.get(record.schema_id, 0)
            new = self._writer.register_channel(record.topic, record.message_encoding, schema, record.metadata)
            self._channels[record.id] = (new, record)

    def _append(self, record: Message) -> None:
        new, channel = self._channels[record.channel_id]
        self._writer.add_message(new, record.log_time, record.data, record.publish_time, record.sequence)
        self._account.note(channel, record)

    def _attach(self, record: Attachment) -> None:
        self._writer.add_attachment(record.create_time, record.log_time, record.name, record.media_type, record.data)
