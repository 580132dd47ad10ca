"""ur-rtde's motions: the simulated arm goes where, how and as fast as it is told."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from robots import Robot
from ur_rtde_clients import FAST, HOME, Cell, begin_trail, connected, joints, restored, standing, tip, trail
from ur_rtde_methods import covers

from drivers.ur3e import frames
from drivers.ur3e.control_box.box import ControlBox
from drivers.ur3e.kinematics import Kinematics

CYCLE = 0.002  # [s]
Cycles = list[dict[str, Any]]


@pytest.fixture(scope="module")
def running() -> Iterator[Cell]:
    with connected(Robot("empty")) as cell:
        yield cell


@pytest.fixture
def cell(running: Cell) -> Cell:
    return restored(running)


def turned(offset: float) -> list[float]:
    """Home with the first, the fourth and the last joint turned."""
    return [HOME[0] + offset, *HOME[1:3], HOME[3] - offset / 2, HOME[4], HOME[5] + offset / 3]


def pose(x: float = 0.0, y: float = 0.0, z: float = 0.0, yaw: float = 0.0) -> list[float]:
    """UR's pose off from home by so much along base_link's axes, turned about the vertical."""
    (px, py, pz), rotation = Kinematics().forward(np.array(HOME))
    turn = frames.rotation_of_vector((0.0, 0.0, yaw))
    return frames.ur_pose((px + x, py + y, pz + z), frames.product(turn, rotation))


def place(q: list[float]) -> list[float]:
    """UR's pose of the flange at joint angles."""
    return frames.ur_pose(*Kinematics().forward(np.array(q)))


def joint_speed(cycles: Cycles) -> float:
    return float(np.abs([cycle["target_qd"] for cycle in cycles]).max())


def joint_acceleration(cycles: Cycles) -> float:
    speeds = np.array([cycle["target_qd"] for cycle in cycles])
    return float(np.abs(np.diff(speeds, axis=0)).max() / CYCLE)


def tool_speeds(cycles: Cycles) -> list[float]:
    return [math.hypot(*cycle["twist"][:3]) for cycle in cycles]


def tool_acceleration(cycles: Cycles) -> float:
    speeds = np.array([cycle["twist"][:3] for cycle in cycles])
    return float(np.linalg.norm(np.diff(speeds, axis=0), axis=1).max() / CYCLE)


def off_line(cycles: Cycles) -> float:
    """[m] largest distance of the TCP from the straight line between its first and last place."""
    places = np.array([cycle["position"] for cycle in cycles])
    along = places[-1] - places[0]
    along /= np.linalg.norm(along)
    way = places - places[0]
    return float(np.linalg.norm(way - np.outer(way @ along, along), axis=1).max())


def nearest(cycles: Cycles, target: list[float]) -> float:
    """[m] how near the TCP came to UR's pose."""
    place, _ = frames.ros_pose(target)
    return min(math.dist(cycle["position"], place) for cycle in cycles)


def is_at(cell: Cell, target: list[float], tolerance: float = 2e-4) -> bool:
    """Whether the physics stands at UR's pose, by [m] and [rad]."""
    cell.robot.until(standing)
    (x, y, z), rotation = frames.ros_pose(cell.robot.look(tip))
    place, wanted = frames.ros_pose(target)
    turn = frames.vector_of_rotation(frames.product(rotation, frames.transpose(wanted)))
    return math.dist((x, y, z), place) < tolerance and math.hypot(*turn) < 5 * tolerance


def moved(cell: Cell, motion: Callable[[], object]) -> Cycles:
    """What the arm did in a motion that waits for its end."""
    cell.robot.look(begin_trail)
    assert motion()
    cell.robot.until(standing)
    return cell.robot.look(trail)


def fast(box: ControlBox, speed: float) -> bool:
    return math.hypot(*box.arm.getTargetTCPSpeed()[:3]) >= speed


def going(box: ControlBox, twist: list[float]) -> bool:
    return bool(np.abs(np.array(box.arm.getTargetTCPSpeed()) - twist).max() < 1e-3)


def turning(box: ControlBox, speeds: list[float]) -> bool:
    return bool(np.abs(np.array(box.arm.getTargetQd()) - speeds).max() < 1e-9)


