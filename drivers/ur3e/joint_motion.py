"""Motions of the joints, as the controller steps through them in path time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.ur3e.motion import Trapezoid

Array = NDArray[np.float64]


class JointMotion(Protocol):
    """Where the joints should be, step after step."""

    done: bool

    def joints(self, dt: float, q: Array) -> Array:
        """Joint angles (6,) [rad] after `dt` [s] more of path time, from the commanded ones `q`."""
        ...


class JointMove:
    """All joints together from one configuration to another (moveJ)."""

    def __init__(self, start: Array, target: Array, speed: float, acceleration: float, duration: float = 0.0) -> None:
        self.start, self.target = start.copy(), target.copy()
        longest = float(np.abs(target - start).max())
        self._profile = (
            Trapezoid.lasting(duration) if duration > 0 else Trapezoid.over([longest], [speed], [acceleration])
        )
        self._time = 0.0
        self.done = False

    def joints(self, dt: float, q: Array) -> Array:  # noqa: ARG002
        """See `JointMotion`."""
        self._time += dt
        self.done = self._time >= self._profile.duration
        return self.start + self._profile.progress(self._time) * (self.target - self.start)

    @property
    def left(self) -> float:
        """Share of the way that is left."""
        return 1.0 - self._profile.progress(self._time)

    @property
    def slowing(self) -> bool:
        """Whether the last part of the way has begun, in which the speed falls."""
        return self._profile.slowing(self._time)


class JointSpeed:
    """The joints at given speeds, reached with limited acceleration (speedJ, stopJ).

    The joint with the largest change has the acceleration; the others change in proportion.
    """

    def __init__(self, speeds: Sequence[float], target: Sequence[float], acceleration: float, time: float) -> None:
        self._speeds: Array = np.array(speeds, dtype=float)  # (6,) [rad/s] at present
        self.done = False
        self.set(target, acceleration, time)

    def set(self, target: Sequence[float], acceleration: float, time: float = 0.0) -> None:
        """Aim at other speeds from here on; for `time` [s] if that is not 0."""
        self._target: Array = np.array(target, dtype=float)
        self._acceleration = acceleration
        self._left = time if time > 0 else math.inf

    @property
    def reached(self) -> bool:
        """Whether the joints have the speeds that were asked for."""
        return bool((self._speeds == self._target).all())

    def joints(self, dt: float, q: Array) -> Array:
        """See `JointMotion`."""
        self._left -= dt
        if self._left < -dt / 2:
            self._target = np.zeros(6)
        change = self._target - self._speeds
        largest = float(np.abs(change).max())
        if largest > self._acceleration * dt:
            self._speeds = self._speeds + change * (self._acceleration * dt / largest)
        else:
            self._speeds = self._target
        self.done = not self._target.any() and not self._speeds.any()
        return q + self._speeds * dt


class JointServo:
    """The joints after angles that are renewed all the time (servoJ). For the smoothing see `motion.Servo`."""

    def __init__(self, target: Sequence[float], lookahead: float, gain: float) -> None:
        self.done = False
        self.set(target, lookahead, gain)

    def set(self, target: Sequence[float], lookahead: float, gain: float) -> None:
        """Follow other angles from here on."""
        self._target: Array = np.array(target, dtype=float)
        self._lag = lookahead * 300.0 / gain  # 300 is URScript's default gain

    def joints(self, dt: float, q: Array) -> Array:
        """See `JointMotion`."""
        return q - math.expm1(-dt / self._lag) * (self._target - q)


class JointBlend:
    """Two joint moves run into each other: the second begins while the first slows down towards its target."""

    def __init__(self, first: JointMove | JointBlend, second: JointMove) -> None:
        self._first, self._second = first, second
        self.target = second.target
        self.done = False

    def joints(self, dt: float, q: Array) -> Array:
        """See `JointMotion`."""
        before = self._first.joints(dt, q)
        after = self._second.joints(dt, q)
        self.done = self._second.done and self._first.done
        return before + (after - self._second.start)

    @property
    def left(self) -> float:
        """Share of the second way that is left."""
        return self._second.left

    @property
    def slowing(self) -> bool:
        """Whether the second move slows down."""
        return self._first.done and self._second.slowing
