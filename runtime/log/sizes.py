"""How many bytes of a log each topic takes, told from the index: only a few chunks are unpacked."""

from __future__ import annotations

import io
from collections import Counter
from pathlib import Path
from typing import IO

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Chunk, ChunkIndex, Message
from mcap.stream_reader import breakup_chunk
from mcap.summary import Summary
from numpy.typing import NDArray

from runtime.log.index import DAMAGE
from runtime.log.part import type_of

_RECORD_HEADER = 1 + 8  # [byte] opcode and length
_MESSAGE_HEADER = _RECORD_HEADER + 2 + 4 + 8 + 8  # [byte] channel, sequence, two times
_ENTRY = np.dtype([("time", "<u8"), ("offset", "<u8")])


def payload_bytes(path: Path) -> Counter[tuple[str, str]] | None:
    """Bytes of messages, unpacked, by topic and type; None if the file has no index to tell them from.

    Exact for files whose writer defines a channel once, before its first message.
    """
    try:
        with path.open("rb") as file:
            summary = SeekingReader(file).get_summary()
            if summary is None or not summary.chunk_indexes:
                return None
            sizes: Counter[int] = Counter()
            defined: set[int] = set()  # channels that an earlier chunk defines
            for chunk in sorted(summary.chunk_indexes, key=lambda item: item.chunk_start_offset):
                if not chunk.message_index_offsets:
                    return None
                if defined.issuperset(chunk.message_index_offsets):
                    sizes.update(_by_gaps(file, chunk))
                else:
                    defined.update(chunk.message_index_offsets)
                    sizes.update(_unpacked(file, chunk))
            return _by_topic(sizes, summary)
    except (*DAMAGE, OSError):
        return None


def _by_topic(sizes: Counter[int], summary: Summary) -> Counter[tuple[str, str]]:
    found: Counter[tuple[str, str]] = Counter()
    for number, size in sizes.items():
        channel = summary.channels[number]
        found[channel.topic, type_of(channel, summary.schemas.get(channel.schema_id))] += size
    return found


def _by_gaps(file: IO[bytes], chunk: ChunkIndex) -> Counter[int]:
    """Bytes by channel, from where each message begins and the next one does."""
    file.seek(chunk.chunk_start_offset + chunk.chunk_length)
    data = file.read(chunk.message_index_length)
    offsets: list[NDArray[np.uint64]] = []
    channels: list[int] = []
    place = 0
    while place < len(data):
        length = int.from_bytes(data[place + 1 : place + 9], "little")
        body = place + _RECORD_HEADER
        if data[place] == Opcode.MESSAGE_INDEX:
            size = int.from_bytes(data[body + 2 : body + 6], "little")
            entries = np.frombuffer(data, _ENTRY, size // _ENTRY.itemsize, body + 6)
            offsets.append(entries["offset"])
            channels += [int.from_bytes(data[body : body + 2], "little")] * len(entries)
        place = body + length
    begin = np.concatenate(offsets)
    order = np.argsort(begin)
    gaps = np.diff(begin[order], append=np.uint64(chunk.uncompressed_size)) - np.uint64(_MESSAGE_HEADER)
    owners = np.array(channels)[order]
    return Counter({int(number): int(gaps[owners == number].sum()) for number in np.unique(owners)})


def _unpacked(file: IO[bytes], chunk: ChunkIndex) -> Counter[int]:
    """Bytes by channel of a chunk that holds definitions too."""
    file.seek(chunk.chunk_start_offset + _RECORD_HEADER)
    record = Chunk.read(ReadDataStream(io.BytesIO(file.read(chunk.chunk_length - _RECORD_HEADER))))
    found: Counter[int] = Counter()
    for inner in breakup_chunk(record):
        if isinstance(inner, Message):
            found[inner.channel_id] += len(inner.data)
    return found
