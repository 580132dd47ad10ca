"""Every message type, declared once and statically typed; `runtime.declaration` says how.

ROS types come from `rosbags`; `palpate_msgs` holds only what ROS has no type for. Lengths are metres, angles radians,
forces newtons, torques newton metres, times seconds. Positions on a board are offsets from the nominal hole, in the
frame of the cell's base (`base_link`), because the robot knows no other.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cache
from typing import ClassVar

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore
from rosbags.typesys.stores import ros2_jazzy as ros

from runtime.declaration import (
    Bool,
    Metres,
    Newtons,
    Number,
    Numbers,
    Radians,
    Seconds,
    SquareMetres,
    Text,
    UInt8,
    UInt32,
    UInt64,
    declared,
    definition,
    message,
)

Time = ros.builtin_interfaces__msg__Time
Header = ros.std_msgs__msg__Header
String = ros.std_msgs__msg__String
Clock = ros.rosgraph_msgs__msg__Clock
Log = ros.rcl_interfaces__msg__Log
JointState = ros.sensor_msgs__msg__JointState
Vector3 = ros.geometry_msgs__msg__Vector3
Point = ros.geometry_msgs__msg__Point
Quaternion = ros.geometry_msgs__msg__Quaternion
Pose = ros.geometry_msgs__msg__Pose
PoseStamped = ros.geometry_msgs__msg__PoseStamped
Wrench = ros.geometry_msgs__msg__Wrench
WrenchStamped = ros.geometry_msgs__msg__WrenchStamped
Transform = ros.geometry_msgs__msg__Transform
TransformStamped = ros.geometry_msgs__msg__TransformStamped
TFMessage = ros.tf2_msgs__msg__TFMessage

NANOSECONDS = 1_000_000_000
BASE_FRAME = "base_link"


class Outcome(IntEnum):
    """How an attempt ended."""

    SEATED = 1  # the pins reached their depth
    BLOCKED = 2  # contact before that depth
    ABORTED = 3  # neither: stopped, out of reach, or an error; the reason says which


class Ending(IntEnum):
    """How a search ended."""

    INSERTED = 1
    EXHAUSTED = 2  # the budget or the strategy's pattern ran out
    ABORTED = 3


class SafetyState(IntEnum):
    """State of the interlock (names after IEC 61496-1)."""

    LOCKED = 0  # restart interlock: the field is clear, a reset is awaited
    PERMITTED = 1  # motion is allowed
    TRIPPED = 2  # the light field is interrupted
    FAULT = 3  # the two channels disagree for longer than the discrepancy time


class Phase(IntEnum):
    """Phase of a session."""

    STARTING = 0
    RUNNING = 1
    DONE = 2
    CLOSING = 3
    FAILED = 4


@message
@dataclass(frozen=True, slots=True)
class Gaussian:
    """A two-dimensional normal distribution of a hole's offset from its nominal position, base_link frame."""

    x: Metres = 0.0
    y: Metres = 0.0
    xx: SquareMetres = math.nan  # not a number: no distribution is claimed
    xy: SquareMetres = math.nan
    yy: SquareMetres = math.nan

    __msgtype__: ClassVar[str]

    @property
    def known(self) -> bool:
        """Whether a covariance is claimed."""
        return not math.isnan(self.xx)


@message
@dataclass(frozen=True, slots=True)
class Seat:
    """Where one part went in: one piece of evidence about the holes of a board type."""

    session: Text  # session that found it
    board: UInt32  # number of the board within that session, from 1
    hole: Text
    x: Metres  # the candidate that succeeded
    y: Metres
    seated_x: Metres  # the TCP once the part was seated, as the robot reads it
    seated_y: Metres
    slid: Bool = False  # whether the pins dropped in on the way of a slide

    __msgtype__: ClassVar[str]


@message
@dataclass(frozen=True, slots=True)
class Waypoint:
    """A point that slid pins pass: offset from the nominal hole, base_link frame."""

    x: Metres
    y: Metres

    __msgtype__: ClassVar[str]


@message
@dataclass(frozen=True, slots=True)
class Miss:
    """One attempt of an earlier search that was blocked: where that hole was not."""

    board: UInt32
    hole: Text
    path: list[Waypoint]  # one point: a peck; more: a slide along them

    __msgtype__: ClassVar[str]


@message
@dataclass(frozen=True, slots=True)
class Place:
    """Where a hole is according to the drawing: nominal position, base_link frame."""

    hole: Text
    x: Metres
    y: Metres

    __msgtype__: ClassVar[str]


@message
@dataclass(frozen=True, slots=True)
class SearchGoal:
    """Find one hole for one part. All that a strategy may know."""

    header: Header
    search: UInt32  # number of the search within the session, from 1
    board: UInt32  # number of the board, from 1
    hole: Text
    component: Text
    nominal: Pose  # TCP (pin tips) at the top of the nominal hole, base_link frame
    feasible_radius: Metres  # radius of the disc with the area in which the part goes in
    search_radius: Metres  # the hole is expected within this distance of nominal
    max_attempts: UInt32
    seed: UInt64  # for strategies that draw random numbers
    prior: Gaussian  # the posterior store's belief about this hole; a wide one if nothing is known
    seats: list[Seat]  # every earlier insertion into boards of this type, oldest first
    misses: list[Miss] = field(default_factory=list)  # every attempt of earlier searches that was blocked
    layout: list[Place] = field(default_factory=list)  # every hole of the board, this one included

    __msgtype__: ClassVar[str]


