"""The controller: one step each 2 ms, from motions to joint setpoints. No physics, no clock; frame base_link.

Twists become joint speeds through the inverse of the Jacobian at the commanded configuration, and each step aims at the
exact pose, so the error of one linearisation is taken up by the next.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dgesv

from drivers.ur3e.compliance import FIXED, Compliance
from drivers.ur3e.joint_motion import JointBlend, JointMove, JointServo, JointSpeed
from drivers.ur3e.kinematics import Kinematics, described
from drivers.ur3e.motion import PathBlend, PathMove, Servo, Speed
from drivers.ur3e.parameters import CYCLE, HALT_DECELERATION, JOINTS, RESUME_TIME, STOP_DECELERATION
from drivers.ur3e.path import Line, Path, Pose
from runtime.errors import ArmError

Array = NDArray[np.float64]
JointsMotion: TypeAlias = JointMove | JointBlend | JointSpeed | JointServo
Motion: TypeAlias = JointsMotion | PathMove | PathBlend | Speed | Servo

_OF_JOINTS = (JointMove, JointBlend, JointSpeed, JointServo)
_LIMITS = tuple(joint.speed * CYCLE for joint in JOINTS)  # [rad] per cycle
_REACH = tuple(joint.reach for joint in JOINTS)
_SINGULAR = 20.0  # times the joints' speed limit: no slow motion explains that
_SAMPLE = 0.05  # [m] between the points of a straight line that are checked before it starts
_SAMPLE_TURN = 0.3  # [rad]
_LEAP = math.pi  # [rad] between samples: the same pose again with a joint turned back by a whole turn


class Controller:
    """Commanded state of one arm. Reads nothing but the wrench it is given."""

    def __init__(self, kinematics: Kinematics, q: Sequence[float]) -> None:
        self.kinematics = kinematics
        self.q: Array = np.array(q, dtype=float)  # (6,) [rad] commanded
        self.qd = [0.0] * 6  # [rad/s] commanded
        self._last_qd = self.qd  # one cycle before
        self.scaling = 1.0  # of path time
        self.slider = 1.0  # share of the programmed speed that the operator allows
        self.motion: Motion | None = None
        self.compliance: Compliance | None = None
        self.position, self.rotation = kinematics.forward(self.q)
        self._top_speed = 0.0  # [rad/s] of the fastest joint, as it would be without scaling

    @property
    def idle(self) -> bool:
        """Whether no motion is under way."""
        return self.motion is None

    def set_tcp(self, offset: Sequence[float]) -> None:
        """Move the TCP to a pose (6,) in the flange's frame."""
        self.kinematics.set_tcp(offset)
        self.position, self.rotation = self.kinematics.forward(self.q)

    def move_joints(
        self, target: Sequence[float], speed: float, acceleration: float, duration: float = 0.0, *, blend: bool = False
    ) -> None:
        """Begin a moveJ, or run the move under way into it. Raises ArmError if a joint would go beyond its limit."""
        q = np.array(target, dtype=float)
        beyond = [i for i in range(6) if not abs(q[i]) <= JOINTS[i].reach + 1e-9]
        if beyond:
            wrong = ", ".join(f"{JOINTS[i].name} at {math.degrees(q[i]):.1f} deg" for i in beyond)
            raise ArmError(f"beyond the joints' limits: {wrong}")
        speed = min(speed, min(_LIMITS) / CYCLE)
        before = self.motion
        if blend and isinstance(before, (JointMove, JointBlend)):
            self.motion = JointBlend(before, JointMove(before.target, q, speed, acceleration, duration))
        else:
            self.motion = JointMove(self.q, q, speed, acceleration, duration)

    def move_linear(self, target: Pose, speed: float, acceleration: float, duration: float = 0.0) -> None:
        """Begin a moveL. Raises ArmError that names the target if it, or the way there, is out of reach."""
        self.move_along(Line((self.position, self.rotation), target), speed, acceleration, duration)

    def move_along(
        self, path: Path, speed: float, acceleration: float, duration: float = 0.0, *, blend: bool = False
    ) -> None:
        """Follow a path that begins at the commanded pose, or, to blend, where the path under way ends.

        Raises ArmError that names the target if it, or the way there, is out of reach.
        """
        points = 1 + int(path.length / _SAMPLE + path.angle / _SAMPLE_TURN)
        near = self.q
        try:
            for index in range(1, points + 1):
                found = self.kinematics.inverse(*path.at(index / points), near)
                if float(np.abs(found - near).max()) > _LEAP:
                    raise ArmError("a joint would have to turn beyond its limit")
                near = found
        except ArmError as error:
            raise ArmError(f"no straight way to {described(*path.target)}: {error}") from None
        finally:
            self.kinematics.forward(self.q)
        move = PathMove(path, speed, acceleration, duration)
        before = self.motion
        self.motion = PathBlend(before, move) if blend and isinstance(before, (PathMove, PathBlend)) else move

    @property
    def corner(self) -> Pose:
        """Where the motion under way will end, as the start of one that blends with it; else the commanded pose."""
        return self.motion.path.target if isinstance(self.motion, (PathMove, PathBlend)) else self.commanded

    @property
    def commanded(self) -> Pose:
        """Pose of the TCP that is commanded at present."""
        return self.position, self.rotation

    def set_speed(self, twist: Sequence[float], acceleration: float, time: float = 0.0) -> None:
        """Begin or change a speedL; a twist of zeros is a stop."""
        if isinstance(self.motion, Speed):
            self.motion.set(twist, acceleration, time)
        else:
            self.motion = Speed(self._unscaled(self.twist()), twist, acceleration, self.commanded, time)

    def set_servo(self, target: Pose, lookahead: float, gain: float) -> None:
        """Begin or change a servoL."""
        if isinstance(self.motion, Servo):
            self.motion.set(target, lookahead, gain)
        else:
            self.motion = Servo(target, lookahead, gain)

    def set_joint_speed(self, speeds: Sequence[float], acceleration: float, time: float = 0.0) -> None:
        """Begin or change a speedJ; speeds (6,) [rad/s] of zeros are a stop."""
        if isinstance(self.motion, JointSpeed):
            self.motion.set(speeds, acceleration, time)
        else:
            self.motion = JointSpeed(self._unscaled(self.qd), speeds, acceleration, time)

    def set_joint_servo(self, target: Sequence[float], lookahead: float, gain: float) -> None:
        """Begin or change a servoJ."""
        if isinstance(self.motion, JointServo):
            self.motion.set(target, lookahead, gain)
        else:
            self.motion = JointServo(target, lookahead, gain)

    def _unscaled(self, speeds: Sequence[float]) -> list[float]:
        """Speeds in path time, which the scaling slows down."""
        return [value / self.scaling for value in speeds] if self.scaling > 0 else [0.0] * 6

    def comply(self, compliance: Compliance | None) -> None:
        """Begin or end force mode. A motion under way goes on from where the arm has been pushed to."""
        if isinstance(self.motion, (PathMove, PathBlend)):
            self.move_linear(self.motion.path.target, self.motion.speed, self.motion.acceleration)
        elif isinstance(self.motion, Speed):
            self.motion.slowed(0.0, self.position, self.rotation)
        self.compliance = compliance
        self._anchor = Speed([0.0] * 6, [0.0] * 6, 1.0, self.commanded, 0.0)

    def follow(self, q: Sequence[float]) -> None:
        """Take the arm to be commanded where it is: something else moves it."""
        self.motion = None
        self.q = np.array(q, dtype=float)
        self.qd = [0.0] * 6
        self.position, self.rotation = self.kinematics.forward(self.q)

    def halt(self) -> None:
        """Drop every motion; what speed there is, is braked away in the cycles that follow."""
        self.motion = self.compliance = None

    def brake(self) -> None:
        """One cycle of a category 0 stop: the joints slow down together, and stay within their limits."""
        self._last_qd = self.qd
        fastest = max(map(abs, self.qd))
        share = max(0.0, 1.0 - HALT_DECELERATION * CYCLE / fastest) if fastest > 0 else 0.0
        if share == 0.0:
            self.qd = [0.0] * 6
            self._top_speed = 0.0
            return
        moved = self.q + np.array(self.qd) * (share * CYCLE)
        moved = np.clip(moved, [-reach for reach in _REACH], _REACH)
        self.qd = ((moved - self.q) / CYCLE).tolist()
        self.q = moved
        self.position, self.rotation = self.kinematics.forward(moved)

    @property
    def qdd(self) -> list[float]:
        """Commanded joint accelerations (6,) [rad/s^2] of the last cycle."""
        return [(now - before) / CYCLE for now, before in zip(self.qd, self._last_qd, strict=True)]

    def twist(self) -> list[float]:
        """Twist (6,) [m/s, rad/s] of the commanded motion."""
        twist: list[float] = (self.kinematics.jacobian() @ self.qd).tolist()
        return twist

    def step(self, permitted: bool, wrench: Sequence[float] | None) -> None:
        """One cycle. Without permission the motion is braked along its path; `wrench` (6,) is needed in force mode
        only.

        Raises ArmError, with the arm standing, if the motion cannot be followed.
        """
        self._last_qd = self.qd
        self._scale(permitted)
        motion, compliance = self.motion, self.compliance
        if self.scaling == 0.0 or (motion is None and compliance is None):
            if compliance is not None:
                compliance.freeze()
            if any(self.qd):
                if self.scaling > 0:
                    self.brake()
                else:
                    self.qd = [0.0] * 6
            return
        dt = CYCLE * self.scaling
        if compliance is not None and compliance.kind != FIXED:
            compliance.turn(self.position, self.twist())
        if isinstance(motion, _OF_JOINTS):
            change: list[float] = (motion.joints(dt, self.q) - self.q).tolist()
            if compliance is not None and wrench is not None:
                change = self._solve(
                    compliance.blend((self.kinematics.jacobian() @ np.array(change)).tolist(), wrench, dt)
                )
        else:
            step = (motion or self._anchor).step(dt, self.position, self.rotation)
            if compliance is not None and wrench is not None:
                step = compliance.blend(step, wrench, dt)
            change = self._solve(step)
        self._advance(change, motion, dt)
        if motion is not None and (motion.done or (compliance is not None and self._over(motion))):
            self.motion = None
            if compliance is not None:
                self._anchor.slowed(0.0, self.position, self.rotation)

    def _over(self, motion: Motion) -> bool:
        """In force mode a straight line is over when its time is: the compliant axes need not arrive."""
        return isinstance(motion, (PathMove, PathBlend)) and motion.elapsed

    def _scale(self, permitted: bool) -> None:
        """Path time runs as fast as the slider says, or not at all; it slows down within what the joints can brake."""
        goal = self.slider if permitted else 0.0
        if self.scaling < goal:
            self.scaling = min(goal, self.scaling + CYCLE / RESUME_TIME)
        elif self.scaling > goal:
            allowed = STOP_DECELERATION * CYCLE
            self.scaling = max(goal, self.scaling - allowed / self._top_speed) if self._top_speed > allowed else goal

    def _solve(self, step: Sequence[float]) -> list[float]:
        """Joint displacement (6,) [rad] for one of the TCP."""
        _, _, change, singular = dgesv(self.kinematics.jacobian(), step)
        if singular:
            self.halt()
            raise ArmError(f"singular: {described(self.position, self.rotation)}")
        result: list[float] = change.tolist()
        return result

    def _advance(self, change: list[float], motion: Motion | None, dt: float) -> None:
        a, b, c, d, e, f = change
        k, m, n, o, p, q = _LIMITS
        excess = max(abs(a) / k, abs(b) / m, abs(c) / n, abs(d) / o, abs(e) / p, abs(f) / q)
        if excess > 1.0:
            if excess > _SINGULAR:
                self.halt()
                raise ArmError(
                    f"the joints would have to exceed {_SINGULAR:.0f} times their speed limit near a singularity: "
                    f"{described(self.position, self.rotation)}"
                )
            change = [value / excess for value in change]
        moved = self.q + change
        a, b, c, d, e, f = moved.tolist()
        k, m, n, o, p, q = _REACH
        if not (-k <= a <= k and -m <= b <= m and -n <= c <= n and -o <= d <= o and -p <= e <= p and -q <= f <= q):
            self.halt()
            raise ArmError(f"beyond the joints' limits: {described(self.position, self.rotation)}")
        self.q = moved
        self.qd = [value / CYCLE for value in change]
        self._top_speed = max(map(abs, self.qd)) / self.scaling
        self.position, self.rotation = self.kinematics.forward(moved)
        if excess > 1.0 and motion is not None and not isinstance(motion, _OF_JOINTS):
            motion.slowed(dt * (1 - 1 / excess), self.position, self.rotation)
