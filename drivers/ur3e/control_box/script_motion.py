# ruff: noqa: N803 - names of parameters are URScript's
"""URScript's motions, on the arm's controller. Each is a generator: a bare `yield` lets a control cycle pass.

One thread at a time may move the arm, as on a UR. A motion whose thread is killed, or that nobody goes on with, brakes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from drivers.ur3e import frames
from drivers.ur3e.kinematics import Kinematics
from drivers.ur3e.motion import PathBlend, PathMove
from drivers.ur3e.parameters import CYCLE, JOINTS, MOVEJ_ACCELERATION, MOVEJ_SPEED, MOVEL_ACCELERATION, MOVEL_SPEED
from drivers.ur3e.path import Line, Path, Pose, arc
from drivers.ur3e.urscript.values import Pose as PoseValue
from runtime.errors import ArmError

if TYPE_CHECKING:
    from drivers.ur3e.control_box.box import ControlBox

Cycles: TypeAlias = Generator[None, None, Any]

# Assumed: how an arm brakes that no command moves any more.
ABANDONED_DECELERATION = 5.0  # [rad/s^2]
# Assumed: what the fractions of optimovej and optimovel are fractions of.
_TOP_JOINT_SPEED, _TOP_JOINT_ACCELERATION = min(joint.speed for joint in JOINTS), 14.0  # [rad/s], [rad/s^2]
_TOP_SPEED, _TOP_ACCELERATION = 1.0, 5.0  # [m/s], [m/s^2]
_LEAST = 1e-3  # least speed and acceleration: zero would never arrive
_LOOKAHEADS, _GAINS = (0.03, 0.2), (100.0, 2000.0)  # of servoj, URScript manual


def joints_of(value: Sequence[float]) -> list[float]:
    """Joint angles (6,) [rad] out of a script's list."""
    if len(value) != len(JOINTS):
        raise ArmError(f"six joint values are needed, got {len(value)}")
    return [float(item) for item in value]


