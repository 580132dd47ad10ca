"""Currents, voltages, temperatures and momentum of the simulated arm. What UR does not publish is marked *assumed*.

Motor torque is what moves the joint, gravity included: the simulation balances gravity by itself, so its torque is
added here. Current is torque over a torque constant; heat goes with the square of the current into one thermal mass for
each joint. Everything is worked out when somebody asks, at most once in a control cycle, except for the heat.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from drivers.ur3e import frames
from drivers.ur3e.kinematics import Kinematics
from drivers.ur3e.parameters import CYCLE, GRAVITY, JOINTS
from drivers.ur3e.simulated_arm import SimulatedArm

Array = NDArray[np.float64]

TORQUE_CONSTANT = (10.0, 10.0, 8.0, 6.0, 6.0, 6.0)  # [Nm/A] assumed: motor and gear together
_AMBIENT = 25.0  # [C] assumed
_HOUSE = 3.0  # [K] assumed: above ambient by the electronics of a joint that is switched on
_RESISTANCE = 1.6  # [K/A^2] assumed: rise per squared ampere in the long run
_TIME_CONSTANT = 1200.0  # [s] assumed
_HEAT_CYCLES = 50  # between steps of the heat: 10 Hz is far faster than it changes
_MAIN = 48.0  # [V]
_DROOP = 0.15  # [V/A] assumed: of the supply under load
_IDLE_CURRENT = 0.35  # [A] assumed: electronics of a powered arm
_IO_CURRENT = 0.08  # [A] assumed
_TOOL_CURRENT = 0.04  # [A] assumed: gripper's electronics, at 12 or 24 V


class Electrics:
    """Of one arm. `powered` is whether its electronics are on, `released` whether motors hold it instead of brakes."""

    def __init__(self, arm: SimulatedArm) -> None:
        self._arm = arm
        self._kinematics = Kinematics()
        self.powered = self.released = True
        self.tool_voltage = 0  # [V]
        self.joint_temperature: list[float] = [_AMBIENT + _HOUSE] * 6  # (6,) [C]
        self.energy_consumed = 0.0  # [J] since the start
        self.energy_braked = 0.0  # [J] that moving joints gave back, turned into heat
        self._cycles = 0
        self._seen: dict[str, tuple[int, Sequence[float]]] = {}
        self._speed: tuple[int, Sequence[float]] = (-1, (0.0,) * 6)  # twist of the cycle before the last that was asked

    def advance(self) -> None:
        """A control cycle passes."""
        self._cycles += 1
        if self._cycles % _HEAT_CYCLES:
            return
        self._count_energy()
        share = -math.expm1(-_HEAT_CYCLES * CYCLE / _TIME_CONSTANT)
        house = _HOUSE if self.powered else 0.0
        self.joint_temperature = [
            t + share * (_AMBIENT + house + _RESISTANCE * a * a - t)
            for t, a in zip(self.joint_temperature, self.joint_current, strict=True)
        ]

    def _count_energy(self) -> None:
        elapsed = _HEAT_CYCLES * CYCLE
        self.energy_consumed += elapsed * self.robot_voltage * self.robot_current
        power = sum(t * w for t, w in zip(self.joint_torque, self._arm.getActualQd(), strict=True))
        self.energy_braked += elapsed * max(0.0, -power)

    def _once(self, name: str, work: Array | Sequence[float]) -> Sequence[float]:
        values: Sequence[float] = work.tolist() if isinstance(work, np.ndarray) else work
        self._seen[name] = (self._arm.time, values)
        return values

    def _known(self, name: str) -> Sequence[float] | None:
        known = self._seen.get(name)
        return known[1] if known is not None and known[0] == self._arm.time else None

    @property
    def joint_torque(self) -> Sequence[float]:
        """(6,) [Nm] that the motors give, gravity included; nothing while the brakes hold the arm."""
        if not self.released:
            return (0.0,) * 6
        known = self._known("torque")
        if known is not None:
            return known
        gravity = self._kinematics.bias(np.array(self._arm.getActualQ()), np.zeros(6))
        return self._once("torque", gravity + np.array(self._arm.getJointTorques()))

    @property
    def target_moment(self) -> Sequence[float]:
        """(6,) [Nm] that the commanded motion needs: inverse dynamics of arm, gripper and rotors."""
        known = self._known("moment")
        if known is not None:
            return known
        arm = self._arm
        q, qd, qdd = np.array(arm.getTargetQ()), np.array(arm.getTargetQd()), np.array(arm.controller.qdd)
        rotors = np.array([joint.armature for joint in JOINTS])
        moment = self._kinematics.mass_matrix(q) @ qdd + rotors * qdd + self._kinematics.bias(q, qd)
        return self._once("moment", moment)

    @property
    def wrench_from_currents(self) -> Sequence[float]:
        """(6,) [N, Nm] on the tool, in base, by the joints' torques alone: what balances those beyond gravity."""
        known = self._known("wrench")
        if known is not None:
            return known
        arm = self._arm
        jacobian = arm.controller.kinematics.jacobian()
        try:
            wrench = np.linalg.solve(jacobian.T, -np.array(arm.getJointTorques()))
        except np.linalg.LinAlgError:
            wrench = np.zeros(6)
        return self._once("wrench", frames.turn_base_wrench(wrench.tolist()))

    @property
    def joint_current(self) -> Sequence[float]:
        """(6,) [A] measured."""
        return [torque / k for torque, k in zip(self.joint_torque, TORQUE_CONSTANT, strict=True)]

    @property
    def target_current(self) -> Sequence[float]:
        """(6,) [A] that the commanded motion needs."""
        if not self.released:
            return (0.0,) * 6
        return [moment / k for moment, k in zip(self.target_moment, TORQUE_CONSTANT, strict=True)]

    @property
    def control_output(self) -> Sequence[float]:
        """(6,) [A] that the joints' controllers ask for: what is needed, and what corrects the deviation."""
        return self.joint_current

    @property
    def robot_current(self) -> float:
        """[A] that the arm draws."""
        if not self.powered:
            return 0.0
        moving = sum(abs(t * w) for t, w in zip(self.joint_torque, self._arm.getActualQd(), strict=True)) / _MAIN
        holding = sum(a * a for a in self.joint_current) * 0.02  # assumed: windings of 1 ohm at 48 V
        return _IDLE_CURRENT + moving + holding

    @property
    def main_voltage(self) -> float:
        """[V] of the safety control board's supply."""
        return _MAIN

    @property
    def robot_voltage(self) -> float:
        """[V] at the arm's base."""
        return _MAIN - _DROOP * self.robot_current if self.powered else 0.0

    @property
    def joint_voltage(self) -> Sequence[float]:
        """(6,) [V] at the joints."""
        if not self.powered:
            return (0.0,) * 6
        supply = self.robot_voltage
        return [supply - _DROOP * abs(current) for current in self.joint_current]

    @property
    def io_current(self) -> float:
        """[A] that inputs and outputs draw."""
        return _IO_CURRENT

    @property
    def tool_current(self) -> float:
        """[A] that the tool draws."""
        return _TOOL_CURRENT if self.powered and self.tool_voltage else 0.0

    @property
    def tool_temperature(self) -> float:
        """[C]; of the last joint, which is next to the tool."""
        return self.joint_temperature[5]

    @property
    def momentum(self) -> float:
        """[kg m/s] norm of the linear momentum of arm and gripper."""
        known = self._known("momentum")
        if known is not None:
            return known[0]
        arm = self._arm
        value = self._kinematics.momentum(np.array(arm.getActualQ()), np.array(arm.getActualQd()))
        return self._once("momentum", [value])[0]

    @property
    def tool_acceleration(self) -> Sequence[float]:
        """(3,) [m/s^2] that an accelerometer at the flange measures in the tool's frame: at rest, up.

        Motion is the difference of the TCP's speed to the control cycle before, known if that was asked for too.
        """
        known = self._known("acceleration")
        if known is not None:
            return known
        arm = self._arm
        speed = frames.turn_base_wrench(arm.getActualTCPSpeed())
        before, old = self._speed
        ax = ay = az = 0.0
        elapsed = (arm.time - before) * 1e-9
        if before >= 0 and 0 < elapsed <= 2.5 * CYCLE:
            ax, ay, az = ((now - then) / elapsed for now, then in zip(speed[:3], old[:3], strict=True))
        self._speed = (arm.time, speed)
        _, rotation = self._kinematics.tool(np.array(arm.getActualQ()))
        return self._once("acceleration", frames.unrotate(rotation, (ax, ay, az + GRAVITY)))
