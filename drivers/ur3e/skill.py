"""The insertion skill: pick a part, peck at a hole or slide over it, let go. Written against `Arm` alone, so a real arm
does the same.

A peck puts the pin tips a millimetre above the board, zeroes the sensor, descends slowly, and stops at a contact force
or at the depth of a seated part. Which of the two it was is decided by the depth, not by the force. A slide begins in
the same way, and after contact goes on along a path; see `slide`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from drivers.ur3e import frames
from drivers.ur3e.arm import EMERGENCY_STOP, GRIPPER_PIN, SAFEGUARD_STOP, Arm
from drivers.ur3e.parameters import CYCLE
from drivers.ur3e.slide import Polyline, Slide
from drivers.ur3e.touch import Felt, SkillSettings, Touch, jammed, stopped
from drivers.ur3e.workcell import Workcell
from runtime.cell import Board, Hole
from runtime.component import Component
from runtime.errors import ArmError
from runtime.messages import Outcome

__all__ = ["Felt", "InsertionSkill", "SkillSettings", "Workcell"]

_NEAR = 5e-3  # [m] a candidate this close to the last one is gone to at approach height
_CAUTION = 10e-3  # [m] above a station, from where the way down is slow
_TURN_SPEED, _TURN_ACCELERATION = 2.0, 4.0  # [rad/s], [rad/s2] a third of what the wrist can do
_TURNED = 1e-3  # difference between rotations that is worth a turn
_GRACE = 1.0  # [s] a descent may take longer than its distance and speed say


class InsertionSkill:
    """Does what the assembly asks of the arm. Every motion blocks; all but `peck` and `slide` raise ArmError."""

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
            raise ArmError(f"stopped on the way home: {stopped(self._arm)}")

    def lift(self) -> None:
        """Straight up from wherever the arm stands, slowly, to the height at which nothing is in the way."""
        pose = self._arm.getActualTCPPose()
        pose[2] = max(pose[2], self._travel)
        self._move(pose, self._settings.retract_speed)

    def let_go(self) -> None:
        """Open the gripper, which has no part, and go home."""
        self._grip(False)
        self._carry(False)
        self.home()

    def jammed(self, felt: Felt) -> bool:
        """Whether a part that is not seated had its pins in the holes."""
        return jammed(felt, self._component, self._settings)

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

    def peck(self, hole: Hole, x: float, y: float) -> Felt:
        """Try to insert at `hole`, off by (x, y) [m] from nominal in base_link. A blocked part ends above the board."""
        return self._attempt(hole, Polyline([(x, y)]))

    def slide(self, hole: Hole, path: Sequence[tuple[float, float]]) -> Felt:
        """Try to insert at `hole` along a path of offsets (x, y) [m] from nominal in base_link, one point or more.

        Begins as a peck at the first point; pins that meet the board there slide on until they drop in. A blocked part
        ends above the board. Raises InputError for a path without points.
        """
        return self._attempt(hole, Polyline(path))

    def _attempt(self, hole: Hole, path: Polyline) -> Felt:
        nominal = (self._board.x + hole.x, self._board.y + hole.y)
        yaw = hole.orientation or 0.0
        x, y = path.points[0]
        touch = Touch(self._arm, self._settings, x, y, self._board.z, self._component.depth)
        try:
            if self._above(nominal[0] + x, nominal[1] + y, yaw):
                touch.begin()
            self._dwell(self._settings.settle)
            self._arm.zeroFtSensor()
            self._descend(touch)
            if touch.outcome is Outcome.BLOCKED and path.length > 0:
                Slide(self._arm, self._settings, touch, nominal, path).run()
            if touch.outcome is not Outcome.SEATED:
                self._retract(nominal[0] + touch.x, nominal[1] + touch.y, yaw)
        except ArmError as error:
            touch.outcome, touch.reason = Outcome.ABORTED, str(error)
            touch.measure()
        return touch.felt()

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

    def _descend(self, touch: Touch) -> None:
        """Go down until contact or depth, stop, and judge."""
        speed = self._settings.descent_speed
        touch.allow((self._cell.approach_height + touch.full) / speed + _GRACE)
        touch.descend(speed, self._settings.contact_force)
        contact = touch.contact
        touch.measure()
        if touch.seated:
            touch.outcome, touch.reason = Outcome.SEATED, ""
        elif contact:
            touch.outcome, touch.reason = Outcome.BLOCKED, ""
        else:
            touch.outcome, touch.reason = Outcome.ABORTED, "the descent met neither contact nor depth in its time"

    def _above(self, x: float, y: float, yaw: float) -> bool:
        """To the approach height: straight across if the part is there already, else over the top. Whether over it."""
        height = self._board.z + self._cell.approach_height
        here, _ = frames.ros_pose(self._arm.getActualTCPPose())
        if math.hypot(here[0] - x, here[1] - y) > _NEAR or here[2] < self._board.z:
            self._travel_to(x, y, yaw)
            self._lower_to(x, y, height, yaw)
            return True
        self._go(x, y, height, yaw, self._cell.approach_speed)
        return False

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
                raise ArmError(f"stopped while turning: {stopped(self._arm)}")
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
            raise ArmError(f"stopped on the way: {stopped(self._arm)}")

    def _dwell(self, duration: float) -> None:
        end = self._arm.getTimestamp() + duration - CYCLE / 2
        while self._arm.getTimestamp() < end:
            cycle = self._arm.initPeriod()
            self._arm.waitPeriod(cycle)

    def _grip(self, closed: bool) -> None:
        """Open or close the gripper; not while a safeguard or an emergency stop lasts."""
        while self._arm.getSafetyMode() in (SAFEGUARD_STOP, EMERGENCY_STOP):
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
