"""Where things stand in the cell, and how fast the arm may go there."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from drivers.ur3e.parameters import GRIPPER
from runtime.quantity import Acceleration, Angle, Length, Mass, Positive, Speed

_Joints = tuple[Angle, Angle, Angle, Angle, Angle, Angle]


@dataclass(frozen=True)
class Workcell:
    """Stations and transfer motions; positions of the pin tips in base_link."""

    feeder_x: Length = 0.30  # [m] where the feeder presents a part, pins down
    feeder_y: Length = -0.20  # [m]
    feeder_z: Length = 0.06  # [m] of its pin tips
    reject_x: Length = 0.26  # [m] above the bin for parts that went in nowhere
    reject_y: Length = 0.22  # [m]
    reject_z: Length = 0.10  # [m]
    home: _Joints = (
        math.radians(-24.0),
        math.radians(-96.0),
        math.radians(108.0),
        math.radians(-102.0),
        math.radians(-90.0),
        math.radians(-114.0),
    )  # [rad] tool down, between feeder and board
    clearance_height: Annotated[Length, Positive] = 0.06  # [m] of the pin tips above a station during transfers
    approach_height: Annotated[Length, Positive] = 1e-3  # [m] of the pin tips above the board before a descent
    transfer_speed: Annotated[Speed, Positive] = 0.25  # [m/s] with clearance below
    approach_speed: Annotated[Speed, Positive] = 0.05  # [m/s] near the board and the feeder
    acceleration: Annotated[Acceleration, Positive] = 0.8  # [m/s2]
    gripper_mass: Annotated[Mass, Positive] = GRIPPER.mass  # [kg]
    gripper_centre: Length = GRIPPER.centre_of_mass[2]  # [m] of its mass, from the flange along the tool
    gripper_reach: Annotated[Length, Positive] = GRIPPER.reach  # [m] from the flange to the tips of the fingers
