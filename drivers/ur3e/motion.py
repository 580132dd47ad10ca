"""Motions of the TCP, as the controller steps through them in path time. Frame: base_link.

Each kind knows where the arm should be one step on; none knows the arm. Path time advances slower than the clock
while the speed scaling is below 1, which keeps the path.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from drivers.ur3e import frames
from drivers.ur3e.frames import Rotation, Vector
from drivers.ur3e.path import Path, Pose

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

    @staticmethod
    def lasting(duration: float) -> Trapezoid:
        """A profile that takes `duration` [s], a third of it to speed up and a third to slow down."""
        return Trapezoid(1.5 / duration, 4.5 / duration**2, duration)

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

    def slowing(self, time: float) -> bool:
        """Whether the speed falls at `time` [s]."""
        return self.duration - time <= self.speed / self.acceleration


class PathMove:
    """The TCP along a path (moveL, moveC, moveP); `duration` [s], if given, instead of speed and acceleration."""

    def __init__(self, path: Path, speed: float, acceleration: float, duration: float = 0.0) -> None:
        self.path, self.speed, self.acceleration = path, speed, acceleration
        self._profile = (
            Trapezoid.lasting(duration)
            if duration > 0
            else Trapezoid.over([path.length, path.angle], [speed, TURN_SPEED], [acceleration, TURN_ACCELERATION])
        )
        self._time = 0.0
        self.elapsed = False  # the time for the way is over
        self.done = False

    def advance(self, dt: float) -> Pose:
        """Pose `dt` [s] of path time on."""
        self._time += dt
        self.elapsed = self._time >= self._profile.duration
        return self.path.at(self._profile.progress(self._time))

    def step(self, dt: float, position: Vector, rotation: Rotation) -> Step:
        """Displacement from the commanded pose to the one `dt` [s] of path time on."""
        step = displacement(*self.advance(dt), position, rotation)
        self.done = self.elapsed and max(map(abs, step)) < _ARRIVED
        return step

    def slowed(self, lost: float, position: Vector, rotation: Rotation) -> None:  # noqa: ARG002
        """The joints could not follow: take back path time [s]."""
        self._time -= lost

    @property
    def left(self) -> float:
        """[m] of the way that is left."""
        return self.path.length * (1.0 - self._profile.progress(self._time))

    @property
    def slowing(self) -> bool:
        """Whether the last part of the way has begun, in which the speed falls."""
        return self._profile.slowing(self._time)


class PathBlend:
    """Two paths run into each other: the second begins while the TCP slows down towards the first one's end.

    The displacement along the second is added to what is left of the first, so the corner is cut within the distance
    at which the second began. UR's own blends are not published.
    """

    def __init__(self, first: PathMove | PathBlend, second: PathMove) -> None:
        self._first, self._second = first, second
        self.path, self.speed, self.acceleration = second.path, second.speed, second.acceleration
        self._corner = second.path.at(0.0)
        self.done = False

    @property
    def elapsed(self) -> bool:
        """Whether the time for both ways is over."""
        return self._first.elapsed and self._second.elapsed

    def advance(self, dt: float) -> Pose:
        """Pose `dt` [s] of path time on."""
        (ax, ay, az), before = self._first.advance(dt)
        (bx, by, bz), after = self._second.advance(dt)
        (cx, cy, cz), corner = self._corner
        turned = frames.product(frames.product(after, frames.transpose(corner)), before)
        return (ax + bx - cx, ay + by - cy, az + bz - cz), turned

    def step(self, dt: float, position: Vector, rotation: Rotation) -> Step:
        """Displacement from the commanded pose to the one `dt` [s] of path time on."""
        step = displacement(*self.advance(dt), position, rotation)
        self.done = self.elapsed and max(map(abs, step)) < _ARRIVED
        return step

    def slowed(self, lost: float, position: Vector, rotation: Rotation) -> None:
        """The joints could not follow: take back path time [s]."""
        self._first.slowed(lost, position, rotation)
        self._second.slowed(lost, position, rotation)

    @property
    def left(self) -> float:
        """[m] of the second way that is left."""
        return self._second.left

    @property
    def slowing(self) -> bool:
        """Whether the second move slows down."""
        return self._first.elapsed and self._second.slowing


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

    @property
    def reached(self) -> bool:
        """Whether the TCP has the twist that was asked for."""
        return self.twist == self._target

    def step(self, dt: float, position: Vector, rotation: Rotation) -> Step:
        """Displacement from the commanded pose to the one `dt` [s] of path time on."""
        self._left -= dt
        if self._left < -dt / 2:
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
        return displacement(self._position, self._rotation, position, rotation)

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


def displacement(position: Vector, rotation: Rotation, here: Vector, now: Rotation) -> Step:
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
