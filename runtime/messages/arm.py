"""What the arm says of itself where ROS has no type for it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from runtime.declaration import Metres, Number, Numbers, Radians, Seconds, Text, UInt8, UInt32, message
from runtime.messages.ros import Header


@message
@dataclass(frozen=True, slots=True)
class ArmStatus:
    """State of the arm's controller. Numbers as in UR's RTDE guide."""

    header: Header
    robot_mode: UInt8  # 3: without power, 4: powering on, 5: brakes on, 7: running
    safety_mode: UInt8  # 1: normal, 3: protective stop, 5: safeguard stop, 6: emergency stop of the cell
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
