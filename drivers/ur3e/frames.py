"""Poses between ROS and UR: two base frames, two ways to write a rotation.

UR's `base` frame is ROS's `base_link` turned by half a turn about z (REP 199; ur_description). UR writes a pose as
(x, y, z, rx, ry, rz) with the rotation vector: axis times angle. ROS writes a unit quaternion (x, y, z, w).
Rotation matrices are nine floats, row by row, since these functions run in the control loop.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

Rotation = tuple[float, float, float, float, float, float, float, float, float]  # (3, 3) row by row
Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]  # x, y, z, w

IDENTITY: Rotation = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


def turn_base(vector: Sequence[float]) -> Vector:
    """A vector of `base` in `base_link`, or the other way round: half a turn is its own inverse."""
    return (-vector[0], -vector[1], vector[2])


def turn_base_rotation(r: Rotation) -> Rotation:
    """A body's rotation of `base` in `base_link`, or the other way round."""
    return (-r[0], -r[1], -r[2], -r[3], -r[4], -r[5], r[6], r[7], r[8])


def turn_base_wrench(wrench: Sequence[float]) -> list[float]:
    """A wrench or twist (6,) of `base` in `base_link`, or the other way round."""
    return [-wrench[0], -wrench[1], wrench[2], -wrench[3], -wrench[4], wrench[5]]


def product(a: Rotation, b: Rotation) -> Rotation:
    """The rotation `a b`."""
    return (
        a[0] * b[0] + a[1] * b[3] + a[2] * b[6],
        a[0] * b[1] + a[1] * b[4] + a[2] * b[7],
        a[0] * b[2] + a[1] * b[5] + a[2] * b[8],
        a[3] * b[0] + a[4] * b[3] + a[5] * b[6],
        a[3] * b[1] + a[4] * b[4] + a[5] * b[7],
        a[3] * b[2] + a[4] * b[5] + a[5] * b[8],
        a[6] * b[0] + a[7] * b[3] + a[8] * b[6],
        a[6] * b[1] + a[7] * b[4] + a[8] * b[7],
        a[6] * b[2] + a[7] * b[5] + a[8] * b[8],
    )


def transpose(r: Rotation) -> Rotation:
    """The inverse rotation."""
    return (r[0], r[3], r[6], r[1], r[4], r[7], r[2], r[5], r[8])


def rotate(r: Rotation, v: Sequence[float]) -> Vector:
    """The vector `r v`."""
    return (
        r[0] * v[0] + r[1] * v[1] + r[2] * v[2],
        r[3] * v[0] + r[4] * v[1] + r[5] * v[2],
        r[6] * v[0] + r[7] * v[1] + r[8] * v[2],
    )


def unrotate(r: Rotation, v: Sequence[float]) -> Vector:
    """The vector `r^T v`."""
    return (
        r[0] * v[0] + r[3] * v[1] + r[6] * v[2],
        r[1] * v[0] + r[4] * v[1] + r[7] * v[2],
        r[2] * v[0] + r[5] * v[1] + r[8] * v[2],
    )


def rotation_of_vector(vector: Sequence[float]) -> Rotation:
    """Rotation of a rotation vector [rad]: Rodrigues' formula."""
    x, y, z = vector
    angle = math.sqrt(x * x + y * y + z * z)
    if angle < 1e-12:
        return (1.0, -z, y, z, 1.0, -x, -y, x, 1.0)
    x, y, z = x / angle, y / angle, z / angle
    s, c = math.sin(angle), math.cos(angle)
    k = 1.0 - c
    return (
        c + k * x * x,
        k * x * y - s * z,
        k * x * z + s * y,
        k * x * y + s * z,
        c + k * y * y,
        k * y * z - s * x,
        k * x * z - s * y,
        k * y * z + s * x,
        c + k * z * z,
    )


def quaternion_of_rotation(r: Rotation) -> Quaternion:
    """Unit quaternion of a rotation, w >= 0 (Shepperd's method: divide by the largest of the four)."""
    trace = r[0] + r[4] + r[8]
    if trace >= max(r[0], r[4], r[8]):
        x, y, z, w = r[7] - r[5], r[2] - r[6], r[3] - r[1], 1.0 + trace
    elif r[0] >= r[4] and r[0] >= r[8]:
        x, y, z, w = 1.0 + r[0] - r[4] - r[8], r[1] + r[3], r[2] + r[6], r[7] - r[5]
    elif r[4] >= r[8]:
        x, y, z, w = r[1] + r[3], 1.0 - r[0] + r[4] - r[8], r[5] + r[7], r[2] - r[6]
    else:
        x, y, z, w = r[2] + r[6], r[5] + r[7], 1.0 - r[0] - r[4] + r[8], r[3] - r[1]
    norm = math.copysign(math.sqrt(x * x + y * y + z * z + w * w), w)
    return (x / norm, y / norm, z / norm, w / norm)


def vector_of_quaternion(q: Quaternion) -> Vector:
    """Rotation vector [rad] of a unit quaternion, no longer than half a turn."""
    x, y, z, w = q if q[3] >= 0 else (-q[0], -q[1], -q[2], -q[3])
    sine = math.sqrt(x * x + y * y + z * z)
    scale = 2.0 if sine < 1e-12 else 2.0 * math.atan2(sine, w) / sine
    return (x * scale, y * scale, z * scale)


def vector_of_rotation(r: Rotation) -> Vector:
    """Rotation vector [rad] of a rotation, no longer than half a turn."""
    return vector_of_quaternion(quaternion_of_rotation(r))


def tool_down(yaw: float) -> Rotation:
    """The tool pointing down with its x axis turned by `yaw` [rad] about `base_link`'s z."""
    c, s = math.cos(yaw), math.sin(yaw)
    return (c, s, 0.0, s, -c, 0.0, 0.0, 0.0, -1.0)


def ur_pose(position: Sequence[float], rotation: Rotation) -> list[float]:
    """UR's pose (6,) in `base` of a position [m] and rotation in `base_link`."""
    return [*turn_base(position), *vector_of_rotation(turn_base_rotation(rotation))]


def ros_pose(pose: Sequence[float]) -> tuple[Vector, Rotation]:
    """Position [m] and rotation in `base_link` of UR's pose (6,) in `base`."""
    return turn_base(pose[:3]), turn_base_rotation(rotation_of_vector(pose[3:6]))
