"""URScript's questions to the arm, and what a program tells it about itself: kinematics, measurements, payload, TCP."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

from drivers.ur3e import frames
from drivers.ur3e.control_box.script_motion import joints_of
from drivers.ur3e.inverse import flange
from drivers.ur3e.kinematics import Kinematics
from drivers.ur3e.parameters import CYCLE, JOINTS
from drivers.ur3e.urscript.values import Pose
from runtime.errors import ArmError

if TYPE_CHECKING:
    from drivers.ur3e.control_box.box import ControlBox

Array: TypeAlias = NDArray[np.float64]
Rows: TypeAlias = list[list[float]]  # a matrix as scripts have it

_HEAVIEST = 10.0  # [kg] well beyond a UR3e's 3 kg, so that wrong units are noticed


class StateBuiltins:
    """The functions that read the arm, or set what it believes."""

    def __init__(self, box: ControlBox) -> None:
        self._box = box
        self._arm = box.arm
        self._kinematics = Kinematics()  # of its own: the controller's keeps the Jacobian of its configuration

    # Kinematics

    def get_forward_kin(self, q: Sequence[float] | None = None, tcp: Sequence[float] | None = None) -> Pose:
        """Pose of the TCP at joint angles (6,), the present ones by default."""
        return Pose(self._arm.getForwardKinematics(None if q is None else joints_of(q), tcp))

    def get_inverse_kin(
        self,
        x: Sequence[float],
        qnear: Sequence[float] | None = None,
        maxPositionError: float = 1e-10,  # noqa: ARG002, N803 - the closed form is exact
        maxOrientationError: float = 1e-10,  # noqa: ARG002, N803
        tcp: Sequence[float] | None = None,
    ) -> list[float]:
        """Joint angles (6,) for a pose of the TCP."""
        q = self._inverse(x, qnear, tcp)
        if q is None:
            raise ArmError(f"get_inverse_kin: no solution for p[{', '.join(f'{value:.6g}' for value in x)}]")
        return list(q)

    def get_inverse_kin_has_solution(
        self,
        pose: Sequence[float],
        qnear: Sequence[float] | None = None,
        maxPositionError: float = 1e-10,  # noqa: ARG002, N803
        maxOrientationError: float = 1e-10,  # noqa: ARG002, N803
        tcp: Sequence[float] | None = None,
    ) -> bool:
        """Whether there is one."""
        return self._inverse(pose, qnear, tcp) is not None

    def _inverse(
        self, x: Sequence[float], near: Sequence[float] | None, tcp: Sequence[float] | None
    ) -> list[float] | None:
        if tcp is not None:
            mine = self._arm.tcp_offset
            place, turned = flange(*frames.ros_pose(x), tcp[:3], frames.rotation_of_vector(tcp[3:6]))
            tip = tuple(a + b for a, b in zip(place, frames.rotate(turned, mine[:3]), strict=True))
            x = frames.ur_pose(tip, frames.product(turned, frames.rotation_of_vector(mine[3:])))
        try:
            return self._arm.getInverseKinematics(x, None if near is None else joints_of(near))
        except ArmError:
            return None

    def is_within_safety_limits(self, x: Sequence[float]) -> bool:
        """Whether the arm can be at a pose, or at joint angles (6,)."""
        if isinstance(x, Pose):
            return self._inverse(x, None, None) is not None
        return all(abs(angle) <= joint.reach for angle, joint in zip(joints_of(x), JOINTS, strict=True))

    # Where the arm is

    def get_actual_tcp_pose(self) -> Pose:
        """Pose of the TCP from the measured joint angles."""
        return Pose(self._arm.getActualTCPPose())

    def get_target_tcp_pose(self) -> Pose:
        """Commanded pose of the TCP."""
        return Pose(self._arm.getTargetTCPPose())

    def get_actual_tcp_speed(self) -> list[float]:
        """Twist (6,) of the TCP."""
        return list(self._arm.getActualTCPSpeed())

    def get_target_tcp_speed(self) -> list[float]:
        """Commanded twist (6,) of the TCP."""
        return list(self._arm.getTargetTCPSpeed())

    def get_actual_tool_flange_pose(self) -> Pose:
        """Pose of the flange from the measured joint angles."""
        return Pose(self._arm.getForwardKinematics(None, [0.0] * 6))

    def get_target_tool_flange_pose(self) -> Pose:
        """Commanded pose of the flange."""
        return Pose(self._arm.getForwardKinematics(self._arm.getTargetQ(), [0.0] * 6))

    def get_actual_joint_positions(self) -> list[float]:
        """Joint angles (6,) [rad]."""
        return list(self._arm.getActualQ())

    def get_target_joint_positions(self) -> list[float]:
        """Commanded joint angles (6,) [rad]."""
        return list(self._arm.getTargetQ())

    def get_joint_positions(self) -> list[float]:
        """Older name of `get_target_joint_positions`, of which UR's client library needs the smoothness."""
        return self.get_target_joint_positions()

    def get_actual_joint_speeds(self) -> list[float]:
        """Joint speeds (6,) [rad/s]."""
        return list(self._arm.getActualQd())

    def get_target_joint_speeds(self) -> list[float]:
        """Commanded joint speeds (6,) [rad/s]."""
        return list(self._arm.getTargetQd())

    def get_target_joint_accelerations(self) -> list[float]:
        """Commanded joint accelerations (6,) [rad/s^2]."""
        return list(self._arm.controller.qdd)

    def get_actual_joint_positions_history(self, steps: float = 0) -> list[float]:
        """Joint angles (6,) [rad] as they were some control cycles ago."""
        history = self._box.history
        index = int(steps)
        if not 0 <= index < len(history):
            raise ArmError(f"the joints' history goes back {len(history) - 1} cycles, not {index}")
        return list(history[-1 - index])

    def is_steady(self) -> bool:
        """Whether the arm stands."""
        return self._box.steady

    # Forces and dynamics

    def get_tcp_force(self) -> list[float]:
        """Wrench (6,) [N, Nm] on the tool, at the TCP, along the axes of base."""
        return list(self._arm.getActualTCPForce())

    def force(self) -> float:
        """Size [N] of the force on the tool."""
        return math.hypot(*self._arm.getActualTCPForce()[:3])

    def get_joint_torques(self) -> list[float]:
        """Joint torques (6,) [Nm] without those that balance gravity."""
        return list(self._arm.getJointTorques())

    def tool_contact(self, direction: Sequence[float] = (0.0,) * 6) -> int:
        """Cycles since contact began for a tool that moves along `direction` (6,); 0 without contact."""
        return self._arm.toolContact(joints_of(direction))

    def get_mass_matrix(self, q: Sequence[float] | None = None, include_rotors_inertia: bool = False) -> Rows:
        """(6, 6) [kg m^2] of the arm with its gripper."""
        matrix = self._kinematics.mass_matrix(self._angles(q))
        if include_rotors_inertia:
            matrix = matrix + np.diag([joint.armature for joint in JOINTS])
        return _rows(matrix)

    def get_coriolis_and_centrifugal_torques(
        self, q: Sequence[float] | None = None, qd: Sequence[float] | None = None
    ) -> list[float]:
        """(6,) [Nm]."""
        speeds = np.array(self._arm.getActualQd() if qd is None else joints_of(qd))
        angles = self._angles(q)
        moving, standing = self._kinematics.bias(angles, speeds), self._kinematics.bias(angles, np.zeros(6))
        return list((moving - standing).tolist())

    def get_jacobian(self, q: Sequence[float] | None = None, tcp: Sequence[float] | None = None) -> Rows:
        """(6, 6) from joint speeds to the twist of the TCP, along the axes of base."""
        return _rows(self._jacobian(self._angles(q), tcp))

    def get_jacobian_time_derivative(
        self,
        q: Sequence[float] | None = None,
        qd: Sequence[float] | None = None,
        tcp: Sequence[float] | None = None,
    ) -> Rows:
        """(6, 6) how the Jacobian changes at joint speeds `qd`: central difference along the motion."""
        speeds = np.array(self._arm.getActualQd() if qd is None else joints_of(qd))
        angles, step = self._angles(q), 1e-6
        after, before = self._jacobian(angles + step * speeds, tcp), self._jacobian(angles - step * speeds, tcp)
        return _rows((after - before) / (2 * step))

    def _angles(self, q: Sequence[float] | None) -> Array:
        return np.array(self._arm.getActualQ() if q is None else joints_of(q))

    def _jacobian(self, q: Array, tcp: Sequence[float] | None) -> Array:
        self._kinematics.set_tcp(self._arm.tcp_offset if tcp is None else tcp)
        self._kinematics.forward(q)
        turned = self._kinematics.jacobian().copy()
        turned[[0, 1, 3, 4]] *= -1.0  # base is base_link turned by half a turn
        return turned

    # What the arm is told about itself

    def zero_ftsensor(self) -> None:
        """Call the wrench that is measured now zero."""
        self._arm.zeroFtSensor()

    def set_tcp(self, pose: Sequence[float], tcp_name: str = "") -> None:  # noqa: ARG002 - a name is for the pendant
        """Put the TCP at a pose in the flange's frame."""
        self._arm.setTcp([float(value) for value in pose])

    def get_tcp_offset(self) -> Pose:
        """The TCP's pose in the flange's frame."""
        return Pose(self._arm.tcp_offset)

    def set_payload(self, m: float, cog: Sequence[float] | None = None) -> None:
        """Say what hangs on the flange: mass [kg] and its centre (3,) [m]; the centre stays if it is not given."""
        if not 0 <= m <= _HEAVIEST:
            raise ArmError(f"a payload of {m:g} kg cannot hang on a UR3e; write 0 to {_HEAVIEST:g} kg")
        self._arm.setPayload(m, self._arm.payload[1] if cog is None else [float(value) for value in cog])

    def set_payload_mass(self, m: float) -> None:
        """Say the mass [kg] alone."""
        self.set_payload(m)

    def set_payload_cog(self, cog: Sequence[float]) -> None:
        """Say the centre of mass (3,) [m] alone."""
        self.set_payload(self._arm.payload[0], cog)

    def set_target_payload(
        self,
        m: float,
        cog: Sequence[float],
        inertia: Sequence[float] = (0.0,) * 6,
        transition_time: float = 0.0,  # noqa: ARG002 - the payload is used for the force-torque sensor alone
    ) -> None:
        """Say mass [kg], centre (3,) [m] and inertia (6,) [kg m^2]."""
        self.set_payload(m, cog)
        self._box.payload_inertia = joints_of(inertia)

    def get_target_payload(self) -> float:
        """Mass [kg] that was said."""
        return self._arm.payload[0]

    def get_target_payload_cog(self) -> list[float]:
        """Centre of mass (3,) [m] that was said."""
        return list(self._arm.payload[1])

    def get_target_payload_inertia(self) -> list[float]:
        """Inertia (6,) [kg m^2] that was said."""
        return list(self._box.payload_inertia)

    def set_gravity(self, d: Sequence[float]) -> None:
        """Say how the arm is mounted: the acceleration (3,) [m/s^2] in base that holds it up.

        The simulated arm stands upright all the same: a wrong direction shows in the forces, as it would.
        """
        size = math.hypot(*d[:3])
        if not 0.1 < size < 100.0:
            raise ArmError(f"gravity of {size:g} m/s2 is none; write a vector (3,) such as [0, 0, 9.82]")
        self._box.gravity = [float(value) for value in d[:3]]
        self._arm.sensor.set_gravity(frames.turn_base([-value / size for value in self._box.gravity]))

    def ft_rtde_input_enable(
        self,
        enable: bool,
        sensor_mass: float = 0.0,  # noqa: ARG002 - the client's wrench is taken as it comes
        sensor_measuring_offset: Sequence[float] = (0.0,) * 3,  # noqa: ARG002
        sensor_cog: Sequence[float] = (0.0,) * 3,  # noqa: ARG002
    ) -> None:
        """Take the wrench at the flange from RTDE's `external_force_torque` in place of the arm's own sensor."""
        self._box.external_sensor = bool(enable)

    def enable_external_ft_sensor(
        self,
        enable: bool,
        sensor_mass: float = 0.0,
        sensor_measuring_offset: Sequence[float] = (0.0,) * 3,
        sensor_cog: Sequence[float] = (0.0,) * 3,
    ) -> None:
        """Older name of `ft_rtde_input_enable`."""
        self.ft_rtde_input_enable(enable, sensor_mass, sensor_measuring_offset, sensor_cog)

    def get_steptime(self) -> float:
        """Length [s] of a control cycle."""
        return CYCLE


def _rows(matrix: Array) -> Rows:
    rows: Rows = matrix.tolist()
    return rows
