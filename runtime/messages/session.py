"""What is said about the session itself."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import ClassVar

from runtime.declaration import Text, UInt8, UInt64, message
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