@message
@dataclass(frozen=True, slots=True)
class Proposal:
    """The next position to try, or the next path to slide along: what a strategy yields."""

    x: Metres  # where the pins first touch the board
    y: Metres
    probability: Number = math.nan  # of success, as the strategy sees it
    belief: Gaussian = field(default_factory=Gaussian)  # what the strategy believes at this moment
    path: list[Waypoint] = field(default_factory=list)  # to slide along from (x, y) under light force; none: a peck

    __msgtype__: ClassVar[str]


@message
@dataclass(frozen=True, slots=True)
class Candidate:
    """A strategy's next position to try, or word that it has none left."""

    header: Header
    search: UInt32
    number: UInt32  # of the attempt within its search, from 1
    exhausted: Bool  # no further position: the search is over without a find
    reason: Text  # why it is exhausted
    proposal: Proposal

    __msgtype__: ClassVar[str]


@message
@dataclass(frozen=True, slots=True)
class Attempt:
    """What the arm felt at one candidate: a peck, or a slide if it had a path."""

    header: Header
    search: UInt32
    number: UInt32  # within the search, from 1
    board: UInt32
    hole: Text
    x: Metres  # commanded offset from nominal where it ended: of a seated part, where the pins dropped in
    y: Metres
    outcome: UInt8  # an Outcome
    reason: Text
    pose: Pose  # TCP at the end of the descent, base_link frame
    wrench: Wrench  # on the part at the TCP at the end of the descent, base_link frame
    depth: Metres  # of the pin tips below the board's nominal top
    peak_force: Newtons
    duration: Seconds  # from above the first place, or from where the attempt before ended, to the end of the retract
    path: list[Waypoint] = field(default_factory=list)  # commanded: first touch and the points slid along; none: a peck

    __msgtype__: ClassVar[str]


@message
@dataclass(frozen=True, slots=True)
class SearchResult:
    """How the search for one hole ended."""

    header: Header
    search: UInt32
    board: UInt32
    hole: Text
    component: Text
    ending: UInt8  # an Ending
    reason: Text
    attempts: UInt32
    x: Metres  # the candidate that succeeded; not a number if none did
    y: Metres
    seated_x: Metres
    seated_y: Metres
    duration: Seconds  # from goal to seated part or to giving up

    __msgtype__: ClassVar[str]


@message
@dataclass(frozen=True, slots=True)
class BeliefRequest:
    """Ask the posterior store what is known about a hole."""

    hole: Text
    board: UInt32  # number of the board under work; 0 if none is yet
    after_search: UInt32  # answer once this search's result is stored; 0 asks at once

    __msgtype__: ClassVar[str]


@message
@dataclass(frozen=True, slots=True)
class Belief:
    """What the posterior store knows about one hole of a board type."""

    header: Header
    board_type: Text
    hole: Text
    count: UInt32  # insertions the distribution rests on
    distribution: Gaussian
    seats: list[Seat]  # of all holes of the board type, oldest first
    misses: list[Miss] = field(default_factory=list)  # every blocked attempt, oldest first

    __msgtype__: ClassVar[str]


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


@message
@dataclass(frozen=True, slots=True)
class ArmStatus:
    """State of the arm's controller. Numbers as in UR's RTDE guide."""

    header: Header
    robot_mode: UInt8  # 7: running
    safety_mode: UInt8  # 1: normal, 3: protective stop, 5: safeguard stop
    speed_scaling: Number  # 0..1, 0 while stopped
    activity: Text  # what the arm is doing, in words
    holding: Text  # component in the gripper, empty if none

    __msgtype__: ClassVar[str]


@message
@dataclass(frozen=True, slots=True, eq=False)
class ControlTrace:
    """Every control cycle of a stretch of session time, row by row; the header has the time after the first one."""

    header: Header
    period: Seconds  # from cycle to cycle
    position: Numbers  # (cycles x 6) [rad] measured joint angles
    target: Numbers  # (cycles x 6) [rad] commanded joint angles
    wrench: Numbers  # (cycles x 6) [N, Nm] on the tool at the flange, frame tool0, payload compensated

    __msgtype__: ClassVar[str]


@message
@dataclass(frozen=True, slots=True)
class Truth:
    """Where hole and pins really are: simulation only, recorded, hidden from everything that decides."""

    header: Header
    search: UInt32
    board: UInt32
    hole: Text
    hole_x: Metres  # offset of the hole from nominal
    hole_y: Metres
    hole_yaw: Radians
    pin_x: Metres  # offset of the pins from the TCP
    pin_y: Metres
    pin_yaw: Radians
    offset_x: Metres  # where the TCP must go: hole minus pins
    offset_y: Metres

    __msgtype__: ClassVar[str]


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


def slid_in(attempt: Attempt) -> bool:
    """Whether the pins dropped in on the way of a slide, not where they first touched the board."""
    if not attempt.path or attempt.outcome != Outcome.SEATED:
        return False
    first = attempt.path[0]
    return math.hypot(attempt.x - first.x, attempt.y - first.y) > 1e-9


def stamp_of(nanoseconds: int) -> Time:
    """Session time [ns] as a ROS time."""
    return Time(sec=nanoseconds // NANOSECONDS, nanosec=nanoseconds % NANOSECONDS)


def nanoseconds_of(stamp: Time) -> int:
    """ROS time as session time [ns]."""
    return stamp.sec * NANOSECONDS + stamp.nanosec


def header(nanoseconds: int, frame: str = "") -> Header:
    """Header with a session time [ns] and a frame."""
    return Header(stamp=stamp_of(nanoseconds), frame_id=frame)


@cache
def typestore() -> Typestore:
    """ROS 2 Jazzy's types and palpate's own, which decode to the classes of this module."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, cls in declared().items():
        store.register(get_types_from_msg(definition(cls), name))
        store.types[name] = cls
    return store
