"""What curtain, buttons, interlock and arm say to each other about safety."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum
from typing import ClassVar

from runtime.declaration import Bool, Seconds, Text, UInt8, UInt64, message
from runtime.messages.ros import Header, Time, stamp_of


class SafetyState(IntEnum):
    """State of the interlock (names after IEC 61496-1 and IEC 60204-1)."""

    LOCKED = 0  # restart interlock: the field is clear, a reset is awaited
    PERMITTED = 1  # motion is allowed
    TRIPPED = 2  # the light field is interrupted, or nothing is heard of it
    FAULT = 3  # the curtain or its wiring cannot be trusted: the channels disagree, or one shows no test pulses
    MUTED = 4  # motion is allowed while the light curtain is set aside
    EMERGENCY_STOP = 5  # an emergency stop is pressed


class ResetEdge(IntEnum):
    """What happened to the reset button."""

    PRESSED_AND_RELEASED = 0  # both, in proper time: from a button that only exists in software
    PRESSED = 1
    RELEASED = 2


@message
@dataclass(frozen=True, slots=True)
class Ossd:
    """The light curtain's two output signal switching devices (IEC 61496-1).

    An off pulse that is shorter than the interlock's filter time is a test. Off times are in ns: the length so far of
    the pulse that the channel is in, or the longest since the message before; 0 without one. A channel that is off
    without an off time is off.
    """

    header: Header
    channel_1: Bool  # on: the field is clear
    channel_2: Bool
    valid_until: Time  # the curtain vouches for this state, and for its test pulses, up to here
    channel_1_off_time: UInt64 = 0
    channel_2_off_time: UInt64 = 0
    channel_1_tested: Time = field(default_factory=lambda: stamp_of(0))  # last seen off, in a test pulse or otherwise
    channel_2_tested: Time = field(default_factory=lambda: stamp_of(0))

    __msgtype__: ClassVar[str]


@message
@dataclass(frozen=True, slots=True)
class Reset:
    """The reset button was pressed, released, or both."""

    header: Header
    source: Text
    edge: UInt8 = ResetEdge.PRESSED_AND_RELEASED  # a ResetEdge

    __msgtype__: ClassVar[str]


@message
@dataclass(frozen=True, slots=True)
class EmergencyStop:
    """An emergency stop device was pressed or released (IEC 60204-1)."""

    header: Header
    device: Text  # which of them
    pressed: Bool

    __msgtype__: ClassVar[str]


@message
@dataclass(frozen=True, slots=True)
class Muting:
    """The two muting sensors (IEC 61496-1, IEC 62046)."""

    header: Header
    sensor_1: Bool  # actuated
    sensor_2: Bool

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
    ossd: UInt64 = 0  # OSSD messages that the interlock had heard when it decided
    resets: UInt64 = 0  # and resets: the order of both, which no two publishers promise
    emergency_stops: UInt64 = 0  # likewise
    mutings: UInt64 = 0  # likewise
    stop_category: UInt8 = 2  # after IEC 60204-1, of the stop that a refusal or the end of this word asks for
    session: Text = ""  # in which it holds; empty in logs that are older than this field
    seal: Text = ""  # of who holds the session's key; see runtime.safety.permit_seal

    __msgtype__: ClassVar[str]


@message
@dataclass(frozen=True, slots=True)
class CurtainCommand:
    """What somebody does to the simulated light curtain of a running cell."""

    action: Text  # break, clear, reset (press and release the button), or state: only look

    __msgtype__: ClassVar[str]


@message
@dataclass(frozen=True, slots=True)
class CurtainState:
    """How the simulated light curtain is after a command, and whether it did as it was told."""

    ok: Bool
    error: Text  # what was wrong with the command; empty if it was carried out
    interrupted: Bool  # the light field, by a command or by the cell file's script
    held: Bool  # it stays interrupted until a command clears it
    channel_1: Bool  # on
    channel_2: Bool
    time: Seconds  # session time that the curtain knows of
    heard: Seconds  # of the machine's monotonic clock, when the command was taken: for who measures on this machine

    __msgtype__: ClassVar[str]
