"""What the state packages of all ports are made of: the part of a control box that they read."""

from __future__ import annotations

import datetime
import math
from collections.abc import Sequence
from typing import Protocol

from drivers.ur3e.control_box.modes import JointMode, RobotMode, RuntimeState, SafetyMode
from drivers.ur3e.control_box.registers import Wiring
from drivers.ur3e.control_box.version import PolyScope
from drivers.ur3e.parameters import JOINTS
from drivers.ur3e.simulated_arm import SimulatedArm

BUILD_DATE = datetime.datetime(2025, 1, 15, 9, 0, 0)  # assumed: of the controller's software
EMERGENCY_STOPS = (SafetyMode.SYSTEM_EMERGENCY_STOP, SafetyMode.ROBOT_EMERGENCY_STOP)

# Denavit and Hartenberg's parameters (6,) as UR defines them, from the joints' origins.
DH_A = (0.0, JOINTS[2].origin[0], JOINTS[3].origin[0], 0.0, 0.0, 0.0)  # [m]
DH_D = (JOINTS[0].origin[2], 0.0, 0.0, JOINTS[3].origin[2], -JOINTS[4].origin[1], JOINTS[5].origin[1])  # [m]
DH_ALPHA = (math.pi / 2, 0.0, 0.0, math.pi / 2, -math.pi / 2, 0.0)  # [rad]
DH_THETA = (0.0,) * 6  # [rad]


class Electrics(Protocol):
    """Currents, voltages and temperatures."""

    @property
    def joint_current(self) -> Sequence[float]:
        """(6,) [A] measured."""
        ...

    @property
    def target_current(self) -> Sequence[float]:
        """(6,) [A] wanted."""
        ...

    @property
    def target_moment(self) -> Sequence[float]:
        """(6,) [Nm] wanted at the joints."""
        ...

    @property
    def joint_temperature(self) -> Sequence[float]:
        """(6,) [C]."""
        ...

    @property
    def joint_voltage(self) -> Sequence[float]:
        """(6,) [V]."""
        ...

    @property
    def main_voltage(self) -> float:
        """[V] of the safety control board."""
        ...

    @property
    def robot_voltage(self) -> float:
        """[V] of the 48 V supply."""
        ...

    @property
    def robot_current(self) -> float:
        """[A] that the arm draws."""
        ...

    @property
    def io_current(self) -> float:
        """[A] that inputs and outputs draw."""
        ...

    @property
    def momentum(self) -> float:
        """[kg m/s] norm of the arm's linear momentum."""
        ...

    @property
    def tool_temperature(self) -> float:
        """[C]."""
        ...

    @property
    def tool_current(self) -> float:
        """[A] that the tool draws."""
        ...

    @property
    def tool_acceleration(self) -> Sequence[float]:
        """(3,) [m/s2] that the accelerometer in the tool measures, gravity included."""
        ...


class ControllerState(Protocol):
    """A control box as state packages read it."""

    @property
    def version(self) -> PolyScope:
        """The software."""
        ...

    @property
    def arm(self) -> SimulatedArm:
        """The arm."""
        ...

    @property
    def electrics(self) -> Electrics:
        """Currents, voltages and temperatures."""
        ...

    @property
    def wiring(self) -> Wiring:
        """Inputs and outputs."""
        ...

    @property
    def robot_mode(self) -> RobotMode:
        """What the arm is able to do."""
        ...

    @property
    def safety_mode(self) -> SafetyMode:
        """Why it may or may not move."""
        ...

    @property
    def runtime_state(self) -> RuntimeState:
        """What the program is doing."""
        ...

    @property
    def payload_inertia(self) -> Sequence[float]:
        """(6,) [kg m^2] as told: xx, yy, zz, xy, xz, yz."""
        ...

    @property
    def speed_slider(self) -> float:
        """0..1 as set."""
        ...

    @property
    def speed_scaling(self) -> float:
        """0..1 at which the trajectory goes on at present."""
        ...

    @property
    def teaching(self) -> bool:
        """Whether freedrive is on."""
        ...

    @property
    def time(self) -> float:
        """[s] of the controller's clock."""
        ...

    @property
    def execution_time(self) -> float:
        """[s] that the last cycle took."""
        ...


def joint_mode(mode: RobotMode) -> JointMode:
    """The mode of each joint when the arm is in a mode."""
    if mode is RobotMode.RUNNING:
        return JointMode.RUNNING
    if mode is RobotMode.BACKDRIVE:
        return JointMode.BACKDRIVE
    return JointMode.IDLE if mode in (RobotMode.POWER_ON, RobotMode.IDLE) else JointMode.POWER_OFF
