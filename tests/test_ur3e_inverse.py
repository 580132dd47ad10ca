"""The closed-form inverse kinematics against Pinocchio's forward kinematics."""

import math

import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st

from drivers.ur3e import frames
from drivers.ur3e.inverse import flange, inverse, nearest
from drivers.ur3e.kinematics import Kinematics
from drivers.ur3e.parameters import JOINTS

ANGLES = st.lists(st.floats(-3.1, 3.1), min_size=6, max_size=6)
KINEMATICS = Kinematics()


def pose_of(q: list[float]) -> tuple[frames.Vector, frames.Rotation]:
    """UR's pose of the flange."""
    position, rotation = KINEMATICS.tool(np.array(q))
    return frames.turn_base(position), frames.turn_base_rotation(rotation)


def far_from_singular(q: list[float]) -> bool:
    elbow, wrist = math.sin(q[2]), math.sin(q[4])
    position, rotation = pose_of(q)
    shoulder = math.hypot(position[0] - 0.0921 * rotation[2], position[1] - 0.0921 * rotation[5])
    return abs(elbow) > 0.05 and abs(wrist) > 0.05 and shoulder > 0.14


@given(ANGLES)
def test_every_solution_leads_to_the_pose(q: list[float]) -> None:
    position, rotation = pose_of(q)
    assume(far_from_singular(q))
    found = list(inverse(position, rotation))
    assert len(found) >= 2
    for solution in found:
        there, turned = pose_of(list(solution))
        assert math.dist(there, position) < 1e-8
        assert max(abs(a - b) for a, b in zip(turned, rotation, strict=True)) < 1e-7


@given(ANGLES)
def test_the_nearest_solution_is_the_configuration_itself(q: list[float]) -> None:
    assume(far_from_singular(q))
    found = nearest(*pose_of(q), q)
    assert found is not None
    assert max(abs(a - b) for a, b in zip(found, q, strict=True)) < 1e-6


@given(ANGLES, st.integers(-1, 1), st.integers(-1, 1))
def test_whole_turns_are_kept_within_the_limits(q: list[float], first: int, last: int) -> None:
    assume(far_from_singular(q))
    near = [q[0] + 2 * math.pi * first, *q[1:5], q[5] + 2 * math.pi * last]
    found = nearest(*pose_of(q), near)
    assert found is not None
    assert all(abs(angle) <= joint.reach + 1e-9 for angle, joint in zip(found, JOINTS, strict=True))
    if all(abs(wanted) <= joint.reach - 1e-6 for wanted, joint in zip(near, JOINTS, strict=True)):
        assert max(abs(a - b) for a, b in zip(found, near, strict=True)) < 1e-6


@given(st.floats(0.75, 5.0), st.floats(-math.pi, math.pi), st.floats(-1.5, 1.5))
def test_out_of_reach_has_no_solution(distance: float, around: float, up: float) -> None:
    position = (
        distance * math.cos(around) * math.cos(up),
        distance * math.sin(around) * math.cos(up),
        0.15 + distance * math.sin(up),
    )
    assert nearest(position, frames.IDENTITY, [0.0] * 6) is None


@given(ANGLES, st.lists(st.floats(-0.3, 0.3), min_size=6, max_size=6))
def test_the_flange_is_found_from_the_tcp(q: list[float], offset: list[float]) -> None:
    position, rotation = pose_of(q)
    turn = frames.rotation_of_vector(offset[3:])
    tip = tuple(a + b for a, b in zip(position, frames.rotate(rotation, offset[:3]), strict=True))
    found, turned = flange(tip, frames.product(rotation, turn), offset[:3], turn)
    assert math.dist(found, position) < 1e-12
    assert max(abs(a - b) for a, b in zip(turned, rotation, strict=True)) < 1e-12
