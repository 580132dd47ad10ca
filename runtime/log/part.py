"""One file of a log: what is in it, and its messages in order of time."""

from __future__ import annotations

import contextlib
from collections.abc import Container, Iterator
from heapq import heappop, heappush
from pathlib import Path
from typing import IO

from mcap.records import Channel, Schema

from runtime.bus import Envelope
from runtime.closing import Closing
from runtime.errors import LogError
from runtime.log.index import IndexedReader, check_chunks, contents_of, explained
from runtime.log.split import CONTINUED, RESTATED

UNKNOWN_PUBLISHER = bytes(16)  # MCAP keeps no identity of publishers


class LogPart(Closing):
    """One MCAP file. Times are session time [ns]."""

    def __init__(self, path: Path) -> None:
        """Open a file. Raises LogError if it cannot be read or nothing is in it."""
        self.path = path
        try:
            self._file: IO[bytes] = path.open("rb")
        except OSError as error:
            raise LogError(f"{path} cannot be read: {error.strerror or error}") from None
        try:
            self.contents, self.complete = contents_of(path, self._file)
        except BaseException:
            self._file.close()
            raise

    def rest(self) -> None:
        """Keep no file open but while something is read: a long session has more files than a process may open."""
        self._file.close()

    @property
    def continued(self) -> bool:
        """Whether the file says that another one follows."""
        return any(index.name == CONTINUED for index in self.contents.summary.metadata_indexes)

    @property
    def restated(self) -> frozenset[int]:
        """Channels with messages that an earlier file has already."""
        channels = self.contents.summary.channels.values()
        return frozenset(channel.id for channel in channels if RESTATED in channel.metadata)

    def channels(self) -> Iterator[tuple[Channel, Schema | None, int]]:
        """Channels with their schemas and how many messages they have."""
        summary = self.contents.summary
        for channel in summary.channels.values():
            yield channel, summary.schemas.get(channel.schema_id), self.contents.counts[channel.id]

    def metadata(self) -> dict[str, dict[str, str]]:
        """Metadata records by name; of two with one name the later."""
        with self._reader() as reader:
            return {record.name: dict(record.metadata) for record in reader.iter_metadata()}

    def attachments(self) -> dict[str, bytes]:
        """Attached files by name; of two with one name the later."""
        with self._reader() as reader:
            return {record.name: record.data for record in reader.iter_attachments()}

    def messages(
        self, names: Container[str] | None, start: int | None, end: int | None, *, without: Container[int] = ()
    ) -> Iterator[Envelope]:
        """Messages with start <= stamp < end, earliest first; none of the channels `without`."""
        if not self.contents.counts:  # the mcap package would look for messages to the end, which may be missing
            return
        types = {channel.id: type_of(channel, schema) for channel, schema, _ in self.channels()}
        with self._reader() as reader:
            for _, channel, message in reader.iter_messages(names, starting_at=start, ending_before=end):  # type: ignore[arg-type]
                if channel.id not in without:
                    yield Envelope(
                        channel.topic,
                        types[channel.id],
                        message.data,
                        message.log_time,
                        message.sequence,
                        UNKNOWN_PUBLISHER,
                    )

    def check_sound(self) -> None:
        """Raise LogError if anything in the file is damaged."""
        with self._opened() as file:
            check_chunks(file, self.contents.summary)

    @contextlib.contextmanager
    def _reader(self) -> Iterator[IndexedReader]:
        with self._opened() as file:
            yield IndexedReader(file, self.contents.summary)

    @contextlib.contextmanager
    def _opened(self) -> Iterator[IO[bytes]]:
        with explained(self.path), contextlib.ExitStack() as stack:
            yield stack.enter_context(self.path.open("rb")) if self._file.closed else self._file

    def close(self) -> None:
        """Close the file. Idempotent."""
        self._file.close()


def type_of(channel: Channel, schema: Schema | None) -> str:
    """ROS type of a channel; empty if it has none."""
    return schema.name if schema is not None else channel.metadata.get("type", "")


def merged(parts: list[tuple[int, Iterator[Envelope]]]) -> Iterator[Envelope]:
    """Messages of several files, earliest first; of equal stamps those of the earlier file first.

    Each file comes with the stamp [ns] before which it has nothing, and is not opened before that.
    """
    waiting = sorted(((start, number, items) for number, (start, items) in enumerate(parts)), reverse=True)
    heap: list[tuple[int, int, Envelope]] = []
    begun: dict[int, Iterator[Envelope]] = {}
    while waiting or heap:
        while waiting and (not heap or waiting[-1][0] <= heap[0][0]):
            _, number, begun[number] = waiting.pop()
            _advance(heap, number, begun[number])
        if heap:
            _, number, envelope = heappop(heap)
            yield envelope
            _advance(heap, number, begun[number])


def _advance(heap: list[tuple[int, int, Envelope]], number: int, items: Iterator[Envelope]) -> None:
    envelope = next(items, None)
    if envelope is not None:
        heappush(heap, (envelope.stamp, number, envelope))