@covers(
    "RTDEControlInterface",
    moveJ="arrives; speed and acceleration are reached and not exceeded; a path's corners are cut within the blend",
    moveJ_IK="arrives at the pose, all joints together",
)
def test_joint_moves(cell: Cell) -> None:
    control = cell.control
    cycles = moved(cell, lambda: control.moveJ(turned(0.3), 0.8, 5.0))
    assert np.allclose(cell.robot.look(joints), turned(0.3), atol=1e-3)
    assert joint_speed(cycles) == pytest.approx(0.8, rel=1e-3)
    assert joint_acceleration(cycles) == pytest.approx(5.0, rel=0.02)
    cycles = moved(cell, lambda: control.moveJ_IK(pose(x=0.03, z=0.02, yaw=0.1), 0.5, 3.0))
    assert is_at(cell, pose(x=0.03, z=0.02, yaw=0.1))
    assert joint_speed(cycles) == pytest.approx(0.5, rel=1e-3)
    corner = [HOME[0] + 0.2, *HOME[1:]]
    end = [HOME[0] + 0.2, *HOME[1:3], HOME[3] - 0.3, *HOME[4:]]
    cycles = moved(cell, lambda: control.moveJ([[*corner, 1.0, 3.0, 0.02], [*end, 1.0, 3.0, 0.0]]))
    assert np.allclose(cell.robot.look(joints), end, atol=1e-3)
    assert 1e-3 < nearest(cycles, place(corner)) < 0.02
    with pytest.raises(ValueError, match="not within"):
        control.moveJ(HOME, 4.0, 1.0)


@covers(
    "RTDEControlInterface",
    moveL="on a straight line; speed and acceleration are reached and not exceeded; a path's corners are cut",
    moveL_FK="on a straight line to where the joint angles put the TCP",
)
def test_linear_moves(cell: Cell) -> None:
    control = cell.control
    cycles = moved(cell, lambda: control.moveL(pose(x=0.05, y=-0.04), 0.1, 1.0))
    assert is_at(cell, pose(x=0.05, y=-0.04))
    assert max(tool_speeds(cycles)) == pytest.approx(0.1, rel=1e-3)
    assert tool_acceleration(cycles) == pytest.approx(1.0, rel=0.05)
    assert off_line(cycles) < 1e-6
    cycles = moved(cell, lambda: control.moveL_FK(turned(0.1), 0.2, 2.0))
    assert is_at(cell, place(turned(0.1)))
    assert off_line(cycles) < 1e-6
    assert max(tool_speeds(cycles)) < 0.2001
    corner, end = pose(x=0.05), pose(x=0.05, y=0.05)
    assert control.moveL(pose(), 0.5, 5.0)
    cycles = moved(cell, lambda: control.moveL([[*corner, 0.1, 1.0, 0.01], [*end, 0.1, 1.0, 0.0]]))
    assert is_at(cell, end)
    assert 1e-4 < nearest(cycles, corner) < 0.01


@covers(
    "RTDEControlInterface",
    movePath="joint, linear and process moves one after the other; corners are cut; the last point is met",
    getAsyncOperationProgress="the number of the point that is headed for; negative once it is over",
    getAsyncOperationProgressEx="the same with the operation's number and whether it runs",
)
def test_a_path_of_different_moves_and_its_progress(cell: Cell) -> None:
    module = pytest.importorskip("rtde_control")
    path, entry = module.Path(), module.PathEntry
    corner = pose(x=0.04)
    path.addEntry(entry(entry.MoveJ, entry.PositionJoints, [*turned(0.1), 1.0, 4.0, 0.0]))
    path.addEntry(entry(entry.MoveL, entry.PositionTcpPose, [*corner, 0.1, 1.0, 0.01]))
    path.addEntry(entry(entry.MoveL, entry.PositionTcpPose, [*pose(x=0.04, z=0.04), 0.1, 1.0, 0.0]))
    path.addEntry(entry(entry.MoveP, entry.PositionTcpPose, [*pose(z=0.04), 0.1, 1.0, 0.0]))
    control = cell.control
    cell.robot.look(begin_trail)
    assert control.movePath(path, True)
    seen: list[int] = []

    def over() -> bool:
        status = control.getAsyncOperationProgressEx()
        if status.isAsyncOperationRunning() and status.progress() not in seen:
            seen.append(status.progress())
        return bool(seen) and not status.isAsyncOperationRunning()

    cell.wait(over)
    assert seen == [0, 1, 2, 3]
    assert control.getAsyncOperationProgress() < 0
    assert is_at(cell, pose(z=0.04))
    cycles = cell.robot.look(trail)
    assert nearest(cycles, place(turned(0.1))) < 1e-6
    assert 1e-4 < nearest(cycles, corner) < 0.01
    number = control.getAsyncOperationProgressEx().operationId()
    assert control.moveL(pose(), 0.2, 2.0, True)
    cell.wait(lambda: control.getAsyncOperationProgress() == 0)
    cell.wait(lambda: control.getAsyncOperationProgress() < 0)
    assert control.getAsyncOperationProgressEx().operationId() > number
    assert is_at(cell, pose())


