"""What curtain, interlock and arm say to each other about safety."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import ClassVar

from runtime.declaration import Bool, Text, UInt8, message
from runtime.messages.ros import Header, Time


class SafetyState(IntEnum):
    """State of the interlock (names after IEC 61496-1)."""

    LOCKED = 0  # restart interlock: the field is clear, a reset is awaited
    PERMITTED = 1  # motion is allowed
    TRIPPED = 2  # the light field is interrupted
    FAULT = 3  # the two channels disagree for longer than the discrepancy time


@message
@dataclass(frozen=True, slots=True)
class Ossd:
    """The light curtain's two output signal switching devices (IEC 61496-1)."""

    header: Header
    channel_1: Bool  # on: the field is clear
    channel_2: Bool
    valid_until: Time  # the curtain vouches for this state up to here

    __msgtype__: ClassVar[str]


@message
@dataclass(frozen=True, slots=True)
class Reset:
    """The restart button was pressed and released."""

    header: Header
    source: Text

    __msgtype__: ClassVar[str]


@message
@dataclass(frozen=True, slots=True)
class Permit:
    """The interlock's word on motion. Without one for the present moment the arm stands still."""

    header: Header
    granted: Bool
    state: UInt8  # a SafetyState
    reason: Text
    valid_until: Time  # the word holds from the header's stamp up to here

    __msgtype__: ClassVar[str]
