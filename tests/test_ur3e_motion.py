"""Motions beyond those the insertion skill uses: joint speeds and servoing, arcs, blends, the speed slider, torques."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from drivers.ur3e import frames
from drivers.ur3e.compliance import Compliance, hand_guided
from drivers.ur3e.controller import Controller
from drivers.ur3e.kinematics import Kinematics
from drivers.ur3e.motion import PathMove, Trapezoid
from drivers.ur3e.parameters import CYCLE, JOINTS
from drivers.ur3e.path import Line, arc
from drivers.ur3e.scene import Scene
from drivers.ur3e.simulated_arm import SimulatedArm
from drivers.ur3e.workcell import Workcell
from runtime.cell import Board, Hole
from runtime.component import component
from runtime.errors import ArmError

HOME = list(Workcell().home)
DOWN = frames.tool_down(0.0)
BOARD = Board("single", (Hole("h1", 0.0, 0.0),), z=-1.0)


def controller() -> Controller:
    made = Controller(Kinematics(), HOME)
    made.move_linear(((0.30, 0.0, 0.20), DOWN), 0.25, 1.2)
    run(made)
    return made


def run(made: Controller, limit: int = 20_000) -> list[tuple[frames.Vector, list[float]]]:
    """Positions and joint speeds of every cycle until the controller is idle."""
    seen = []
    while not made.idle:
        made.step(True, None)
        seen.append((made.position, list(made.qd)))
        assert len(seen) < limit
    return seen


def simulated() -> SimulatedArm:
    return SimulatedArm(Scene(BOARD, component("capacitor")), noise=None)


def joint_accelerations(seen: list[tuple[frames.Vector, list[float]]]) -> float:
    speeds = np.array([[0.0] * 6, *(qd for _, qd in seen), [0.0] * 6])
    return float(np.abs(np.diff(speeds, axis=0)).max() / CYCLE)


@given(st.floats(0.01, 10.0))
def test_a_profile_of_given_duration_takes_it_and_covers_the_way(duration: float) -> None:
    profile = Trapezoid.lasting(duration)
    assert profile.progress(0.0) == 0.0
    assert profile.progress(duration) == 1.0
    assert profile.progress(duration / 2) == pytest.approx(0.5)
    times = np.linspace(0, duration, 50)
    assert np.all(np.diff([profile.progress(time) for time in times]) >= 0)
    assert profile.slowing(0.9 * duration)
    assert not profile.slowing(0.5 * duration)


def test_joint_speeds_are_reached_with_the_acceleration_and_held() -> None:
    made = controller()
    target = [0.4, -0.2, 0.1, 0.0, 0.3, -0.5]
    made.set_joint_speed(target, 2.0)
    seen = []
    for _ in range(200):
        made.step(True, None)
        seen.append(list(made.qd))
    assert seen[-1] == pytest.approx(target)
    first = next(index for index, qd in enumerate(seen) if qd == pytest.approx(target))
    assert (first + 1) * CYCLE == pytest.approx(0.5 / 2.0, abs=2 * CYCLE)
    assert np.abs(np.diff(seen, axis=0)).max() <= 2.0 * CYCLE + 1e-12
    made.set_joint_speed([0.0] * 6, 4.0)
    stopping = run(made)
    assert len(stopping) * CYCLE == pytest.approx(0.5 / 4.0, abs=2 * CYCLE)
    assert made.qd == [0.0] * 6


def test_joint_speeds_for_a_time_end_by_themselves() -> None:
    made = controller()
    made.set_joint_speed([0.1] * 6, 10.0, time=0.3)
    assert len(run(made)) * CYCLE == pytest.approx(0.31, abs=3 * CYCLE)


def test_a_servo_comes_ever_closer_and_never_overshoots() -> None:
    made = controller()
    start = made.q.copy()
    target = start + np.array([0.05, -0.02, 0.03, 0.01, 0.04, -0.05])
    made.set_joint_servo(target, 0.1, 300.0)
    left = []
    for _ in range(500):
        made.step(True, None)
        left.append(float(np.abs(target - made.q).max()))
    assert left == sorted(left, reverse=True)
    assert left[49] == pytest.approx(0.05 * math.exp(-1), rel=0.05)  # one look-ahead time
    assert left[-1] < 1e-5


@given(
    st.floats(0.3, 2.8),
    st.floats(0.02, 0.08),
    st.floats(-1.5, 1.5),
    st.floats(-1.0, 1.0),
)
def test_an_arc_keeps_its_distance_from_the_centre(sweep: float, radius: float, tilt: float, turn: float) -> None:
    turned = frames.rotation_of_vector((tilt, 0.3, 0.1))

    def on_circle(angle: float) -> frames.Vector:
        x, y, z = frames.rotate(turned, (radius * math.cos(angle), radius * math.sin(angle), 0.0))
        return (0.3 + x, y, 0.2 + z)

    start, via, end = (on_circle(angle) for angle in (0.0, 0.5 * sweep, sweep))
    rotation = frames.product(frames.rotation_of_vector((0.0, 0.0, turn)), DOWN)
    path = arc((start, DOWN), via, (end, rotation))
    assert path.length == pytest.approx(radius * sweep)
    assert path.at(0.0)[0] == pytest.approx(start)
    assert path.at(0.5)[0] == pytest.approx(via)
    assert path.at(1.0) == (end, rotation)
    for share in np.linspace(0, 1, 9):
        assert math.dist(path.at(float(share))[0], path.centre) == pytest.approx(radius)
    fixed = arc((start, DOWN), via, (end, rotation), "fixed")
    inward = frames.unrotate(DOWN, [c - s for c, s in zip(fixed.centre, start, strict=True)])
    at, there = fixed.at(0.7)
    assert frames.unrotate(there, [c - s for c, s in zip(fixed.centre, at, strict=True)]) == pytest.approx(inward)


def test_points_on_a_line_have_no_arc() -> None:
    with pytest.raises(ArmError, match="on a line"):
        arc(((0.3, 0.0, 0.2), DOWN), (0.31, 0.0, 0.2), ((0.32, 0.0, 0.2), DOWN))


@settings(max_examples=15, deadline=None)
@given(st.floats(0.005, 0.04), st.floats(-2.5, 2.5))
def test_a_blend_cuts_the_corner_by_no_more_than_its_radius(radius: float, bearing: float) -> None:
    assume(abs(bearing) > 0.2)
    made = controller()
    corner = (0.36, 0.0, 0.20)
    end = (0.36 + 0.08 * math.cos(bearing), 0.08 * math.sin(bearing), 0.20)
    made.move_linear((corner, DOWN), 0.2, 1.0)
    seen = []
    motion = made.motion
    assert isinstance(motion, PathMove)
    while not (motion.slowing and motion.left <= radius):
        made.step(True, None)
        seen.append(made.position)
    made.move_along(Line(made.corner, (end, DOWN)), 0.2, 1.0, blend=True)
    slowest = math.inf
    while not made.idle:
        before = made.position
        made.step(True, None)
        if math.dist(made.position, corner) < radius / 2:
            slowest = min(slowest, math.dist(before, made.position) / CYCLE)
        seen.append(made.position)
    assert made.position == pytest.approx(end, abs=1e-8)
    gap = min(math.dist(position, corner) for position in seen)
    assert gap <= radius
    for position in seen:
        away = math.dist(position, corner)
        if away > radius + 1e-9:  # outside the blend the path is the straight one
            assert _off_line(position, (0.30, 0.0, 0.20), corner) < 1e-6 or _off_line(position, corner, end) < 1e-6
    assert slowest > 0.01 or gap == 0.0 or slowest == math.inf


def _off_line(point: frames.Vector, a: frames.Vector, b: frames.Vector) -> float:
    along = np.array(b) - np.array(a)
    along /= np.linalg.norm(along)
    offset = np.array(point) - np.array(a)
    return float(np.linalg.norm(offset - along * (offset @ along)))


def test_joint_moves_blend_without_a_stop() -> None:
    made = controller()
    first, second = made.q + 0.2, made.q + np.array([0.2, 0.2, 0.2, 0.6, 0.2, 0.2])
    made.move_joints(first, 1.0, 2.0)
    while not made.motion.slowing:  # type: ignore[union-attr]
        made.step(True, None)
    made.move_joints(second, 1.0, 2.0, blend=True)
    speeds = [max(map(abs, qd)) for _, qd in run(made)]
    assert made.q == pytest.approx(second)
    assert min(speeds[: len(speeds) // 2]) > 0.2


def test_a_move_of_given_duration_takes_it() -> None:
    made = controller()
    made.move_linear(((0.35, 0.05, 0.2), DOWN), 0.01, 0.01, duration=0.8)
    assert len(run(made)) * CYCLE == pytest.approx(0.8, abs=2 * CYCLE)


@pytest.mark.parametrize("slider", [0.0, 0.25, 0.7])
def test_the_slider_slows_the_path_down_and_does_not_change_it(slider: float) -> None:
    straight = controller()
    straight.move_linear(((0.36, 0.06, 0.2), DOWN), 0.1, 1.0)
    whole = run(straight)
    made = controller()
    made.slider = slider
    made.step(True, None)
    for _ in range(300):
        made.step(True, None)
    assert made.scaling == slider
    made.move_linear(((0.36, 0.06, 0.2), DOWN), 0.1, 1.0)
    if slider == 0.0:
        for _ in range(500):
            made.step(True, None)
        assert made.position == pytest.approx((0.30, 0.0, 0.20))
        made.slider = 1.0
    slowed = run(made)
    assert made.position == pytest.approx((0.36, 0.06, 0.2))
    assert max(_off_line(position, (0.3, 0.0, 0.2), (0.36, 0.06, 0.2)) for position, _ in slowed) < 1e-6
    if slider:
        assert len(slowed) == pytest.approx(len(whole) / slider, rel=0.02)


def test_torques_replace_the_servos_and_gravity_stays_balanced() -> None:
    arm = simulated()
    start = np.array(arm.getActualQ())
    arm.torque = [0.0] * 6
    for _ in range(250):
        arm.cycle()
    assert np.abs(np.array(arm.getActualQ()) - start).max() < 1e-3
    assert arm.getTargetQ() == pytest.approx(arm.getActualQ(), abs=1e-3)
    for _ in range(100):
        arm.torque = [4.0, 0.0, 0.0, 0.0, 0.0, 0.0]
        arm.cycle()
    assert arm.getJointTorques()[0] == pytest.approx(4.0)
    assert arm.getActualQd()[0] > 0.1
    arm.end_torque()
    for _ in range(250):
        arm.cycle()
    assert np.abs(arm.getActualQd()).max() < 1e-3
    assert arm.getActualQ()[0] > start[0]


def test_a_runaway_torque_is_a_protective_stop() -> None:
    arm = simulated()
    for _ in range(2000):
        arm.torque = [0.0, 0.0, 0.0, 0.0, 0.0, 8.0]
        arm.cycle()
        if arm.stop_reason:
            break
    assert arm.stop_reason == f"{JOINTS[5].name} exceeds its speed limit"
    assert arm.torque is None


def test_a_hand_leads_the_tool_and_leaves_it_where_it_is() -> None:
    arm = simulated()
    arm.zeroFtSensor()
    here = arm.pose[0]
    arm.controller.comply(hand_guided(frames.IDENTITY, (1,) * 6))
    arm.scene.push((0.0, 15.0, 0.0, 0.0, 0.0, 0.0))
    for _ in range(100):
        arm.cycle()
    moved = arm.pose[0]
    assert moved[1] - here[1] > 0.01
    arm.scene.push((0.0,) * 6)
    for _ in range(500):
        arm.cycle()
    rest = arm.pose[0]
    for _ in range(500):
        arm.cycle()
    assert math.dist(arm.pose[0], rest) < 1e-4


def test_axes_that_are_not_free_do_not_give_way() -> None:
    arm = simulated()
    arm.zeroFtSensor()
    here = arm.pose[0]
    arm.controller.comply(hand_guided(frames.IDENTITY, (0, 1, 0, 0, 0, 0)))
    arm.scene.push((30.0, 30.0, 0.0, 0.0, 0.0, 0.0))
    for _ in range(500):
        arm.cycle()
    dx, dy, dz = (b - a for a, b in zip(here, arm.pose[0], strict=True))
    assert dy > 0.02
    assert abs(dx) < 2e-3
    assert abs(dz) < 2e-3


def test_force_mode_towards_a_point_turns_with_the_tcp() -> None:
    compliance = Compliance(frames.IDENTITY, (0, 1, 0, 0, 0, 0), [0] * 6, [0.1] * 6, 1, (0.3, 0.0, 0.0))
    compliance.turn((0.3, 0.0, 0.2), [0.0] * 6)
    assert frames.rotate(compliance.frame, (0.0, 1.0, 0.0)) == pytest.approx((0.0, 0.0, -1.0))
    compliance.turn((0.5, 0.0, 0.0), [0.0] * 6)
    assert frames.rotate(compliance.frame, (0.0, 1.0, 0.0)) == pytest.approx((-1.0, 0.0, 0.0))


def test_force_mode_of_motion_follows_the_velocity() -> None:
    compliance = Compliance(frames.IDENTITY, (0, 1, 0, 0, 0, 0), [0] * 6, [0.1] * 6, 3)
    compliance.turn((0.3, 0.0, 0.2), [0.0, 0.02, 0.05, 0.0, 0.0, 0.0])
    assert frames.rotate(compliance.frame, (1.0, 0.0, 0.0)) == pytest.approx((0.0, 1.0, 0.0))
    compliance.turn((0.3, 0.0, 0.2), [0.0] * 6)
    assert frames.rotate(compliance.frame, (1.0, 0.0, 0.0)) == pytest.approx((0.0, 1.0, 0.0))
