# ruff: noqa: N802 - names are those of UR's RTDE as ur-rtde's clients spell them
"""What can be read of the simulated arm, in the words of the arm interface. Nothing here moves it."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from drivers.ur3e import frames
from drivers.ur3e.arm import NORMAL, RUNNING
from drivers.ur3e.controller import Controller
from drivers.ur3e.force_torque import ForceTorqueSensor
from drivers.ur3e.inverse import flange, nearest
from drivers.ur3e.kinematics import Kinematics, described
from drivers.ur3e.parameters import JOINTS
from drivers.ur3e.scene import Scene
from runtime.errors import ArmError

_STILL = 1e-3  # [rad/s]


class MeasuredArm:
    """The measuring half of `SimulatedArm`: controller, sensor and physics as they stand at session time `time`."""

    def __init__(self, scene: Scene, sensor: ForceTorqueSensor) -> None:
        self.scene = scene
        self.time = 0  # [ns] of the session
        self.safety_mode = NORMAL
        self.robot_mode = RUNNING
        self.payload: tuple[float, tuple[float, ...]] = (0.0, (0.0, 0.0, 0.0))  # [kg], centre (3,) [m], as told
        self.controller = Controller(Kinematics(), scene.workcell.home)
        self.sensor = sensor
        self._actual = Kinematics()
        self._asked = Kinematics()  # for questions about other configurations and other TCPs
        self._tool_turn: frames.Rotation | None = None  # from the TCP's frame to the tool's, if they differ
        model, data = scene.model, scene.data
        joints = [model.joint(joint.name) for joint in JOINTS]
        first, dof = int(joints[0].qposadr[0]), int(joints[0].dofadr[0])
        self._q, self._qd = data.qpos[first : first + 6], data.qvel[dof : dof + 6]
        self._torque, self._applied = data.qfrc_actuator[dof : dof + 6], data.qfrc_applied[dof : dof + 6]
        self._target_q, self._target_qd = data.ctrl[0::2], data.ctrl[1::2]
        self._reading = data.sensordata
        self._q[:] = self._target_q[:] = self.controller.q
        mujoco.mj_forward(model, data)
        self._pose_time = self._wrench_time = -1
        self._pose: tuple[frames.Vector, frames.Rotation] = (self.controller.position, self.controller.rotation)
        self._wrench = [0.0] * 6

    # Cheap to read for publishing; frame base_link.

    @property
    def pose(self) -> tuple[frames.Vector, frames.Rotation]:
        """Position [m] and rotation of the TCP in base_link, from the measured joint angles."""
        if self._pose_time != self.time:
            self._pose = self._actual.forward(self._q)
            self._pose_time = self.time
        return self._pose

    @property
    def wrench(self) -> list[float]:
        """Wrench (6,) [N, Nm] on the tool at the TCP in base_link, payload and zero corrected."""
        if self._wrench_time != self.time:
            self._wrench = self.sensor.at_tcp(self._lever, self._tool_rotation())
            self._wrench_time = self.time
        return self._wrench

    @property
    def tcp_offset(self) -> tuple[float, ...]:
        """Pose (6,) of the TCP in the flange's frame, UR's."""
        return self.controller.kinematics.tcp_offset

    @property
    def holding(self) -> bool:
        """Whether a part is in the gripper."""
        return self.scene.holding

    @property
    def _lever(self) -> tuple[float, ...]:
        return self.controller.kinematics.tcp_offset[:3]

    def _tool_rotation(self) -> frames.Rotation:
        rotation = self.controller.rotation
        return rotation if self._tool_turn is None else frames.product(rotation, self._tool_turn)

    def getActualQ(self) -> list[float]:
        """See `Arm`."""
        q: list[float] = self._q.tolist()
        return q

    def getActualQd(self) -> list[float]:
        """See `Arm`."""
        qd: list[float] = self._qd.tolist()
        return qd

    def getTargetQ(self) -> list[float]:
        """See `Arm`."""
        q: list[float] = self.controller.q.tolist()
        return q

    def getTargetQd(self) -> list[float]:
        """See `Arm`."""
        return list(self.controller.qd)

    def getActualTCPPose(self) -> list[float]:
        """See `Arm`."""
        return frames.ur_pose(*self.pose)

    def getTargetTCPPose(self) -> list[float]:
        """See `Arm`."""
        return frames.ur_pose(self.controller.position, self.controller.rotation)

    def getActualTCPSpeed(self) -> list[float]:
        """See `Arm`."""
        self._actual.forward(self._q)
        return frames.turn_base_wrench((self._actual.jacobian() @ self._qd).tolist())

    def getTargetTCPSpeed(self) -> list[float]:
        """Commanded twist (6,) [m/s, rad/s] of the TCP."""
        return frames.turn_base_wrench(self.controller.twist())

    def getActualTCPForce(self) -> list[float]:
        """See `Arm`."""
        return frames.turn_base_wrench(self.wrench)

    def getFtRawWrench(self) -> list[float]:
        """See `Arm`."""
        return self.sensor.raw[:]

    def getJointTorques(self) -> list[float]:
        """See `Arm`."""
        torque: list[float] = (self._torque + self._applied).tolist()
        return torque

    def getSafetyMode(self) -> int:
        """See `Arm`."""
        return self.safety_mode

    def getRobotMode(self) -> int:
        """See `Arm`."""
        return self.robot_mode

    def getSpeedScaling(self) -> float:
        """See `Arm`."""
        return self.controller.scaling

    def getTimestamp(self) -> float:
        """See `Arm`."""
        return self.time * 1e-9

    def getInverseKinematics(self, x: Sequence[float], qnear: Sequence[float] | None = None) -> list[float]:
        """See `Arm`."""
        position, rotation = frames.ros_pose(x)
        offset = self.tcp_offset
        tool = flange(position, rotation, offset[:3], frames.rotation_of_vector(offset[3:]))
        near = self._q.tolist() if qnear is None else qnear
        q = nearest(frames.turn_base(tool[0]), frames.turn_base_rotation(tool[1]), near)
        if q is None:
            raise ArmError(f"out of reach: {described(position, rotation)}")
        return list(q)

    def getForwardKinematics(
        self, q: Sequence[float] | None = None, tcp_offset: Sequence[float] | None = None
    ) -> list[float]:
        """See `Arm`."""
        kinematics = self._asked
        kinematics.set_tcp(self._actual.tcp_offset if tcp_offset is None else tcp_offset)
        return frames.ur_pose(*kinematics.forward(self._q if q is None else np.array(q, dtype=float)))

    def isSteady(self) -> bool:
        """See `Arm`."""
        return self.controller.idle and float(np.abs(self._qd).max()) < _STILL