class MotionBuiltins:
    """The functions that move the arm; `mover` is who moves it at present."""

    def __init__(self, box: ControlBox, current: Callable[[], object]) -> None:
        self._box = box
        self._arm = box.arm
        self._controller = box.arm.controller
        self._current = current  # the thread that runs now
        self._kinematics = Kinematics()
        self.mover: object | None = None
        self._coasting = False  # the motion under way ends by itself, and may be blended into

    # Ownership

    @contextmanager
    def _claim(self) -> Iterator[None]:
        """Take the arm for a motion of the present thread."""
        me = self._current()
        if self.mover is not None and self.mover != me:
            raise ArmError("another thread is already controlling the robot")
        self.mover = me
        self._arm.end_torque()
        try:
            yield
        finally:
            self.mover = None

    def after_programs(self) -> None:
        """Brake what nobody moves any more."""
        if self.mover is None:
            self._arm.end_torque()
        controller = self._controller
        if self.mover is None and not self._coasting and not controller.idle:
            controller.set_joint_speed([0.0] * 6, ABANDONED_DECELERATION)
        if controller.idle:
            self._coasting = False

    def _travel(self, begin: Callable[[], None], radius: float = 0.0, corner: Sequence[float] | None = None) -> Cycles:
        """Begin a motion and wait until it ends, or until it is `radius` [m] from its end and slowing down.

        A protective stop takes the motion away; it begins anew once the program goes on.
        """
        controller, arm = self._controller, self._arm
        self._coasting = False
        stops = arm.stops
        begin()
        yield
        while not controller.idle or arm.stops != stops:
            if arm.stops != stops:
                stops = arm.stops
                begin()
            if radius > 0 and self._near(radius, corner):
                self._coasting = True
                return
            yield

    def _near(self, radius: float, corner: Sequence[float] | None) -> bool:
        motion = self._controller.motion
        if not getattr(motion, "slowing", False):
            return False
        if isinstance(motion, (PathMove, PathBlend)):
            return motion.left <= radius
        return corner is not None and math.dist(self._controller.position, corner) <= radius

    def _settled(self, *, for_path: bool) -> Cycles:
        """Bring the arm to rest, unless what moves it can be blended with a path, or with a move of the joints."""
        controller = self._controller
        motion = controller.motion
        if self._coasting:
            if isinstance(motion, (PathMove, PathBlend)) == for_path:
                return
            while not controller.idle:
                yield
        elif not controller.idle:
            controller.set_joint_speed([0.0] * 6, ABANDONED_DECELERATION)
            while not controller.idle:
                yield

    def _reached(self, q: Sequence[float]) -> Pose:
        """Where the TCP is at joint angles (6,), in base_link."""
        self._kinematics.set_tcp(self._arm.tcp_offset)
        return self._kinematics.forward(np.array(joints_of(q)))

    def _pose(self, target: Sequence[float]) -> Pose:
        """A target given as a pose or as joint angles."""
        return frames.ros_pose(target) if isinstance(target, PoseValue) else self._reached(target)

    def _angles(self, target: Sequence[float]) -> list[float]:
        """A target given as joint angles or as a pose."""
        if isinstance(target, PoseValue):
            return self._arm.getInverseKinematics(target, self._controller.q.tolist())
        return joints_of(target)

    # Moves

    def movej(
        self, q: Sequence[float], a: float = MOVEJ_ACCELERATION, v: float = MOVEJ_SPEED, t: float = 0, r: float = 0
    ) -> Cycles:
        """Move all joints together; `q` joint angles or a pose, `r` [m] where it may run into the next move."""
        with self._claim():
            yield from self._settled(for_path=False)
            target = self._angles(q)
            corner = self._reached(target)[0]
            blend = self._coasting

            def begin() -> None:
                self._controller.move_joints(target, max(v, _LEAST), max(a, _LEAST), t, blend=blend)

            yield from self._travel(begin, r, corner)

    def _move_along(self, path: Callable[[Pose], Path], a: float, v: float, t: float, r: float) -> Cycles:
        with self._claim():
            yield from self._settled(for_path=True)
            blend = self._coasting

            def begin() -> None:
                way = path(self._controller.corner if blend else self._controller.commanded)
                try:
                    self._controller.move_along(way, max(v, _LEAST), max(a, _LEAST), t, blend=blend)
                except ArmError as error:  # a way that the arm cannot go stops it, and leaves the program paused
                    self._arm.protective_stop(str(error))

            yield from self._travel(begin, r)

    def movel(
        self,
        pose: Sequence[float],
        a: float = MOVEL_ACCELERATION,
        v: float = MOVEL_SPEED,
        t: float = 0,
        r: float = 0,
    ) -> Cycles:
        """Move the TCP in a straight line, to a pose or to where joint angles put it."""
        target = self._pose(pose)
        yield from self._move_along(lambda start: Line(start, target), a, v, t, r)

    def movep(
        self, pose: Sequence[float], a: float = MOVEL_ACCELERATION, v: float = MOVEL_SPEED, r: float = 0
    ) -> Cycles:
        """Process move: a straight line whose corners are cut. Unlike a UR's it slows down in them."""
        yield from self.movel(pose, a, v, 0, r)

    def movec(
        self,
        pose_via: Sequence[float],
        pose_to: Sequence[float],
        a: float = MOVEL_ACCELERATION,
        v: float = MOVEL_SPEED,
        r: float = 0,
        mode: int = 0,
    ) -> Cycles:
        """Move the TCP along a circle through `pose_via`; mode 0 turns evenly to the end's rotation, 1 with the arc."""
        via, target = self._pose(pose_via)[0], self._pose(pose_to)
        yield from self._move_along(lambda start: arc(start, via, target, "fixed" if mode == 1 else "free"), a, v, 0, r)

    def optimovej(self, q: Sequence[float], a: float = 0.3, v: float = 0.3, r: float = 0) -> Cycles:
        """Like movej, with speed and acceleration as shares 0..1 of what the arm can do."""
        yield from self.movej(q, a * _TOP_JOINT_ACCELERATION, v * _TOP_JOINT_SPEED, 0, r)

    def optimovel(self, pose: Sequence[float], a: float = 0.3, v: float = 0.3, r: float = 0) -> Cycles:
        """Like movel, with speed and acceleration as shares 0..1 of what the arm can do."""
        yield from self.movel(pose, a * _TOP_ACCELERATION, v * _TOP_SPEED, 0, r)

    # Following and speeds

    def _lasting(self, duration: float) -> Cycles:
        """Let a time [s] of the path pass: it takes longer while the speed is scaled down, at least a cycle's worth."""
        left = max(duration, CYCLE)
        while True:
            yield
            step = CYCLE * self._controller.scaling
            left -= step
            if left < step / 2:
                return

    def servoj(
        self,
        q: Sequence[float],
        a: float = 0,  # noqa: ARG002 - not used by a UR either
        v: float = 0,  # noqa: ARG002
        t: float = CYCLE,
        lookahead_time: float = 0.1,
        gain: float = 300,
    ) -> Cycles:
        """Follow joint angles for `t` [s]."""
        with self._claim():
            self._coasting = False
            lookahead = min(max(lookahead_time, _LOOKAHEADS[0]), _LOOKAHEADS[1])
            self._controller.set_joint_servo(self._angles(q), lookahead, min(max(gain, _GAINS[0]), _GAINS[1]))
            for _ in range(max(1, round(t / CYCLE))):
                yield

    def servoc(
        self, pose: Sequence[float], a: float = MOVEL_ACCELERATION, v: float = MOVEL_SPEED, r: float = 0
    ) -> Cycles:
        """Go to a pose that may be renewed: on a straight line from wherever the arm is."""
        controller = self._controller
        target = self._pose(pose)
        with self._claim():
            self._coasting = False
            motion = controller.motion
            if not (isinstance(motion, (PathMove, PathBlend)) and motion.path.target == target):
                blend = isinstance(motion, (PathMove, PathBlend))
                start = controller.corner if blend else controller.commanded
                controller.move_along(Line(start, target), max(v, _LEAST), max(a, _LEAST), blend=blend)
            yield
            while not controller.idle and not self._near(r, None):
                yield

    def speedj(self, qd: Sequence[float], a: float = 0.5, t: float = 0) -> Cycles:
        """Joint speeds (6,) [rad/s], for `t` [s] or until they are reached."""
        controller = self._controller
        with self._claim():
            self._coasting = False
            controller.set_joint_speed(joints_of(qd), max(a, _LEAST))
            motion = controller.motion
            yield from self._lasting(t)
            while t <= 0 and controller.motion is motion and not getattr(motion, "reached", True):
                yield

    def speedl(
        self,
        xd: Sequence[float],
        a: float = 0.5,
        t: float = 0,
        aRot: float = 0,  # noqa: ARG002 - turning keeps the share of the acceleration that moving has
    ) -> Cycles:
        """A twist (6,) [m/s, rad/s] of the TCP, for `t` [s] or until it is reached."""
        controller = self._controller
        if len(xd) != 6:
            raise ArmError(f"a twist has six values, got {len(xd)}")
        with self._claim():
            self._coasting = False
            controller.set_speed(frames.turn_base_wrench([float(value) for value in xd]), max(a, _LEAST))
            motion = controller.motion
            yield from self._lasting(t)
            while t <= 0 and controller.motion is motion and not getattr(motion, "reached", True):
                yield

    def stopj(self, a: float = 2.0) -> Cycles:
        """Brake the joints with `a` [rad/s^2]."""
        controller = self._controller
        with self._claim():
            self._coasting = False
            if not controller.idle:
                controller.set_joint_speed([0.0] * 6, max(a, _LEAST))
                while not controller.idle:
                    yield

    def stopl(self, a: float = 3.0, aRot: float = 0) -> Cycles:  # noqa: ARG002 - see speedl
        """Brake the TCP along its way with `a` [m/s^2]."""
        controller = self._controller
        with self._claim():
            self._coasting = False
            if not controller.idle:
                controller.set_speed([0.0] * 6, max(a, _LEAST))
                while not controller.idle:
                    yield

    def direct_torque(
        self,
        torque: Sequence[float],
        friction_comp: bool = True,
        viscous_scale: Sequence[float] = (1.0,) * 6,
        coulomb_scale: Sequence[float] = (1.0,) * 6,  # noqa: ARG002 - the simulated joints have no dry friction
    ) -> Cycles:
        """Joint torques (6,) [Nm] for one cycle, on top of those that balance gravity."""
        arm = self._arm
        me = self._current()
        if self.mover is not None and self.mover != me:
            raise ArmError("another thread is already controlling the robot")
        self.mover = me
        try:
            self._coasting = False
            scale = joints_of(viscous_scale) if friction_comp else [0.0] * 6
            speeds = arm.getActualQd()
            friction = [k * joint.damping * qd for k, joint, qd in zip(scale, JOINTS, speeds, strict=True)]
            arm.torque = [t + f for t, f in zip(joints_of(torque), friction, strict=True)]
            yield
        finally:
            self.mover = None

    # Force mode and hand guiding

    def force_mode(
        self,
        task_frame: Sequence[float],
        selection_vector: Sequence[float],
        wrench: Sequence[float],
        type: float,  # noqa: A002
        limits: Sequence[float],
    ) -> None:
        """See `Arm.forceMode`; the motions go on beside it."""
        selected = [int(value) for value in joints_of(selection_vector)]
        self._arm.forceMode(task_frame, selected, joints_of(wrench), int(type), joints_of(limits))

    def end_force_mode(self) -> None:
        """The arm holds where it is."""
        self._arm.forceModeStop()

    def force_mode_set_damping(self, damping: float) -> None:
        """See `SimulatedArm.forceModeSetDamping`."""
        self._arm.forceModeSetDamping(damping)

    def force_mode_set_gain_scaling(self, scaling: float) -> None:
        """See `SimulatedArm.forceModeSetGainScaling`."""
        self._arm.forceModeSetGainScaling(scaling)

    def freedrive_mode(
        self, freeAxes: Sequence[float] = (1, 1, 1, 1, 1, 1), feature: Sequence[float] | str = "base"
    ) -> None:
        """The tool can be led by hand along the free axes (6,) of `feature`: a pose, `base` or `tool`."""
        if isinstance(feature, str):
            known = {"base": frames.turn_base_rotation(frames.IDENTITY), "tool": self._controller.rotation}
            if feature not in known:
                raise ArmError(f"freedrive knows no feature {feature!r}; known: base, tool, or a pose")
            frame = known[feature]
        else:
            frame = frames.ros_pose(feature)[1]
        free = tuple(int(bool(value)) for value in joints_of(freeAxes))
        self._box.guide_by_hand(frame, free)

    def end_freedrive_mode(self) -> None:
        """The arm holds where it is."""
        self._box.hold()

    def teach_mode(self) -> None:
        """Freedrive along all axes."""
        self._box.guide_by_hand()

    def end_teach_mode(self) -> None:
        """The arm holds where it is."""
        self._box.hold()

    def get_freedrive_status(self) -> int:
        """0: free to move; 1: close to a singularity, where a UR grows stiff."""
        jacobian = self._controller.kinematics.jacobian()
        return 1 if float(np.linalg.svd(jacobian, compute_uv=False)[-1]) < 0.02 else 0

    def protective_stop(self) -> None:
        """Cause a protective stop."""
        self._arm.protective_stop("a program called protective_stop")

    def get_target_waypoint(self) -> PoseValue:
        """Where the motion under way ends; where the arm is commanded to be if there is none."""
        motion = self._controller.motion
        if isinstance(motion, (PathMove, PathBlend)):
            return PoseValue(frames.ur_pose(*motion.path.target))
        target = getattr(motion, "target", None)
        return PoseValue(frames.ur_pose(*(self._controller.commanded if target is None else self._reached(target))))
