"""What the arm tells the bus while it works: joints, wrench, TCP, link poses, status."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from drivers.ur3e import frames
from drivers.ur3e.arm import Arm
from drivers.ur3e.parameters import CYCLE, CYCLE_NS, JOINT_NAMES, JOINTS, Triple
from drivers.ur3e.robot_model import quaternion_of_rpy, urdf
from runtime import topics
from runtime.bus import Publisher
from runtime.context import Context
from runtime.messages import (
    BASE_FRAME,
    NANOSECONDS,
    ArmStatus,
    ControlTrace,
    Float64MultiArray,
    Header,
    JointState,
    MultiArrayDimension,
    MultiArrayLayout,
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
    stamp_of,
)

PERIOD = 40_000_000  # [ns] 25 Hz: enough to see the arm move; what happens in between is in the trace
_CYCLES = PERIOD // CYCLE_NS
_TRACE_CYCLES = 50  # in one message of the trace
_FORCE_LAYOUT = MultiArrayLayout(dim=[MultiArrayDimension("x, y, z [N] in tool0", 3, 3)], data_offset=0)


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


def _transform(parent: Header, child: str, origin: Triple, rotation: Quaternion) -> TransformStamped:
    return TransformStamped(
        header=parent, child_frame_id=child, transform=Transform(translation=Vector3(*origin), rotation=rotation)
    )


class WristSensor(Protocol):
    """The force-torque sensor in the wrist."""

    @property
    def wrench(self) -> Sequence[float]:
        """Wrench (6,) [N, Nm] on the tool from outside at the flange, tool frame: payload and zero corrected."""
        ...


class ObservedArm(Arm, Protocol):
    """An arm in a session, as its telemetry sees it."""

    @property
    def time(self) -> int:
        """Session time [ns] of the last control cycle."""
        ...

    @property
    def pose(self) -> tuple[frames.Vector, frames.Rotation]:
        """Position [m] and rotation of the TCP in base_link, measured."""
        ...

    @property
    def safety_mode(self) -> int:
        """As `getSafetyMode`."""
        ...

    @property
    def sensor(self) -> WristSensor:
        """The force-torque sensor in the wrist."""
        ...


@dataclass
class Telemetry:
    """Publishes the state of the arm. Declare it before the plugin is ready."""

    context: Context
    activity: str = "starting"
    holding: str = ""
    _cycles: int = 0
    _traced: int = 0  # [ns] the last cycle in the trace
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
        self._peak_force = bus.publisher(topics.PEAK_FORCE)
        self._description = bus.publisher(topics.ROBOT_DESCRIPTION)
        self._origins = tuple(quaternion_of_rpy(joint.rpy) for joint in JOINTS)
        # Made once and filled anew each time, all with one stamp: making them was a third of the cost of publishing.
        self._stamp = stamp_of(0)
        self._tool_header = Header(stamp=self._stamp, frame_id="tool0")
        self._base_header = Header(stamp=self._stamp, frame_id=BASE_FRAME)
        nothing = np.zeros(len(JOINTS))
        self._joint_state = JointState(
            header=Header(stamp=self._stamp, frame_id=""),
            name=list(JOINT_NAMES),
            position=nothing,
            velocity=nothing,
            effort=nothing,
        )
        parents = ("base_link_inertia", *(joint.link for joint in JOINTS[:-1]))
        self._links = TFMessage(
            transforms=[
                _transform(Header(stamp=self._stamp, frame_id=parent), joint.link, joint.origin, Quaternion(0, 0, 0, 1))
                for parent, joint in zip(parents, JOINTS, strict=True)
            ]
        )

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
            _transform(header(0, parent), child, (0.0, 0.0, 0.0), _turned(quaternion_of_rpy(rpy), 0.0))
            for parent, child, rpy in fixed
        ]
        self._tf_static.send(TFMessage(transforms=transforms), 0)
        self._description.send(String(data=urdf()), 0)

    def __call__(self, arm: ObservedArm) -> None:
        """After every control cycle."""
        modes = (arm.getRobotMode(), arm.safety_mode)
        status = (modes, self.activity, self.holding, arm.getSpeedScaling() in (0.0, 1.0))
        if status != self._last_status:
            self._last_status = status
            self.publish_status(arm)
        self._cycles += 1
        if arm.time - self._traced != CYCLE_NS:  # cycles that never arrived: a message of the trace has no gaps
            self.publish_trace()
        self._traced = arm.time
        self._positions += arm.getActualQ()
        self._targets += arm.getTargetQ()
        self._wrenches += arm.sensor.wrench
        if self._cycles % _CYCLES == 0:
            self.publish_state(arm)
        if self._cycles % _TRACE_CYCLES == 0:
            self.publish_trace()

    def publish_status(self, arm: ObservedArm) -> None:
        """Mode and activity."""
        now = arm.time
        self._status.send(
            ArmStatus(
                header(now), arm.getRobotMode(), arm.safety_mode, arm.getSpeedScaling(), self.activity, self.holding
            ),
            now,
        )

    def publish_state(self, arm: ObservedArm) -> None:
        """Joints, wrench, TCP and link poses."""
        now = arm.time
        self._stamp.sec, self._stamp.nanosec = divmod(now, NANOSECONDS)
        angles = arm.getActualQ()
        joints = self._joint_state
        joints.position = np.array(angles)
        joints.velocity = np.array(arm.getActualQd())
        joints.effort = np.array(arm.getJointTorques())
        self._joints.send(joints, now)
        wrench = WrenchStamped(header=self._tool_header, wrench=wrench_of(arm.sensor.wrench))
        self._wrench.send(wrench, now)
        position, rotation = arm.pose
        pose = pose_of(position, frames.quaternion_of_rotation(rotation))
        self._pose.send(PoseStamped(header=self._base_header, pose=pose), now)
        for transform, origin, angle in zip(self._links.transforms, self._origins, angles, strict=True):
            transform.transform.rotation = _turned(origin, angle)
        self._tf.send(self._links, now)

    def publish_trace(self) -> None:
        """Every control cycle since the last trace, and the strongest force among them."""
        cycles = len(self._positions) // 6
        if cycles == 0:
            return
        wrenches = np.array(self._wrenches)
        self._trace.send(
            ControlTrace(
                header(self._traced - (cycles - 1) * CYCLE_NS, "tool0"),
                CYCLE,
                np.array(self._positions),
                np.array(self._targets),
                wrenches,
            ),
            self._traced,
        )
        forces = wrenches.reshape(-1, 6)[:, :3]
        strongest = forces[np.einsum("ij,ij->i", forces, forces).argmax()]
        self._peak_force.send(Float64MultiArray(layout=_FORCE_LAYOUT, data=strongest), self._traced)
        for rows in (self._positions, self._targets, self._wrenches):
            rows.clear()
