"""What is said about the session itself."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import ClassVar

from runtime.declaration import Bool, Number, Seconds, Text, UInt8, UInt64, message
from runtime.messages.ros import Header


class Phase(IntEnum):
    """Phase of a session."""

    STARTING = 0
    RUNNING = 1
    DONE = 2
    CLOSING = 3
    FAILED = 4


@message
@dataclass(frozen=True, slots=True)
class SessionState:
    """Phase of the session; latched."""

    header: Header
    session: Text
    phase: UInt8  # a Phase
    text: Text

    __msgtype__: ClassVar[str]


@message
@dataclass(frozen=True, slots=True)
class PublisherCount:
    """How many messages one publisher has sent on one topic: the last word of a plugin that closes."""

    topic: Text
    sent: UInt64

    __msgtype__: ClassVar[str]


@message
@dataclass(frozen=True, slots=True)
class PublisherCounts:
    """All publishers of a closing plugin."""

    header: Header
    plugin: Text
    counts: list[PublisherCount]

    __msgtype__: ClassVar[str]


@message
@dataclass(frozen=True, slots=True)
class PlayerCommand:
    """What a player of a log is to do, and by how much."""

    action: Text  # one of runtime.playback.state.ACTIONS
    value: Number  # seek, skip: [s]; rate: times the recorded speed, inf for max; scale: a factor; step: messages

    __msgtype__: ClassVar[str]


@message
@dataclass(frozen=True, slots=True)
class PlayerState:
    """How far a player is, and whether it did as it was told."""

    ok: Bool
    error: Text  # what was wrong with the command; empty if it was carried out
    paused: Bool
    time: Seconds  # session time since the beginning of the log
    duration: Seconds  # of the log
    rate: Number  # times the recorded speed; inf for as fast as receivers take it
    sent: UInt64  # messages

    __msgtype__: ClassVar[str]


@message
@dataclass(frozen=True, slots=True)
class SnapshotRequest:
    """Write down now what the recorder keeps in memory."""

    reason: Text  # why, for whoever reads the file; may be empty

    __msgtype__: ClassVar[str]


@message
@dataclass(frozen=True, slots=True)
class SnapshotReply:
    """What became of the request."""

    path: Text  # absolute path of the file; empty if none was written
    messages: UInt64  # in the file
    error: Text  # why no file was written; empty if one was

    __msgtype__: ClassVar[str]
