"""What the arm tells the bus while it works: joints, wrench, TCP, link poses, status."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from drivers.ur3e import frames
from drivers.ur3e.parameters import CYCLE, CYCLE_NS, JOINT_NAMES, JOINTS, Joint
from drivers.ur3e.robot_model import quaternion_of_rpy, urdf
from drivers.ur3e.simulated_arm import SimulatedArm
from runtime import topics
from runtime.bus import Publisher
from runtime.context import Context
from runtime.messages import (
    BASE_FRAME,
    ArmStatus,
    ControlTrace,
    JointState,
    Point,
    Pose,
    PoseStamped,
    Quaternion,
    String,
    TFMessage,
    Transform,
    TransformStamped,
    Vector3,
    Wrench,
    WrenchStamped,
    header,
)

PERIOD = 40_000_000  # [ns] 25 Hz: enough to see the arm move; what happens in between is in the trace
_CYCLES = PERIOD // CYCLE_NS
_TRACE_CYCLES = 50  # in one message of the trace


def pose_of(position: frames.Vector, quaternion: frames.Quaternion) -> Pose:
    """A pose as a message; the quaternion is (x, y, z, w)."""
    x, y, z, w = quaternion
    return Pose(position=Point(*position), orientation=Quaternion(x=x, y=y, z=z, w=w))


def wrench_of(wrench: Sequence[float]) -> Wrench:
    """A wrench (6,) [N, Nm] as a message."""
    return Wrench(force=Vector3(*wrench[:3]), torque=Vector3(*wrench[3:]))


def _turned(origin: tuple[float, float, float, float], angle: float) -> Quaternion:
    """Orientation of a joint's link: its origin (w, x, y, z) followed by a turn about z."""
    w, x, y, z = origin
    c, s = math.cos(angle / 2), math.sin(angle / 2)
    return Quaternion(w=w * c - z * s, x=x * c + y * s, y=y * c - x * s, z=z * c + w * s)


def _transform(parent: str, child: str, joint: Joint | None, rotation: Quaternion, stamp: int) -> TransformStamped:
    origin = joint.origin if joint else (0.0, 0.0, 0.0)
    return TransformStamped(
        header=header(stamp, parent),
        child_frame_id=child,
        transform=Transform(translation=Vector3(*origin), rotation=rotation),
    )


@dataclass
class Telemetry:
    """Publishes the state of the arm. Declare it before the plugin is ready."""

    context: Context
    activity: str = "starting"
    holding: str = ""
    _cycles: int = 0
    _last_status: tuple[object, ...] = ()
    _joints: Publisher[JointState] = field(init=False)
    _wrench: Publisher[WrenchStamped] = field(init=False)
    _pose: Publisher[PoseStamped] = field(init=False)
    _tf: Publisher[TFMessage] = field(init=False)
    _status: Publisher[ArmStatus] = field(init=False)
    _positions: list[float] = field(default_factory=list)  # (cycles x 6) since the last message of the trace
    _targets: list[float] = field(default_factory=list)
    _wrenches: list[float] = field(default_factory=list)

    def __post_init__(self) -> None:
        bus = self.context.bus
        self._joints = bus.publisher(topics.JOINT_STATES)
        self._wrench = bus.publisher(topics.WRENCH)
        self._pose = bus.publisher(topics.TCP_POSE)
        self._tf = bus.publisher(topics.TF)
        self._tf_static = bus.publisher(topics.TF_STATIC)
        self._status = bus.publisher(topics.ARM_STATUS)
        self._trace = bus.publisher(topics.TRACE)
        self._description = bus.publisher(topics.ROBOT_DESCRIPTION)
        self._parents = ("base_link_inertia", *(joint.link for joint in JOINTS[:-1]))
        self._origins = tuple(quaternion_of_rpy(joint.rpy) for joint in JOINTS)

    def describe(self) -> None:
        """Publish what does not change: the robot's description and its fixed frames."""
        half = math.pi / 2
        fixed = (
            (BASE_FRAME, "base_link_inertia", (0.0, 0.0, math.pi)),
            (BASE_FRAME, "base", (0.0, 0.0, math.pi)),
            ("wrist_3_link", "flange", (0.0, -half, -half)),
            ("flange", "tool0", (half, 0.0, half)),
            ("tool0", "gripper", (0.0, 0.0, 0.0)),
        )
        transforms = [
            _transform(parent, child, None, _turned(quaternion_of_rpy(rpy), 0.0), 0) for parent, child, rpy in fixed
        ]
        self._tf_static.send(TFMessage(transforms=transforms), 0)
        self._description.send(String(data=urdf()), 0)

    def __call__(self, arm: SimulatedArm) -> None:
        """After every control cycle."""
        status = (arm.safety_mode, self.activity, self.holding, arm.controller.scaling in (0.0, 1.0))
        if status != self._last_status:
            self._last_status = status
            self.publish_status(arm)
        self._cycles += 1
        self._positions += arm.getActualQ()
        self._targets += arm.getTargetQ()
        self._wrenches += arm.sensor.wrench
        if self._cycles % _CYCLES == 0:
            self.publish_state(arm)
        if self._cycles % _TRACE_CYCLES == 0:
            self.publish_trace(arm)

    def publish_status(self, arm: SimulatedArm) -> None:
        """Mode and activity."""
        now = arm.time
        self._status.send(
            ArmStatus(
                header(now), arm.getRobotMode(), arm.safety_mode, arm.getSpeedScaling(), self.activity, self.holding
            ),
            now,
        )

    def publish_state(self, arm: SimulatedArm) -> None:
        """Joints, wrench, TCP and link poses."""
        now = arm.time
        angles = arm.getActualQ()
        self._joints.send(
            JointState(
                header=header(now),
                name=list(JOINT_NAMES),
                position=np.array(angles),
                velocity=np.array(arm.getActualQd()),
                effort=np.array(arm.getJointTorques()),
            ),
            now,
        )
        self._wrench.send(WrenchStamped(header=header(now, "tool0"), wrench=wrench_of(arm.sensor.wrench)), now)
        position, rotation = arm.pose
        self._pose.send(
            PoseStamped(
                header=header(now, BASE_FRAME), pose=pose_of(position, frames.quaternion_of_rotation(rotation))
            ),
            now,
        )
        self._tf.send(
            TFMessage(
                transforms=[
                    _transform(parent, joint.link, joint, _turned(origin, angle), now)
                    for parent, joint, origin, angle in zip(self._parents, JOINTS, self._origins, angles, strict=True)
                ]
            ),
            now,
        )

    def publish_trace(self, arm: SimulatedArm) -> None:
        """Every control cycle since the last trace."""
        cycles = len(self._positions) // 6
        if cycles == 0:
            return
        self._trace.send(
            ControlTrace(
                header(arm.time - (cycles - 1) * CYCLE_NS, "tool0"),
                CYCLE,
                np.array(self._positions),
                np.array(self._targets),
                np.array(self._wrenches),
            ),
            arm.time,
        )
        for rows in (self._positions, self._targets, self._wrenches):
            rows.clear()
