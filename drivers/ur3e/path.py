"""Ways of the TCP through space: a straight line, and an arc of a circle. Geometry alone; frame base_link."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np

from drivers.ur3e import frames
from drivers.ur3e.frames import Rotation, Vector
from runtime.errors import ArmError

Pose = tuple[Vector, Rotation]
Orientation = Literal["free", "fixed"]  # along an arc: turning evenly to the end's, or turning with the arc

_STRAIGHT = 1e-6  # sine of the angle at the via point below which three points have no circle


class Path(Protocol):
    """A way from one pose to another."""

    @property
    def target(self) -> Pose:
        """Where it ends."""
        ...

    @property
    def length(self) -> float:
        """[m] that the TCP travels."""
        ...

    @property
    def angle(self) -> float:
        """[rad] by which the TCP turns, all in all."""
        ...

    def at(self, progress: float) -> Pose:
        """Pose after a share of the way."""
        ...


@dataclass(frozen=True)
class Line:
    """A straight way, with the rotation turning evenly about one axis."""

    start: Pose
    target: Pose
    _way: Vector = field(init=False, repr=False)
    _turn: Vector = field(init=False, repr=False)
    length: float = field(init=False)
    angle: float = field(init=False)

    def __post_init__(self) -> None:
        (ax, ay, az), (bx, by, bz) = self.start[0], self.target[0]
        way = (bx - ax, by - ay, bz - az)
        turn = frames.vector_of_rotation(frames.product(self.target[1], frames.transpose(self.start[1])))
        object.__setattr__(self, "_way", way)
        object.__setattr__(self, "_turn", turn)
        object.__setattr__(self, "length", math.hypot(*way))
        object.__setattr__(self, "angle", math.hypot(*turn))

    def at(self, progress: float) -> Pose:
        """See `Path`."""
        (x, y, z), (dx, dy, dz) = self.start[0], self._way
        rotation = self.target[1]
        if self.angle > 1e-9 and progress < 1:
            rx, ry, rz = self._turn
            partly = frames.rotation_of_vector((rx * progress, ry * progress, rz * progress))
            rotation = frames.product(partly, self.start[1])
        return (x + dx * progress, y + dy * progress, z + dz * progress), rotation


@dataclass(frozen=True)
class Arc:
    """Part of the circle through three points (movec)."""

    start: Pose
    target: Pose
    centre: Vector  # [m]
    axis: Vector  # unit vector, the arc turns about it in the positive sense
    sweep: float  # [rad] 0..2 pi
    orientation: Orientation
    _turn: Vector  # rotation vector [rad] of the whole way, when the orientation is free
    length: float
    angle: float

    def at(self, progress: float) -> Pose:
        """See `Path`."""
        if progress >= 1 and self.orientation == "free":
            return self.target
        turned = frames.rotation_of_vector(_scaled(self.axis, self.sweep * progress))
        arm = tuple(a - c for a, c in zip(self.start[0], self.centre, strict=True))
        x, y, z = (c + r for c, r in zip(self.centre, frames.rotate(turned, arm), strict=True))
        if self.orientation == "fixed":
            return (x, y, z), frames.product(turned, self.start[1])
        partly = frames.rotation_of_vector(_scaled(self._turn, progress))
        return (x, y, z), frames.product(partly, self.start[1])


def arc(start: Pose, via: Vector, target: Pose, orientation: Orientation = "free") -> Arc:
    """The arc from `start` through the point `via` to `target`. Raises ArmError if the points lie on a line."""
    a, b, c = (np.array(point) for point in (start[0], via, target[0]))
    u, v = b - a, c - a
    normal = np.cross(u, v)
    size = float(np.linalg.norm(normal))
    if size <= _STRAIGHT * float(np.linalg.norm(u) * np.linalg.norm(v)) or size == 0.0:
        raise ArmError("no circle goes through start, via point and target: they lie on a line")
    # Circumcentre of a triangle with one corner at the origin.
    centre = a + (np.dot(u, u) * np.cross(v, normal) + np.dot(v, v) * np.cross(normal, u)) / (2 * size * size)
    axis = normal / size
    first, last = a - centre, c - centre
    radius = float(np.linalg.norm(first))
    # The normal of start, via, target is the axis about which via comes before target.
    sweep = math.atan2(float(np.dot(axis, np.cross(first, last))), float(np.dot(first, last))) % (2 * math.pi)
    turn = frames.vector_of_rotation(frames.product(target[1], frames.transpose(start[1])))
    angle = sweep if orientation == "fixed" else math.hypot(*turn)
    end = target
    if orientation == "fixed":
        turned = frames.rotation_of_vector(_scaled(tuple(axis.tolist()), sweep))
        end = (target[0], frames.product(turned, start[1]))
    return Arc(
        start,
        end,
        tuple(centre.tolist()),
        tuple(axis.tolist()),
        sweep,
        orientation,
        turn,
        radius * sweep,
        angle,
    )


def _scaled(vector: Vector, factor: float) -> Vector:
    return (vector[0] * factor, vector[1] * factor, vector[2] * factor)
