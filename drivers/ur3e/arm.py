# ruff: noqa: N802 - names and extent are those of UR's RTDE as ur-rtde's clients spell them
"""What a skill may ask of an arm: the part of ur-rtde's control, receive and IO interfaces that this project uses.

Units and frames are UR's. A pose is (x, y, z [m], rx, ry, rz [rad]) of the TCP in the arm's `base` frame, with the
rotation as axis times angle; `base` is `base_link` turned by half a turn about z (see `frames`). A wrench is what the
surroundings do to the tool: pressing down on a table reads a positive z. One cycle is 2 ms, and a program that reads
and commands in a loop runs one pass each cycle between `initPeriod` and `waitPeriod`.

Blocking motions return once they are completed, True, or were ended by a protective stop, False. A safeguard stop only
makes them last longer. What the arm cannot do raises ArmError.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

NORMAL, PROTECTIVE_STOP, SAFEGUARD_STOP = 1, 3, 5  # safety modes, RTDE guide
EMERGENCY_STOP = 6  # likewise: that of the cell, not of the button on the robot's own pendant
RUNNING = 7  # robot mode, RTDE guide
GRIPPER_PIN = 0  # tool digital output that closes the gripper


class Arm(Protocol):
    """An arm under the names of ur-rtde."""

    def moveJ(
        self, q: Sequence[float], speed: float = 1.05, acceleration: float = 1.4, asynchronous: bool = False
    ) -> bool:
        """Move all joints together to `q` (6,) [rad]; the joint with the longest way has the speed [rad/s]."""
        ...

    def moveL(
        self, pose: Sequence[float], speed: float = 0.25, acceleration: float = 1.2, asynchronous: bool = False
    ) -> bool:
        """Move the TCP in a straight line to a pose."""
        ...

    def speedL(self, xd: Sequence[float], acceleration: float = 0.25, time: float = 0.0) -> bool:
        """Bring the TCP to a twist (6,) [m/s, rad/s], return at once and go on; for `time` [s] if that is not 0."""
        ...

    def speedStop(self, a: float = 10.0) -> bool:
        """End `speedL` with deceleration `a` [m/s2]; blocks until the arm stands."""
        ...

    def stopL(self, a: float = 10.0, asynchronous: bool = False) -> None:
        """Stop whatever moves with deceleration `a` [m/s2]."""
        ...

    def servoL(
        self, pose: Sequence[float], speed: float, acceleration: float, time: float, lookahead_time: float, gain: float
    ) -> bool:
        """Follow a pose that the caller renews every cycle; returns at once."""
        ...

    def servoStop(self, a: float = 10.0) -> bool:
        """End `servoL` with deceleration `a` [m/s2]; blocks until the arm stands."""
        ...

    def forceMode(
        self,
        task_frame: Sequence[float],
        selection_vector: Sequence[int],
        wrench: Sequence[float],
        type: int,  # noqa: A002
        limits: Sequence[float],
    ) -> bool:
        """Press with a wrench (6,) along the selected axes (6,) of the task frame; returns at once.

        `limits` (6,): highest speed [m/s, rad/s] along selected axes, largest deviation [m, rad] along the others.
        """
        ...

    def forceModeStop(self) -> bool:
        """End force mode; the arm holds where it is."""
        ...

    def zeroFtSensor(self) -> bool:
        """Call the wrench that is measured now zero."""
        ...

    def toolContact(self, direction: Sequence[float]) -> int:
        """Cycles since contact began for a tool that moves along `direction` (6,), 0 without contact; zeros: any."""
        ...

    def setTcp(self, tcp_offset: Sequence[float]) -> bool:
        """Put the TCP at a pose in the flange's frame."""
        ...

    def setPayload(self, mass: float, cog: Sequence[float]) -> bool:
        """Say what hangs on the flange: mass [kg] and its centre (3,) [m]."""
        ...

    def setToolDigitalOut(self, output_id: int, signal_level: bool) -> bool:
        """Switch an output at the tool; the gripper is on pin 0 and closes when it is on."""
        ...

    def initPeriod(self) -> Any:
        """Begin a control cycle; hand the result to `waitPeriod`."""
        ...

    def waitPeriod(self, t_cycle_start: Any) -> None:
        """End the control cycle."""
        ...

    def getActualQ(self) -> list[float]:
        """Joint angles (6,) [rad]."""
        ...

    def getActualQd(self) -> list[float]:
        """Joint speeds (6,) [rad/s]."""
        ...

    def getTargetQ(self) -> list[float]:
        """Commanded joint angles (6,) [rad]."""
        ...

    def getTargetQd(self) -> list[float]:
        """Commanded joint speeds (6,) [rad/s]."""
        ...

    def getActualTCPPose(self) -> list[float]:
        """Pose of the TCP."""
        ...

    def getTargetTCPPose(self) -> list[float]:
        """Commanded pose of the TCP."""
        ...

    def getActualTCPSpeed(self) -> list[float]:
        """Twist (6,) [m/s, rad/s] of the TCP."""
        ...

    def getActualTCPForce(self) -> list[float]:
        """Wrench (6,) [N, Nm] on the tool, at the TCP, in `base`; payload and zero corrected."""
        ...

    def getFtRawWrench(self) -> list[float]:
        """Wrench (6,) [N, Nm] as the sensor has it: at the flange, in its frame, nothing corrected."""
        ...

    def getJointTorques(self) -> list[float]:
        """Joint torques (6,) [Nm] without those that balance gravity."""
        ...

    def getSafetyMode(self) -> int:
        """1 normal, 3 protective stop, 5 safeguard stop, 6 emergency stop of the cell."""
        ...

    def getRobotMode(self) -> int:
        """7 while running; less without power or with the brakes on."""
        ...

    def getSpeedScaling(self) -> float:
        """Share of the programmed speed at which the arm moves, 0..1."""
        ...

    def getTimestamp(self) -> float:
        """Controller's time [s]."""
        ...

    def getInverseKinematics(self, x: Sequence[float], qnear: Sequence[float] | None = None) -> list[float]:
        """Joint angles (6,) [rad] for a pose, those nearest to `qnear` or to the present ones."""
        ...

    def getForwardKinematics(
        self, q: Sequence[float] | None = None, tcp_offset: Sequence[float] | None = None
    ) -> list[float]:
        """Pose of the TCP at joint angles `q`, the present ones by default."""
        ...

    def isSteady(self) -> bool:
        """Whether the arm stands still and nothing is commanded."""
        ...
