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

from drivers.ur3e.frames import Rotation, Vector
from drivers.ur3e.kinematics import Kinematics, described
from drivers.ur3e.motion import Compliance, JointMove, Linear, Servo, Speed
from drivers.ur3e.parameters import CYCLE, JOINTS, RESUME_TIME, STOP_DECELERATION
from runtime.errors import ArmError

Array = NDArray[np.float64]
Pose = tuple[Vector, Rotation]
Motion: TypeAlias = JointMove | Linear | Speed | Servo

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
        self.scaling = 1.0  # of path time
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

    def move_joints(self, target: Sequence[float], speed: float, acceleration: float) -> None:
        """Begin a moveJ. Raises ArmError if a joint would go beyond its limit."""
        q = np.array(target, dtype=float)
        beyond = [i for i in range(6) if not abs(q[i]) <= JOINTS[i].reach + 1e-9]
        if beyond:
            wrong = ", ".join(f"{JOINTS[i].name} at {math.degrees(q[i]):.1f} deg" for i in beyond)
            raise ArmError(f"beyond the joints' limits: {wrong}")
        speed = min(speed, min(_LIMITS) / CYCLE)
        self.motion = JointMove(self.q, q, speed, acceleration)

    def move_linear(self, target: Pose, speed: float, acceleration: float) -> None:
        """Begin a moveL. Raises ArmError that names the target if it, or the way there, is out of reach."""
        motion = Linear((self.position, self.rotation), target, speed, acceleration)
        length = math.dist(self.position, target[0])
        turn = sum(abs(a - b) for a, b in zip(self.rotation, target[1], strict=True))
        points = 1 + int(length / _SAMPLE + turn / _SAMPLE_TURN)
        near = self.q
        try:
            for index in range(1, points + 1):
                found = self.kinematics.inverse(*motion.pose(index / points), near)
                if float(np.abs(found - near).max()) > _LEAP:
                    raise ArmError("a joint would have to turn beyond its limit")
                near = found
        except ArmError as error:
            raise ArmError(f"no straight way to {described(*target)}: {error}") from None
        finally:
            self.kinematics.forward(self.q)
        self.motion = motion

    def set_speed(self, twist: Sequence[float], acceleration: float, time: float = 0.0) -> None:
        """Begin or change a speedL; a twist of zeros is a stop."""
        if isinstance(self.motion, Speed):
            self.motion.set(twist, acceleration, time)
        else:
            self.motion = Speed(self.twist(), twist, acceleration, (self.position, self.rotation), time)

    def set_servo(self, target: Pose, lookahead: float, gain: float) -> None:
        """Begin or change a servoL."""
        if isinstance(self.motion, Servo):
            self.motion.set(target, lookahead, gain)
        else:
            self.motion = Servo(target, lookahead, gain)

    def comply(self, compliance: Compliance | None) -> None:
        """Begin or end force mode. A motion under way goes on from where the arm has been pushed to."""
        if isinstance(self.motion, Linear):
            self.move_linear(self.motion.target, self.motion.speed, self.motion.acceleration)
        elif isinstance(self.motion, Speed):
            self.motion.slowed(0.0, self.position, self.rotation)
        self.compliance = compliance
        self._anchor = Speed([0.0] * 6, [0.0] * 6, 1.0, (self.position, self.rotation), 0.0)

    def halt(self) -> None:
        """Drop every motion and stand."""
        self.motion = self.compliance = None
        self.qd = [0.0] * 6
        self._top_speed = 0.0

    def twist(self) -> list[float]:
        """Twist (6,) [m/s, rad/s] of the commanded motion."""
        twist: list[float] = (self.kinematics.jacobian() @ self.qd).tolist()
        return twist

    def step(self, permitted: bool, wrench: Sequence[float] | None) -> None:
        """One cycle. Without permission the motion is braked along its path; `wrench` (6,) is needed in force mode
        only.

        Raises ArmError, with the arm standing, if the motion cannot be followed.
        """
        self._scale(permitted)
        motion, compliance = self.motion, self.compliance
        if self.scaling == 0.0 or (motion is None and compliance is None):
            if compliance is not None:
                compliance.freeze()
            if any(self.qd):
                self.qd = [0.0] * 6
                if self.scaling > 0:
                    self._top_speed = 0.0
            return
        dt = CYCLE * self.scaling
        if isinstance(motion, JointMove):
            change: list[float] = (motion.joints(dt) - self.q).tolist()
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
        return isinstance(motion, Linear) and motion.elapsed

    def _scale(self, permitted: bool) -> None:
        """Path time runs slower the longer motion is not permitted, within what the joints can brake."""
        if permitted:
            if self.scaling < 1.0:
                self.scaling = min(1.0, self.scaling + CYCLE / RESUME_TIME)
        elif self.scaling > 0.0:
            allowed = STOP_DECELERATION * CYCLE
            self.scaling = max(0.0, self.scaling - allowed / self._top_speed) if self._top_speed > allowed else 0.0

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
        if excess > 1.0 and motion is not None and not isinstance(motion, JointMove):
            motion.slowed(dt * (1 - 1 / excess), self.position, self.rotation)
