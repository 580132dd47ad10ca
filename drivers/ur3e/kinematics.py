"""Kinematics and dynamics of the arm by Pinocchio, with the TCP where it has been set. Frame: base_link."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pinocchio
from numpy.typing import NDArray

from drivers.ur3e import frames
from drivers.ur3e.frames import Rotation, Vector
from drivers.ur3e.parameters import JOINTS
from drivers.ur3e.robot_model import urdf
from runtime.errors import ArmError

Array = NDArray[np.float64]

_REACH = tuple(joint.reach for joint in JOINTS)
_DAMPING = 1e-3  # of the first steps of the inverse: keeps them short near a singularity
_STEPS = 200  # a solution that exists is found in under 20; the rest is for starts that are far away
_TOLERANCE = 1e-11  # [m], [rad]


class Kinematics:
    """Forward and inverse kinematics of one arm; keeps the Jacobian of the configuration it was last given."""

    def __init__(self) -> None:
        self.model = pinocchio.buildModelFromXML(urdf())
        self._tool = self.model.getFrameId("tool0")
        tool = self.model.frames[self._tool]
        frame = pinocchio.Frame("tcp", tool.parentJoint, tool.parentFrame, tool.placement, pinocchio.FrameType.OP_FRAME)
        self._tcp = self.model.addFrame(frame)
        self._data = self.model.createData()
        self.tcp_offset: tuple[float, ...] = (0.0,) * 6

    def set_tcp(self, offset: Sequence[float]) -> None:
        """Put the TCP at a pose (6,) in the flange's frame, as UR's set_tcp does."""
        self.tcp_offset = tuple(float(value) for value in offset)
        placement = pinocchio.SE3(
            np.array(frames.rotation_of_vector(self.tcp_offset[3:])).reshape(3, 3), np.array(self.tcp_offset[:3])
        )
        self.model.frames[self._tcp].placement = self.model.frames[self._tool].placement * placement

    def forward(self, q: Array) -> tuple[Vector, Rotation]:
        """Position [m] and rotation of the TCP at joint angles `q` (6,) [rad]."""
        pinocchio.computeJointJacobians(self.model, self._data, q)
        placement = pinocchio.updateFramePlacement(self.model, self._data, self._tcp)
        return tuple(placement.translation.tolist()), tuple(placement.rotation.ravel().tolist())

    def tool(self, q: Array) -> tuple[Vector, Rotation]:
        """Position [m] and rotation of `tool0` at joint angles `q` (6,) [rad]."""
        pinocchio.forwardKinematics(self.model, self._data, q)
        placement = pinocchio.updateFramePlacement(self.model, self._data, self._tool)
        return tuple(placement.translation.tolist()), tuple(placement.rotation.ravel().tolist())

    def jacobian(self) -> Array:
        """(6, 6): joint speeds to the TCP's twist, linear part first, where `forward` was last called."""
        jacobian: Array = pinocchio.getFrameJacobian(
            self.model, self._data, self._tcp, pinocchio.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )
        return jacobian

    def mass_matrix(self, q: Array) -> Array:
        """(6, 6) [kg m^2] of arm and gripper, without the rotors."""
        upper = pinocchio.crba(self.model, self._data, q)
        matrix: Array = np.triu(upper) + np.triu(upper, 1).T
        return matrix

    def bias(self, q: Array, qd: Array) -> Array:
        """(6,) [Nm] Coriolis, centrifugal and gravity torques."""
        torque: Array = pinocchio.nonLinearEffects(self.model, self._data, q, qd)
        return torque.copy()

    def momentum(self, q: Array, qd: Array) -> float:
        """[kg m/s] size of the linear momentum of arm and gripper."""
        momentum = pinocchio.computeCentroidalMomentum(self.model, self._data, q, qd)
        return float(np.linalg.norm(momentum.linear))

    def inverse(self, position: Sequence[float], rotation: Rotation, near: Array) -> Array:
        """Joint angles (6,) [rad] that put the TCP there, by damped Newton steps from `near`.

        Raises ArmError that names the target if there are none in reach of the joints.
        """
        q = near.copy()
        damping = _DAMPING
        last = math.inf
        for _ in range(_STEPS):
            error = self._error(position, rotation, q)
            size = max(abs(value) for value in error)
            if size < _TOLERANCE:
                break
            damping = max(damping * 0.3, 1e-14) if size < last else min(damping * 4, 1e-1)
            last = size
            jacobian = self.jacobian()
            step = jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + damping * np.eye(6), np.array(error))
            largest = float(np.abs(step).max())
            q += step * min(1.0, 0.5 / largest) if largest > 0 else step
        q = _wrapped(q, near)
        if max(abs(value) for value in self._error(position, rotation, q)) > 1e-8:
            raise ArmError(f"out of reach: {described(position, rotation)}")
        if any(abs(angle) > reach + 1e-9 for angle, reach in zip(q.tolist(), _REACH, strict=True)):
            raise ArmError(f"beyond the joints' limits: {described(position, rotation)}")
        return q

    def _error(self, position: Sequence[float], rotation: Rotation, q: Array) -> tuple[float, ...]:
        here, orientation = self.forward(q)
        turn = frames.vector_of_rotation(frames.product(rotation, frames.transpose(orientation)))
        return (position[0] - here[0], position[1] - here[1], position[2] - here[2], *turn)


def _wrapped(q: Array, near: Array) -> Array:
    """The same configuration with every joint within its limits, and as near as that allows."""
    angles = []
    for angle, start, reach in zip(q.tolist(), near.tolist(), _REACH, strict=True):
        candidates = [angle + turn * 2 * math.pi for turn in range(-3, 4)]
        allowed = [candidate for candidate in candidates if abs(candidate) <= reach + 1e-9] or [angle]
        angles.append(min(allowed, key=lambda candidate: abs(candidate - start)))
    return np.array(angles)


def described(position: Sequence[float], rotation: Rotation) -> str:
    """A pose in words for people: base_link, millimetres and degrees."""
    x, y, z = (1e3 * value for value in position)
    rx, ry, rz = (math.degrees(value) for value in frames.vector_of_rotation(rotation))
    return f"TCP at ({x:.2f}, {y:.2f}, {z:.2f}) mm, rotation vector ({rx:.1f}, {ry:.1f}, {rz:.1f}) deg in base_link"
