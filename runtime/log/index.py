"""What is where in an MCAP file: the index at its end, or one made by walking through an unfinished file."""

from __future__ import annotations

import contextlib
import struct
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.reader import SeekingReader
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Message,
    Metadata,
    MetadataIndex,
    Schema,
)
from mcap.stream_reader import StreamReader, breakup_chunk, get_chunk_data_stream
from mcap.summary import Summary
from mcap.writer import MCAP0_MAGIC
from zstandard import ZstdError

from runtime.errors import LogError

DAMAGE = (
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


@contextlib.contextmanager
def explained(path: Path) -> Iterator[None]:
    """Turn what goes wrong while a file is read into a LogError."""
    try:
        yield
    except (*DAMAGE, OSError) as error:
        raise LogError(f"{path} is damaged: {str(error) or type(error).__name__}") from None


@dataclass
class Contents:
    """What is where in a log."""

    summary: Summary
    counts: Counter[int] = field(default_factory=Counter)  # messages by channel
    start: int = 0  # [ns]
    end: int = 0
    sound: int = len(MCAP0_MAGIC)  # [byte] from the beginning that were found sound, where that was looked at


class IndexedReader(SeekingReader):
    """Reads by an index that was made elsewhere."""

    def __init__(self, file: IO[bytes], summary: Summary) -> None:
        file.seek(0)
        super().__init__(file, validate_crcs=True)
        self._index = summary

    def get_summary(self) -> Summary:
        """The index."""
        return self._index


def check_chunks(file: IO[bytes], summary: Summary) -> None:
    """Unpack every chunk of a file and compare its checksum; raises one of DAMAGE where that fails."""
    for index in summary.chunk_indexes:
        file.seek(index.chunk_start_offset + 9)  # behind the record's kind and length
        get_chunk_data_stream(Chunk.read(ReadDataStream(file)), validate_crc=True)


class _Whole:
    """A file that gives all the bytes asked for or says that it ends: the mcap package would go on with fewer."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file

    def read(self, length: int) -> bytes:
        data = self._file.read(length)
        if len(data) < length:
            raise EndOfFile
        return data


def contents_of(path: Path, file: IO[bytes]) -> tuple[Contents, bool]:
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
    if contents.sound == len(MCAP0_MAGIC):
        raise LogError(f"{path} was never finished and breaks off in its first record")
    return contents, ended


def _finished(file: IO[bytes]) -> Contents | None:
    """The index at the end of a log, if there is one that is sound."""
    file.seek(0)
    try:
        summary = SeekingReader(file).get_summary()
    except (*DAMAGE, OSError):
        return None
    if (
        summary is None
        or summary.statistics is None
        or not (summary.chunk_indexes or not summary.statistics.message_count)
    ):
        return None
    statistics = summary.statistics
    counts = Counter(dict(statistics.channel_message_counts))
    return Contents(summary, counts, statistics.message_start_time, statistics.message_end_time)


def _scan(file: IO[bytes]) -> tuple[Contents, bool]:
    """Walk through a log from the front as far as it is sound; whether its end was reached."""
    contents = Contents(Summary())
    file.seek(0)
    stream = StreamReader(_Whole(file), emit_chunks=True)  # type: ignore[arg-type]
    offset = len(MCAP0_MAGIC)
    try:
        for record in stream.records:
            _take(contents, record, offset, file.tell() - offset)
            contents.sound = offset = file.tell()
        return contents, True
    except DAMAGE:  # what follows was not written or is damaged
        pass
    return contents, False


def records_of(file: IO[bytes]) -> Iterator[tuple[Any, int]]:
    """Records of the data section in the order in which they were written, those in chunks one by one, as far as sound.

    Each comes with the number of bytes of the file that it ends in or its chunk ends in.
    """
    file.seek(0)
    stream = StreamReader(_Whole(file), emit_chunks=True)  # type: ignore[arg-type]
    with contextlib.suppress(*DAMAGE):
        for record in stream.records:
            if isinstance(record, DataEnd):
                return
            offset = file.tell()
            if isinstance(record, Chunk):
                for inner in breakup_chunk(record, validate_crc=True):
                    yield inner, offset
            else:
                yield record, offset


def _take(contents: Contents, record: Any, offset: int, length: int) -> None:
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
