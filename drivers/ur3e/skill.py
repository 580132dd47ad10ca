"""The insertion skill: pick a part, peck at a hole, let go. Written against `Arm` alone, so a real arm does the same.

A peck puts the pin tips a millimetre above the board, zeroes the sensor, descends slowly, and stops at a contact force
or at the depth of a seated part. Which of the two it was is decided by the depth, not by the force.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from drivers.ur3e import frames
from drivers.ur3e.arm import GRIPPER_PIN, NORMAL, PROTECTIVE_STOP, SAFEGUARD_STOP, Arm
from drivers.ur3e.frames import Quaternion, Vector
from drivers.ur3e.parameters import CYCLE
from drivers.ur3e.workcell import Workcell
from runtime.cell import Board, Hole
from runtime.component import Component
from runtime.errors import ArmError
from runtime.messages import Outcome
from runtime.quantity import Acceleration, Duration, Force, Length, Positive, Speed

__all__ = ["InsertionSkill", "Peck", "SkillSettings", "Workcell"]

_NEAR = 5e-3  # [m] a candidate this close to the last one is gone to at approach height
_CAUTION = 10e-3  # [m] above a station, from where the way down is slow
_TURN_SPEED, _TURN_ACCELERATION = 2.0, 4.0  # [rad/s], [rad/s2] a third of what the wrist can do
_TURNED = 1e-3  # difference between rotations that is worth a turn
_STOP_DECELERATION = 2.0  # [m/s2] at the end of a descent: 5 mm/s are gone after 2 cycles
_GRACE = 1.0  # [s] a descent may take longer than its distance and speed say


@dataclass(frozen=True)
class SkillSettings:
    """How a peck is done."""

    contact_force: Annotated[Force, Positive] = 5.0  # [N] ends the descent; twice the sensor's noise sets off falsely
    contact_cycles: Annotated[int, Field(ge=1, le=50)] = 2  # running, so that one noisy sample does not end it
    descent_speed: Annotated[Speed, Positive] = 5e-3  # [m/s]
    descent_acceleration: Annotated[Acceleration, Positive] = 0.5  # [m/s2]
    retract_speed: Annotated[Speed, Positive] = 0.02  # [m/s]
    settle: Annotated[Duration, Positive] = 0.04  # [s] above the hole before the sensor is zeroed
    seated_share: Annotated[float, Field(gt=0.5, le=1.0)] = 0.9  # of the full depth at which a part counts as seated
    measure: Annotated[Duration, Positive] = 0.02  # [s] over which the wrench of a blocked contact is averaged
    gripper_time: Annotated[Duration, Positive] = 0.3  # [s] to open or to close
    depth_margin: Annotated[Length, Positive] = 0.05e-3  # [m] short of full depth at which the descent is told to end


@dataclass(frozen=True)
class Peck:
    """What one attempt felt."""

    outcome: Outcome
    reason: str
    tcp_position: Vector  # [m] base_link, at the end of the descent
    tcp_quaternion: Quaternion  # x, y, z, w
    wrench: tuple[float, ...]  # (6,) [N, Nm] on the part at the TCP in base_link, at the end of the descent
    depth: float  # [m] of the pin tips below the board's nominal top
    peak_force: float  # [N] upwards during the descent
    duration: float  # [s] from the start of the approach to the end of the retract


class InsertionSkill:
    """Does what the assembly asks of the arm. Every motion blocks; all but `peck` raise ArmError."""

    def __init__(
        self, arm: Arm, workcell: Workcell, board: Board, component: Component, settings: SkillSettings | None = None
    ) -> None:
        self._arm = arm
        self._cell = workcell
        self._board = board
        self._component = component
        self._settings = settings or SkillSettings()
        self._travel = max(board.z, workcell.feeder_z, workcell.reject_z) + workcell.clearance_height
        arm.setTcp([0.0, 0.0, workcell.gripper_reach + component.grip, 0.0, 0.0, 0.0])
        self._carry(False)

    def home(self) -> None:
        """Go up and then to the home configuration."""
        self._rise()
        if not self._arm.moveJ(self._cell.home):
            raise ArmError(f"stopped on the way home: {self._stopped()}")

    def pick(self) -> None:
        """Fetch a part from the feeder."""
        cell = self._cell
        self._grip(False)
        self._carry(False)
        self._travel_to(cell.feeder_x, cell.feeder_y, 0.0)
        self._lower_to(cell.feeder_x, cell.feeder_y, cell.feeder_z, 0.0)
        self._grip(True)
        self._carry(True)
        self._rise()

    def peck(self, hole: Hole, x: float, y: float) -> Peck:
        """Try to insert at `hole`, off by (x, y) [m] from nominal in base_link. A blocked part ends above the board."""
        arm = self._arm
        start = arm.getTimestamp()
        target_x, target_y = self._board.x + hole.x + x, self._board.y + hole.y + y
        yaw = hole.orientation or 0.0
        descent = _Descent()
        try:
            self._above(target_x, target_y, yaw)
            self._dwell(self._settings.settle)
            arm.zeroFtSensor()
            self._descend(descent)
            if descent.outcome is not Outcome.SEATED:
                self._retract(target_x, target_y, yaw)
        except ArmError as error:
            descent.outcome, descent.reason = Outcome.ABORTED, str(error)
            self._measure(descent)
        position, rotation = frames.ros_pose(descent.pose)
        return Peck(
            outcome=descent.outcome,
            reason=descent.reason,
            tcp_position=position,
            tcp_quaternion=frames.quaternion_of_rotation(rotation),
            wrench=tuple(frames.turn_base_wrench(descent.wrench)),
            depth=self._board.z - position[2],
            peak_force=descent.peak_force,
            duration=arm.getTimestamp() - start,
        )

    def release(self) -> None:
        """Let go of a seated part and go up."""
        self._grip(False)
        self._carry(False)
        self._rise()

    def discard(self) -> None:
        """Drop the part into the reject bin."""
        cell = self._cell
        self._travel_to(cell.reject_x, cell.reject_y, 0.0)
        self._lower_to(cell.reject_x, cell.reject_y, cell.reject_z, 0.0)
        self.release()

    def _descend(self, descent: _Descent) -> None:
        """Go down until contact or depth, stop, and judge."""
        arm, settings = self._arm, self._settings
        top, full = self._board.z, self._component.depth
        deepest = top - full + settings.depth_margin
        contacts = 0
        deadline = arm.getTimestamp() + (self._cell.approach_height + full) / settings.descent_speed + _GRACE
        arm.speedL([0.0, 0.0, -settings.descent_speed, 0.0, 0.0, 0.0], settings.descent_acceleration)
        expired = False
        while arm.getActualTCPPose()[2] > deepest and contacts < settings.contact_cycles and not expired:
            cycle = arm.initPeriod()
            arm.waitPeriod(cycle)
            force = arm.getActualTCPForce()[2]
            descent.peak_force = max(descent.peak_force, force)
            contacts = contacts + 1 if force > settings.contact_force else 0
            safety = arm.getSafetyMode()
            if safety == PROTECTIVE_STOP:
                self._measure(descent)
                raise ArmError(self._stopped())
            if safety != NORMAL or arm.getSpeedScaling() < 1.0:
                deadline += CYCLE
            expired = arm.getTimestamp() > deadline
        arm.speedStop(_STOP_DECELERATION)
        self._measure(descent)
        seated = top - descent.pose[2] >= settings.seated_share * full
        if seated:
            descent.outcome, descent.reason = Outcome.SEATED, ""
        elif contacts >= settings.contact_cycles:
            descent.outcome, descent.reason = Outcome.BLOCKED, ""
        else:
            descent.outcome, descent.reason = Outcome.ABORTED, "the descent met neither contact nor depth in its time"

    def _measure(self, descent: _Descent) -> None:
        """The pose, and the mean wrench over a moment of standing still."""
        arm = self._arm
        count = max(1, round(self._settings.measure / CYCLE))
        total = [0.0] * 6
        for _ in range(count):
            cycle = arm.initPeriod()
            arm.waitPeriod(cycle)
            total = [a + b for a, b in zip(total, arm.getActualTCPForce(), strict=True)]
        descent.wrench = [value / count for value in total]
        descent.pose = arm.getActualTCPPose()

    def _above(self, x: float, y: float, yaw: float) -> None:
        """To the approach height: straight across if the part is there already, else over the top."""
        height = self._board.z + self._cell.approach_height
        here, _ = frames.ros_pose(self._arm.getActualTCPPose())
        if math.hypot(here[0] - x, here[1] - y) > _NEAR or here[2] < self._board.z:
            self._travel_to(x, y, yaw)
            self._lower_to(x, y, height, yaw)
        else:
            self._go(x, y, height, yaw, self._cell.approach_speed)

    def _retract(self, x: float, y: float, yaw: float) -> None:
        self._go(x, y, self._board.z + self._cell.approach_height, yaw, self._settings.retract_speed)

    def _travel_to(self, x: float, y: float, yaw: float) -> None:
        """Up, turned on the spot, and across at the height at which nothing is in the way.

        The turn goes to the angles next to the home configuration, or half turns would add up in the wrist.
        """
        self._rise()
        here, rotation = frames.ros_pose(self._arm.getTargetTCPPose())
        down = frames.tool_down(yaw)
        if max(abs(a - b) for a, b in zip(rotation, down, strict=True)) > _TURNED:
            q = self._arm.getInverseKinematics(frames.ur_pose(here, down), self._cell.home)
            if not self._arm.moveJ(q, _TURN_SPEED, _TURN_ACCELERATION):
                raise ArmError(f"stopped while turning: {self._stopped()}")
        self._go(x, y, self._travel, yaw, self._cell.transfer_speed)

    def _lower_to(self, x: float, y: float, z: float, yaw: float) -> None:
        """Down from there, fast until a centimetre is left."""
        self._go(x, y, z + _CAUTION, yaw, self._cell.transfer_speed)
        self._go(x, y, z, yaw, self._cell.approach_speed)

    def _rise(self) -> None:
        """Straight up to the height at which nothing is in the way."""
        pose = self._arm.getTargetTCPPose()
        if pose[2] < self._travel - 1e-6:
            pose[2] = self._travel
            self._move(pose, self._cell.transfer_speed)

    def _go(self, x: float, y: float, z: float, yaw: float, speed: float) -> None:
        self._move(frames.ur_pose((x, y, z), frames.tool_down(yaw)), speed)

    def _move(self, pose: list[float], speed: float) -> None:
        if not self._arm.moveL(pose, speed, self._cell.acceleration):
            raise ArmError(f"stopped on the way: {self._stopped()}")

    def _stopped(self) -> str:
        return f"protective stop (safety mode {self._arm.getSafetyMode()})"

    def _dwell(self, duration: float) -> None:
        end = self._arm.getTimestamp() + duration - CYCLE / 2
        while self._arm.getTimestamp() < end:
            cycle = self._arm.initPeriod()
            self._arm.waitPeriod(cycle)

    def _grip(self, closed: bool) -> None:
        """Open or close the gripper; not while a safeguard stop lasts."""
        while self._arm.getSafetyMode() == SAFEGUARD_STOP:
            cycle = self._arm.initPeriod()
            self._arm.waitPeriod(cycle)
        self._arm.setToolDigitalOut(GRIPPER_PIN, closed)
        self._dwell(self._settings.gripper_time)

    def _carry(self, part: bool) -> None:
        """Tell the controller what hangs on the flange."""
        cell, component = self._cell, self._component
        mass, centre = cell.gripper_mass, (0.0, 0.0, cell.gripper_centre)
        if part:
            x, y, z = component.centre_of_mass
            whole = mass + component.mass
            share = component.mass / whole
            z += cell.gripper_reach + component.grip
            mass, centre = whole, (x * share, y * share, centre[2] * (1 - share) + z * share)
        self._arm.setPayload(mass, centre)


@dataclass
class _Descent:
    """A descent while it is under way."""

    outcome: Outcome = Outcome.ABORTED
    reason: str = "not begun"
    peak_force: float = 0.0  # [N]
    pose: list[float] | tuple[float, ...] = (0.0,) * 6  # (6,) UR's, base
    wrench: list[float] | tuple[float, ...] = (0.0,) * 6  # (6,) [N, Nm] base
