"""Builtins on poses p[x, y, z, rx, ry, rz]: position [m] and rotation vector [rad]."""

from __future__ import annotations

import math
from collections.abc import Sequence

from drivers.ur3e import frames
from drivers.ur3e.frames import Rotation, Vector
from drivers.ur3e.urscript.builtin import Builtin
from drivers.ur3e.urscript.errors import BuiltinError
from drivers.ur3e.urscript.maths import real
from drivers.ur3e.urscript.values import Pose, Value, kind

_COST = 24  # [steps] of one operation on rotations


def _parts(value: Value) -> tuple[Vector, Rotation]:
    """Position and rotation of a pose; assumed: a list of six numbers will do."""
    x, y, z, *vector = _numbers(value, 6)
    return (x, y, z), frames.rotation_of_vector(vector)


def _numbers(value: Value, count: int) -> list[float]:
    if type(value) not in (list, Pose) or len(value) != count:
        raise BuiltinError(f"{count} numbers are needed, not a {kind(value)}")
    return [real(element) for element in value]


def _pose(position: Sequence[float], rotation: Rotation) -> Pose:
    return Pose([*position, *frames.vector_of_rotation(rotation)])


def pose_trans(p_from: Value, p_from_to: Value) -> Pose:
    """The pose `p_from_to`, which is given in the frame `p_from`, in the frame in which that is given."""
    (position, rotation), (offset, turn) = _parts(p_from), _parts(p_from_to)
    moved = [a + b for a, b in zip(position, frames.rotate(rotation, offset), strict=True)]
    return _pose(moved, frames.product(rotation, turn))


def pose_inv(p_from: Value) -> Pose:
    """The inverse transformation."""
    position, rotation = _parts(p_from)
    x, y, z = frames.unrotate(rotation, position)
    return _pose((-x, -y, -z), frames.transpose(rotation))


def pose_add(p_1: Value, p_2: Value) -> Pose:
    """Sum of the positions and product of the rotations."""
    (a, first), (b, second) = _parts(p_1), _parts(p_2)
    return _pose([x + y for x, y in zip(a, b, strict=True)], frames.product(first, second))


def pose_sub(p_to: Value, p_from: Value) -> Pose:
    """Difference of the positions, and the rotation from `p_from` to `p_to`."""
    (a, to), (b, start) = _parts(p_to), _parts(p_from)
    return _pose([x - y for x, y in zip(a, b, strict=True)], frames.product(to, frames.transpose(start)))


def pose_dist(p_from: Value, p_to: Value) -> float:
    """Distance that counts the angle too. UR does not say how; assumed: the norm of their difference."""
    return math.hypot(*pose_sub(p_to, p_from))


def point_dist(p_from: Value, p_to: Value) -> float:
    """[m] between the positions."""
    return math.dist(_parts(p_from)[0], _parts(p_to)[0])


def interpolate_pose(p_from: Value, p_to: Value, alpha: Value) -> Pose:
    """The pose a share `alpha` of the straight way, turning about one axis; beyond the ends too."""
    (a, start), (b, end), share = _parts(p_from), _parts(p_to), real(alpha)
    turn = frames.vector_of_rotation(frames.product(end, frames.transpose(start)))
    part = frames.rotation_of_vector([share * angle for angle in turn])
    return _pose([x + share * (y - x) for x, y in zip(a, b, strict=True)], frames.product(part, start))


def rpy2rotvec(rpy_vector: Value) -> list[float]:
    """Rotation vector [rad] of roll, pitch and yaw [rad]: turns about the fixed axes x, y and z, in this order."""
    roll, pitch, yaw = _numbers(rpy_vector, 3)
    about_x = frames.rotation_of_vector((roll, 0.0, 0.0))
    about_y = frames.rotation_of_vector((0.0, pitch, 0.0))
    about_z = frames.rotation_of_vector((0.0, 0.0, yaw))
    return list(frames.vector_of_rotation(frames.product(about_z, frames.product(about_y, about_x))))


def rotvec2rpy(rotation_vector: Value) -> list[float]:
    """Roll, pitch and yaw [rad] of a rotation vector [rad]; the pitch is within a quarter turn."""
    r = frames.rotation_of_vector(_numbers(rotation_vector, 3))
    level = math.hypot(r[0], r[3])
    if level < 1e-9:  # looking along z: only yaw and roll together are known
        return [math.atan2(-r[5], r[4]), math.atan2(-r[6], level), 0.0]
    return [math.atan2(r[7], r[8]), math.atan2(-r[6], level), math.atan2(r[3], r[0])]


def wrench_trans(T_from_to: Value, w_from: Value) -> list[float]:  # noqa: N803 (the parameter's name in URScript)
    """A wrench [N], [Nm] given in the frame `T_from_to`, in the frame and about the origin in which that is given."""
    position, rotation = _parts(T_from_to)
    wrench = _numbers(w_from, 6)
    fx, fy, fz = frames.rotate(rotation, wrench[:3])
    mx, my, mz = frames.rotate(rotation, wrench[3:])
    x, y, z = position
    return [fx, fy, fz, mx + y * fz - z * fy, my + z * fx - x * fz, mz + x * fy - y * fx]


def poses() -> dict[str, Builtin]:
    """The builtins by name."""
    functions = (
        interpolate_pose,
        point_dist,
        pose_add,
        pose_dist,
        pose_inv,
        pose_sub,
        pose_trans,
        rotvec2rpy,
        rpy2rotvec,
        wrench_trans,
    )
    return {function.__name__: Builtin(function, cost=_COST) for function in functions}
