"""Motions of the TCP and of the joints, as the controller steps through them in path time. Frame: base_link.

Each kind knows where the arm should be one step on; none knows the arm. Path time advances slower than the clock
while the speed scaling is below 1, which keeps the path.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.ur3e import frames
from drivers.ur3e.frames import Rotation, Vector

Array = NDArray[np.float64]
Step = list[float]  # (6,) displacement of the TCP in one cycle: [m] and rotation vector [rad]

# Assumed: URScript gives movel one speed, in m/s; turning is limited to movej's default speed and acceleration.
TURN_SPEED, TURN_ACCELERATION = 1.05, 1.4  # [rad/s], [rad/s^2]
_ARRIVED = 1e-9  # [m], [rad]


@dataclass(frozen=True)
class Trapezoid:
    """Progress from 0 to 1 with limited speed and acceleration, both per unit of the way."""

    speed: float  # [1/s]
    acceleration: float  # [1/s^2]
    duration: float  # [s] of the whole way

    @staticmethod
    def over(distances: Sequence[float], speeds: Sequence[float], accelerations: Sequence[float]) -> Trapezoid:
        """The fastest profile that keeps each distance within its speed and acceleration."""
        moving = [i for i, distance in enumerate(distances) if distance > 0]
        if not moving:
            return Trapezoid(math.inf, math.inf, 0.0)
        acceleration = min(accelerations[i] / distances[i] for i in moving)
        speed = min(math.sqrt(acceleration), *(speeds[i] / distances[i] for i in moving))
        return Trapezoid(speed, acceleration, 1 / speed + speed / acceleration)

    def progress(self, time: float) -> float:
        """Share of the way done at `time` [s]."""
        if time >= self.duration:
            return 1.0
        ramp = self.speed / self.acceleration
        if time < ramp:
            return 0.5 * self.acceleration * time * time
        left = self.duration - time
        if left < ramp:
            return 1 - 0.5 * self.acceleration * left * left
        return self.speed * (time - 0.5 * ramp)


class JointMove:
    """All joints together from one configuration to another (moveJ)."""

    def __init__(self, start: Array, target: Array, speed: float, acceleration: float) -> None:
        self.start, self.target = start.copy(), target.copy()
        longest = float(np.abs(target - start).max())
        self._profile = Trapezoid.over([longest], [speed], [acceleration])
        self._time = 0.0
        self.done = False

    def joints(self, dt: float) -> Array:
        """Joint angles (6,) [rad] after `dt` [s] more of path time."""
        self._time += dt
        self.done = self._time >= self._profile.duration
        return self.start + self._profile.progress(self._time) * (self.target - self.start)


class Linear:
    """The TCP in a straight line, turning evenly, to a pose (moveL)."""

    def __init__(
        self, start: tuple[Vector, Rotation], target: tuple[Vector, Rotation], speed: float, acceleration: float
    ) -> None:
        self.target, self.speed, self.acceleration = target, speed, acceleration
        self._start, self._rotation = start
        self._way = tuple(b - a for a, b in zip(start[0], target[0], strict=True))
        self._turn = frames.vector_of_rotation(frames.product(target[1], frames.transpose(start[1])))
        angle = math.hypot(*self._turn)
        self._turns = angle > 1e-9
        self._profile = Trapezoid.over(
            [math.hypot(*self._way), angle], [speed, TURN_SPEED], [acceleration, TURN_ACCELERATION]
        )
        self._time = 0.0
        self.elapsed = False  # the time for the way is over
        self.done = False

    def pose(self, progress: float) -> tuple[Vector, Rotation]:
        """Pose after a share of the way."""
        (x, y, z), (dx, dy, dz) = self._start, self._way
        rotation = self.target[1]
        if self._turns and progress < 1:
            rx, ry, rz = self._turn
            partly = frames.rotation_of_vector((rx * progress, ry * progress, rz * progress))
            rotation = frames.product(partly, self._rotation)
        return (x + dx * progress, y + dy * progress, z + dz * progress), rotation

    def step(self, dt: float, position: Vector, rotation: Rotation) -> Step:
        """Displacement from the commanded pose to the one `dt` [s] of path time on."""
        self._time += dt
        step = _displacement(*self.pose(self._profile.progress(self._time)), position, rotation)
        self.elapsed = self._time >= self._profile.duration
        self.done = self.elapsed and max(map(abs, step)) < _ARRIVED
        return step

    def slowed(self, lost: float, position: Vector, rotation: Rotation) -> None:  # noqa: ARG002
        """The joints could not follow: take back path time [s]."""
        self._time -= lost


class Speed:
    """The TCP at a twist, reached with limited acceleration (speedL, and every stop)."""

    def __init__(
        self,
        twist: Sequence[float],
        target: Sequence[float],
        acceleration: float,
        pose: tuple[Vector, Rotation],
        time: float,
    ) -> None:
        self.twist = list(twist)  # (6,) [m/s, rad/s] at present
        self._left = time if time > 0 else math.inf
        self.set(target, acceleration)
        self._position, self._rotation = pose
        self.done = False

    def set(self, target: Sequence[float], acceleration: float, time: float = 0.0) -> None:
        """Aim at another twist from here on."""
        self._target = [float(value) for value in target]
        self._acceleration = acceleration
        self._left = time if time > 0 else math.inf
        self._stopping = not any(self._target)

    def step(self, dt: float, position: Vector, rotation: Rotation) -> Step:
        """Displacement from the commanded pose to the one `dt` [s] of path time on."""
        self._left -= dt
        if self._left <= 0:
            self._target, self._stopping = [0.0] * 6, True
        v = self.twist
        if v != self._target:
            difference = [b - a for a, b in zip(v, self._target, strict=True)]
            largest = max(math.hypot(*difference[:3]), math.hypot(*difference[3:]))
            share = self._acceleration * dt / largest
            v = self._target[:] if share >= 1 else [a + share * d for a, d in zip(v, difference, strict=True)]
            self.twist = v
        self.done = self._stopping and not any(v)
        x, y, z = self._position
        self._position = (x + v[0] * dt, y + v[1] * dt, z + v[2] * dt)
        if v[3] or v[4] or v[5]:
            turned = frames.rotation_of_vector((v[3] * dt, v[4] * dt, v[5] * dt))
            self._rotation = frames.product(turned, self._rotation)
        return _displacement(self._position, self._rotation, position, rotation)

    def slowed(self, lost: float, position: Vector, rotation: Rotation) -> None:  # noqa: ARG002
        """The joints could not follow: go on from where they are."""
        self._position, self._rotation = position, rotation


class Servo:
    """The TCP after a pose that is renewed all the time (servoL).

    UR's smoothing is not published. Assumed: a first-order lag of the look-ahead time, shortened by a higher gain.
    """

    def __init__(self, pose: tuple[Vector, Rotation], lookahead: float, gain: float) -> None:
        self.done = False
        self.set(pose, lookahead, gain)

    def set(self, pose: tuple[Vector, Rotation], lookahead: float, gain: float) -> None:
        """Follow another pose from here on."""
        self._pose = pose
        self._lag = lookahead * 300.0 / gain  # 300 is URScript's default gain

    def step(self, dt: float, position: Vector, rotation: Rotation) -> Step:
        """Displacement from the commanded pose to the one `dt` [s] of path time on."""
        share = -math.expm1(-dt / self._lag)
        turn = frames.vector_of_rotation(frames.product(self._pose[1], frames.transpose(rotation)))
        way = [b - a for a, b in zip(position, self._pose[0], strict=True)]
        return [share * value for value in (*way, *turn)]

    def slowed(self, lost: float, position: Vector, rotation: Rotation) -> None:
        """The joints could not follow: the lag takes care of it."""


class Compliance:
    """Force mode: selected axes of a task frame give way until they press as asked.

    Admittance for each selected axis: inertia dv/dt = wanted + felt - damping v, solved implicitly. Damping is chosen
    for the stiffest contact the cell has, about 90 N/mm: a touchdown at 5 mm/s overshoots 5 N by under 1 N.
    """

    INERTIA = (6.0, 6.0, 6.0, 0.08, 0.08, 0.08)  # [kg], [kg m^2] assumed
    DAMPING = (600.0, 600.0, 600.0, 8.0, 8.0, 8.0)  # [Ns/m], [Nms/rad] assumed

    def __init__(
        self, frame: Rotation, selection: Sequence[int], wrench: Sequence[float], limits: Sequence[float]
    ) -> None:
        self.frame = frame
        self.axes = [i for i in range(6) if selection[i]]
        self.others = [i for i in range(6) if not selection[i]]
        self.wrench = [float(value) for value in wrench]
        self.limits = [abs(float(value)) for value in limits]
        self.speed = [0.0] * 6

    def blend(self, step: Step, felt: Sequence[float], dt: float) -> Step:
        """The motion's displacement with the selected axes' own in its place; `felt` is the wrench (6,), base_link."""
        frame = self.frame
        inside = [*frames.unrotate(frame, step[:3]), *frames.unrotate(frame, step[3:])]
        force = (*frames.unrotate(frame, felt[:3]), *frames.unrotate(frame, felt[3:]))
        for i in self.axes:
            rate = dt / self.INERTIA[i]
            speed = (self.speed[i] + rate * (self.wrench[i] + force[i])) / (1 + rate * self.DAMPING[i])
            limit = self.limits[i]
            self.speed[i] = speed = min(max(speed, -limit), limit)
            inside[i] = speed * dt
        return [*frames.rotate(frame, inside[:3]), *frames.rotate(frame, inside[3:])]

    def deviates(self, step: Step) -> bool:
        """Whether a deviation (6,) of the TCP, base_link, exceeds what the axes that are not compliant allow."""
        inside = (*frames.unrotate(self.frame, step[:3]), *frames.unrotate(self.frame, step[3:]))
        return any(abs(inside[i]) > self.limits[i] for i in self.others)

    def freeze(self) -> None:
        """Stand: nothing of the motion so far goes on."""
        self.speed = [0.0] * 6


def _displacement(position: Vector, rotation: Rotation, here: Vector, now: Rotation) -> Step:
    """From a pose (`here`, `now`) to another close by; half the cross products of the axes are the sine of the turn."""
    a, b = now, rotation
    return [
        position[0] - here[0],
        position[1] - here[1],
        position[2] - here[2],
        0.5 * (a[3] * b[6] - a[6] * b[3] + a[4] * b[7] - a[7] * b[4] + a[5] * b[8] - a[8] * b[5]),
        0.5 * (a[6] * b[0] - a[0] * b[6] + a[7] * b[1] - a[1] * b[7] + a[8] * b[2] - a[2] * b[8]),
        0.5 * (a[0] * b[3] - a[3] * b[0] + a[1] * b[4] - a[4] * b[1] + a[2] * b[5] - a[5] * b[2]),
    ]