@covers(
    "RTDEControlInterface",
    stopJ="an asynchronous move ends short of its target; the joints brake with the deceleration",
    stopL="likewise; ur-rtde's script brakes the joints instead of the tool, until an asynchronous stop was asked for",
)
def test_stops(cell: Cell) -> None:
    control = cell.control
    assert control.reuploadScript()
    cell.wait(control.isProgramRunning)

    def stopped(stop: Callable[[], None]) -> Cycles:
        assert control.moveL(pose(), 1.0, 5.0)
        assert control.moveL(pose(y=0.15), 0.2, 1.0, True)
        cell.robot.until(fast, 0.19999)
        cell.robot.look(begin_trail)
        stop()
        cell.robot.until(standing)
        cycles: Cycles = cell.robot.look(trail)
        assert not is_at(cell, pose(y=0.15), 0.02)
        return cycles

    assert joint_acceleration(stopped(lambda: control.stopJ(2.0))) == pytest.approx(2.0, rel=0.02)
    assert joint_acceleration(stopped(lambda: control.stopL(2.5))) == pytest.approx(2.5, rel=0.02)
    cycles = stopped(lambda: control.stopL(1.5, True))
    assert tool_acceleration(cycles) == pytest.approx(1.5, rel=0.05)
    assert off_line(cycles) < 1e-6
    assert tool_acceleration(stopped(lambda: control.stopJ(1.5, True))) == pytest.approx(1.5, rel=0.05)


@covers(
    "RTDEControlInterface",
    initPeriod="begins a control cycle",
    waitPeriod="ends it: 2 ms of the simulation",
    servoJ="the joints follow angles that are renewed each cycle, and settle at the last",
    servoL="the TCP follows poses that are renewed each cycle, and settles at the last",
    servoStop="the arm stands",
)
def test_servo(cell: Cell) -> None:
    control = cell.control
    begin = cell.receive.getTimestamp()
    for step in range(150):
        start = control.initPeriod()
        assert control.servoJ(turned(0.001 * step), 0.0, 0.0, CYCLE, 0.03, 500.0)
        control.waitPeriod(start)
    cell.robot.until(near, turned(0.149))
    assert cell.receive.getTimestamp() - begin > 0.29
    assert control.servoStop()
    cell.robot.until(standing)
    cycles = cell.robot.look(trail)
    assert joint_speed(cycles) < 2.0
    assert control.moveJ(HOME, *FAST)
    cell.robot.look(begin_trail)
    for step in range(150):
        start = control.initPeriod()
        assert control.servoL(pose(y=0.0003 * step), 0.0, 0.0, CYCLE, 0.03, 500.0)
        control.waitPeriod(start)
    cell.robot.until(arrived, pose(y=0.0003 * 149))
    assert control.servoStop(5.0)
    assert is_at(cell, pose(y=0.0003 * 149), 5e-4)
    assert off_line(cell.robot.look(trail)) < 5e-5


def near(box: ControlBox, q: list[float]) -> bool:
    return bool(np.abs(np.array(box.arm.getActualQ()) - q).max() < 1e-3)


def arrived(box: ControlBox, target: list[float]) -> bool:
    slow = math.hypot(*box.arm.getTargetTCPSpeed()[:3]) < 1e-3
    return slow and math.dist(box.arm.getActualTCPPose()[:3], target[:3]) < 4e-4


@covers(
    "RTDEControlInterface",
    servoC="the TCP goes to the pose; ur-rtde never clears the command, so the next call fails after 3 s, once",
)
def test_servo_along_a_curve(cell: Cell) -> None:
    control = cell.control
    cell.robot.look(begin_trail)
    assert control.servoC(pose(x=0.04, y=0.04), 0.1, 1.0)
    cell.robot.until(arrived, pose(x=0.04, y=0.04))
    cycles = cell.robot.look(trail)
    assert max(tool_speeds(cycles)) == pytest.approx(0.1, rel=1e-2)
    assert off_line([cycle for cycle in cycles if cycle["position"] != cycles[0]["position"]]) < 1e-5
    assert not control.servoStop()
    assert control.servoStop()
    assert is_at(cell, pose(x=0.04, y=0.04), 5e-4)


@covers(
    "RTDEControlInterface",
    speedJ="the joints have the speeds, reached with the acceleration",
    speedL="the TCP has the twist, reached with the acceleration",
    speedStop="the arm stands, braked with the deceleration",
)
def test_speeds(cell: Cell) -> None:
    control = cell.control
    speeds = [0.2, 0.0, 0.0, -0.1, 0.0, 0.3]
    cell.robot.look(begin_trail)
    assert control.speedJ(speeds, 2.0)
    cell.robot.until(turning, speeds)
    assert joint_acceleration(cell.robot.look(trail)) == pytest.approx(2.0, rel=0.02)
    cell.robot.look(begin_trail)
    assert control.speedStop(5.0)
    cell.robot.until(standing)
    assert joint_acceleration(cell.robot.look(trail)) == pytest.approx(5.0, rel=0.02)
    twist = [0.0, 0.03, 0.02, 0.0, 0.0, 0.1]
    cell.robot.look(begin_trail)
    assert control.speedL(twist, 0.5)
    cell.robot.until(going, twist)
    cycles = cell.robot.look(trail)
    assert control.speedStop()
    cell.robot.until(standing)
    assert tool_acceleration(cycles) < 0.51
    assert off_line([cycle for cycle in cycles if cycle["position"] != cycles[0]["position"]]) < 1e-4


@covers(
    "RTDEControlInterface",
    jogStart="the TCP moves at the speeds along the axes of base, of the tool, or of a frame",
    jogStop="the arm stands",
    FEATURE_BASE="jogs along base",
    FEATURE_TOOL="jogs along the tool",
    FEATURE_CUSTOM="jogs along a frame that is given",
    Feature="names the three",
)
def test_jogging(cell: Cell) -> None:
    control = cell.control
    assert control.Feature.FEATURE_TOOL == control.FEATURE_TOOL
    _, rotation = frames.ros_pose(pose())
    tool_z = frames.turn_base(frames.rotate(rotation, (0.0, 0.0, 0.03)))
    for feature, frame, wanted in (
        (control.FEATURE_BASE, [0.0] * 6, (0.0, 0.0, 0.03)),
        (control.FEATURE_TOOL, [0.0] * 6, tool_z),
        (control.FEATURE_CUSTOM, [0.1, 0.0, 0.0, math.pi / 2, 0.0, 0.0], (0.0, -0.03, 0.0)),
    ):
        assert control.jogStart([0.0, 0.0, 0.03, 0.0, 0.0, 0.0], int(feature), 0.5, frame)
        cell.robot.until(going, [*wanted, 0.0, 0.0, 0.0])
        assert control.jogStop()
        cell.robot.until(standing)


@covers(
    "RTDEControlInterface",
    getTargetWaypoint="where the motion under way ends",
    isSteady="false while the arm moves in the simulation, true once it stands",
)
def test_questions_during_a_motion(cell: Cell) -> None:
    control = cell.control
    assert control.isSteady()
    assert control.moveL(pose(y=0.1), 0.05, 1.0, True)
    cell.robot.until(fast, 0.04)
    assert control.getTargetWaypoint() == pytest.approx(pose(y=0.1), abs=1e-6)
    assert not control.isSteady()
    control.stopL(10.0)
    cell.robot.until(standing)
    assert control.isSteady()
