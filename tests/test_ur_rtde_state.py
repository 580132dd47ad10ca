"""What ur-rtde's control interface answers and sets: kinematics are Pinocchio's, settings reach the arm."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from robots import Robot
from ur_rtde_clients import HOME, Cell, begin_trail, connected, cycle_at, joints, restored, standing, trail
from ur_rtde_methods import covers

from drivers.ur3e import frames
from drivers.ur3e.control_box.box import ControlBox
from drivers.ur3e.kinematics import Kinematics
from drivers.ur3e.parameters import GRIPPER, JOINTS

OFFSET = [0.01, -0.02, 0.1565, 0.1, 0.0, 0.2]
OTHER = [0.3, -1.2, 1.4, -1.9, -1.4, 0.5]  # [rad] within reach
FAR = [0.0, 0.0, 2.0, 0.0, math.pi, 0.0]  # 2 m up
TOLERANCE = 1e-6  # [m], [rad]
STALE = "(ur-rtde gives the answer to the call before)"


@pytest.fixture(scope="module")
def running() -> Iterator[Cell]:
    with connected(Robot("empty")) as cell:
        yield cell


@pytest.fixture
def cell(running: Cell) -> Cell:
    return restored(running)


@pytest.fixture(scope="module")
def newest() -> Iterator[Cell]:
    with connected(Robot("empty", version="5.26")) as cell:
        yield cell


@pytest.fixture
def new_cell(newest: Cell) -> Cell:
    return restored(newest)


def model(offset: list[float] | None = None) -> Kinematics:
    kinematics = Kinematics()
    kinematics.set_tcp(offset or [0.0] * 6)
    return kinematics


MODEL = model(OFFSET)


def where(q: list[float], offset: list[float] | None = None) -> list[float]:
    """UR's pose of the TCP by Pinocchio."""
    return frames.ur_pose(*model(offset).forward(np.array(q)))


def same_pose(one: list[float], other: list[float], tolerance: float = TOLERANCE) -> bool:
    (a, turn), (b, wanted) = frames.ros_pose(one), frames.ros_pose(other)
    return math.dist(a, b) < tolerance and np.abs(np.array(turn) - wanted).max() < 3 * tolerance


def answer(cell: Cell, question: Callable[[], Any], right: Callable[[Any], bool]) -> None:
    """Ask until the answer is right: ur-rtde hands out the answer to the call before."""
    cell.wait(lambda: right(question()))


@covers(
    "RTDEControlInterface",
    getForwardKinematics="Pinocchio's pose: of the arm, of other angles with another TCP; without a TCP, ur-rtde leaves"
    " that of the last command in the registers, and the answer is for that one",
    getInverseKinematics="angles that Pinocchio puts at the pose, those nearest to `qnear`",
    getInverseKinematicsHasSolution="whether there are any: not 2 m up",
    poseTrans="the product of the poses",
    isPoseWithinSafetyLimits="true within reach, false beyond it",
    isJointsWithinSafetyLimits="true within the joints' limits, false beyond them",
)
def test_kinematics(cell: Cell) -> None:
    control = cell.control
    assert control.setTcp(OFFSET)
    cell.in_step()
    assert same_pose(control.getForwardKinematics(), where(cell.robot.look(joints), OFFSET))
    assert same_pose(control.getForwardKinematics(OTHER, OFFSET), where(OTHER, OFFSET))
    assert same_pose(control.getForwardKinematics(HOME), where(HOME, OFFSET))  # OFFSET is still in the registers
    assert same_pose(control.getForwardKinematics(OTHER, [0.0] * 6), where(OTHER, OFFSET))
    target = where(OTHER, OFFSET)
    found = control.getInverseKinematics(target, OTHER)
    assert np.abs(np.array(found) - OTHER).max() < TOLERANCE
    near = [angle + 0.05 for angle in OTHER]
    assert np.abs(np.array(control.getInverseKinematics(target, near)) - OTHER).max() < TOLERANCE
    flipped = control.getInverseKinematics(target, [*OTHER[:4], -OTHER[4], OTHER[5] + 3.0])
    assert same_pose(where(flipped, OFFSET), target)
    here = where(HOME, OFFSET)
    assert same_pose(where(control.getInverseKinematics(here), OFFSET), here)
    assert control.getInverseKinematicsHasSolution(target)
    assert control.getInverseKinematicsHasSolution(target, near)
    assert not control.getInverseKinematicsHasSolution(FAR)
    assert not control.getInverseKinematicsHasSolution(FAR, near)
    assert control.isPoseWithinSafetyLimits(target)
    assert not control.isPoseWithinSafetyLimits(FAR)
    assert control.isJointsWithinSafetyLimits(OTHER)
    assert not control.isJointsWithinSafetyLimits([*OTHER[:2], 3.3, *OTHER[3:]])
    first, second = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6], [-0.3, 0.1, 0.0, 1.0, -0.2, 0.3]
    (x, turn), (y, turned) = ((pose[:3], frames.rotation_of_vector(pose[3:])) for pose in (first, second))
    moved = frames.rotate(turn, y)
    product = frames.vector_of_rotation(frames.product(turn, turned))
    assert control.poseTrans(first, second) == pytest.approx(
        [a + b for a, b in zip(x, moved, strict=True)] + list(product), abs=TOLERANCE
    )


@covers(
    "RTDEControlInterface",
    getActualToolFlangePose=f"Pinocchio's pose of the flange {STALE}",
    getActualJointPositionsHistory=f"joint angles of the physics so many cycles ago {STALE}",
    getStepTime=f"2 ms {STALE}",
    getJointTorques=f"torques of the physics without those that balance gravity {STALE}",
)
def test_answers_that_come_one_call_late(cell: Cell) -> None:
    control, robot = cell.control, cell.robot
    control.getActualToolFlangePose()
    answer(cell, control.getActualToolFlangePose, lambda pose: same_pose(pose, where(robot.look(joints)), 1e-5))
    answer(cell, control.getStepTime, lambda step: step == 0.002)
    answer(cell, control.getJointTorques, lambda found: np.allclose(found, robot.look(torques), atol=0.1))
    assert control.moveJ([HOME[0] + 0.5, *HOME[1:]], 0.1, 5.0, True)
    robot.until(turned, 0, HOME[0] + 0.05)
    control.getActualJointPositionsHistory(100)
    cell.in_step()
    old = control.getActualJointPositionsHistory(100)
    cycles = robot.look(trail)
    control.stopJ(10.0)
    ages = [age for age, cycle in enumerate(reversed(cycles)) if np.allclose(cycle["q"], old, atol=1e-9)]
    assert len(ages) == 1
    assert ages[0] >= 100


def torques(box: ControlBox) -> list[float]:
    return box.arm.getJointTorques()


def tool(box: ControlBox) -> dict[str, Any]:
    arm = box.arm
    return {
        "tcp": list(arm.tcp_offset),
        "mass": arm.payload[0],
        "centre": list(arm.payload[1]),
        "inertia": list(box.payload_inertia),
        "gravity": list(box.gravity),
    }


def upwards(cell: Cell) -> float:
    """[N] mean of the vertical force on the tool that the receive interface gives."""
    forces = []
    for _ in range(100):
        forces.append(cell.receive.getActualTCPForce()[2])
        cell.receive.waitPeriod(cell.receive.initPeriod())
    return float(np.mean(forces))


@covers(
    "RTDEControlInterface",
    setTcp="the TCP of the arm, and with it the poses that clients read",
    getTCPOffset="what was set",
    setPayload="mass and centre; the force on the tool changes by the weight; without a centre the old one stays",
    setTargetPayload="mass, centre and inertia",
    setGravity="the direction by which the payload is taken off: a wrong one leaves its weight in the force",
)
def test_settings(cell: Cell) -> None:
    control, robot = cell.control, cell.robot
    assert control.setTcp(OFFSET)
    assert control.getTCPOffset() == pytest.approx(OFFSET)
    assert robot.look(tool)["tcp"] == OFFSET
    cell.in_step()
    assert same_pose(cell.receive.getActualTCPPose(), where(robot.look(joints), OFFSET), 1e-5)
    before = upwards(cell)
    assert control.setPayload(GRIPPER.mass + 1.0, [0.0, 0.01, 0.06])
    assert (robot.look(tool)["mass"], robot.look(tool)["centre"]) == (GRIPPER.mass + 1.0, [0.0, 0.01, 0.06])
    cell.in_step()
    assert upwards(cell) - before == pytest.approx(9.81, abs=0.5)
    assert control.setPayload(0.5, [])
    assert robot.look(tool)["centre"] == [0.0, 0.01, 0.06]
    inertia = [1e-3, 2e-3, 3e-3, 0.0, 1e-4, 0.0]
    assert control.setTargetPayload(1.0, [0.0, 0.0, 0.05], inertia)
    assert robot.look(tool) == {
        "tcp": OFFSET, "mass": 1.0, "centre": [0.0, 0.0, 0.05], "inertia": inertia, "gravity": [0.0, 0.0, 9.82],
    }  # fmt: skip
    cell.in_step()
    upright = upwards(cell)
    assert control.setGravity([0.0, 0.0, -9.82])
    assert robot.look(tool)["gravity"] == [0.0, 0.0, -9.82]
    cell.in_step()
    assert upright - upwards(cell) == pytest.approx(2 * 9.81, abs=0.5)


def offer(box: ControlBox, wrench: list[float]) -> None:
    box.external_force_torque = wrench


def offered(box: ControlBox) -> list[float] | None:
    return box.external_force_torque


@covers(
    "RTDEControlInterface",
    ftRtdeInputEnable="the wrench of RTDE's external_force_torque takes the place of the arm's sensor, until disabled",
    enableExternalFtSensor="likewise",
    setExternalForceTorque="nothing: ur-rtde's package is too short for its recipe; it is ignored, and logged",
)
def test_a_force_torque_sensor_of_the_client(cell: Cell) -> None:
    control, receive = cell.control, cell.receive
    wrench = [1.0, -2.0, 33.0, 0.1, 0.2, -0.3]
    assert control.setExternalForceTorque(wrench)
    cell.in_step()
    cell.wait(lambda: any("recipe 21 ignored: 52 bytes, 56 needed" in line for line in cell.robot.lines))
    assert cell.robot.look(offered) is None
    cell.robot.look(offer, wrench)
    for enable in (control.ftRtdeInputEnable, control.enableExternalFtSensor):
        assert enable(True, 0.5, [0.0, 0.0, 0.01], [0.0, 0.0, 0.02])
        cell.wait(lambda: receive.getFtRawWrench() == wrench)
        assert enable(False)
        cell.wait(lambda: receive.getFtRawWrench()[2] < 20.0)


def jacobian_at(q: Any) -> Any:
    """Pinocchio's Jacobian (6, 6) in UR's base."""
    MODEL.forward(q)
    return np.diag([-1.0, -1.0, 1.0, -1.0, -1.0, 1.0]) @ MODEL.jacobian()


@covers(
    "RTDEControlInterface",
    getMassMatrix="Pinocchio's mass matrix where the arm is; ur-rtde's script leaves out the arguments",
    getJacobian="Pinocchio's Jacobian in base where the arm is; ur-rtde's script leaves out the arguments",
    getCoriolisAndCentrifugalTorques="nothing at rest; while moving those that Pinocchio has",
    getJacobianTimeDerivative="nothing at rest; while moving the change of Pinocchio's Jacobian",
    getTargetJointAccelerations=f"those that are commanded {STALE}",
)
def test_dynamics(new_cell: Cell) -> None:
    cell, control = new_cell, new_cell.control
    assert control.setTcp(OFFSET)
    q = np.array(cell.robot.look(joints))
    mass, jacobian = MODEL.mass_matrix(q), jacobian_at(q)
    answer(cell, control.getMassMatrix, lambda found: np.allclose(columns(found), mass, atol=TOLERANCE))
    answer(cell, control.getJacobian, lambda found: np.allclose(columns(found), jacobian, atol=TOLERANCE))
    answer(cell, control.getCoriolisAndCentrifugalTorques, lambda found: max(map(abs, found)) < 1e-6)
    answer(cell, control.getJacobianTimeDerivative, lambda found: max(map(abs, found)) < 1e-2)
    answer(cell, control.getTargetJointAccelerations, lambda found: not any(found))
    speeds = [0.5, 0.0, 0.3, 0.0, 0.0, 0.4]
    assert control.speedJ(speeds, 0.5)
    cell.robot.until(moving)  # a second command in the same control cycle would take the first one's place
    answer(cell, control.getTargetJointAccelerations, lambda found: found[0] == pytest.approx(0.5, rel=0.05))
    cell.robot.until(turning, speeds)
    cell.robot.look(begin_trail)
    found = []
    for ask in (control.getCoriolisAndCentrifugalTorques, control.getJacobianTimeDerivative):
        ask()
        cell.in_step()
        found.append(np.array(ask()))
    assert control.speedStop()
    cycles = cell.robot.look(trail)
    for values, wanted in zip(found, (coriolis, dot), strict=True):
        assert np.abs(values).max() > 5e-3
        # ur-rtde reads register by register, while the next cycle's come in.
        off = np.min([np.abs(values - wanted(cycle)) for cycle in cycles], axis=0)
        assert off.max() < 1e-5


def columns(found: list[float]) -> Any:
    """A matrix out of ur-rtde's list, column by column."""
    return np.array(found).reshape(6, 6).T


def turning(box: ControlBox, speeds: list[float]) -> bool:
    return bool(np.abs(np.array(box.arm.getTargetQd()) - speeds).max() < 1e-9)


def moving(box: ControlBox) -> bool:
    return any(box.arm.getTargetQd())


def coriolis(cycle: dict[str, Any]) -> Any:
    q, qd = np.array(cycle["q"]), np.array(cycle["qd"])
    return MODEL.bias(q, qd) - MODEL.bias(q, np.zeros(6))


def dot(cycle: dict[str, Any]) -> Any:
    """The Jacobian's change (36,) by columns, by differences along the motion."""
    q, qd = np.array(cycle["q"]), np.array(cycle["qd"])
    ahead, behind = jacobian_at(q + 1e-5 * qd), jacobian_at(q - 1e-5 * qd)
    return ((ahead - behind) / 2e-5).T.ravel()


@covers(
    "RTDEControlInterface",
    directTorque="a joint speeds up as its inertia says; the torque lasts until another command comes",
)
def test_direct_torque(new_cell: Cell) -> None:
    cell, control = new_cell, new_cell.control
    start = cell.robot.look(joints)
    assert control.directTorque([0.0, 0.0, 0.0, 0.0, 0.0, 0.6])
    cell.robot.until(turned, 5, start[5] + 0.1)
    control.stopJ(10.0)
    cell.robot.until(standing)
    assert cell.robot.look(joints)[:5] == pytest.approx(start[:5], abs=0.02)
    speeds = [cycle["qd"][5] for cycle in cell.robot.look(trail) if cycle["q"][5] < start[5] + 0.05]
    inertia = model().mass_matrix(np.array(start))[5, 5] + JOINTS[5].armature
    assert np.diff(speeds).max() / 0.002 == pytest.approx(0.6 / inertia, rel=0.1)


def turned(box: ControlBox, joint: int, angle: float) -> bool:
    return box.arm.getActualQ()[joint] > angle


@pytest.mark.parametrize("name", ["getMassMatrix", "getJacobian", "getJacobianTimeDerivative"])
def test_what_came_with_5_23_is_missing_before(cell: Cell, name: str) -> None:
    with pytest.raises(RuntimeError, match="output_double_register_6"):
        getattr(cell.control, name)()


def test_registers_are_read_in_their_new_layout(new_cell: Cell) -> None:
    assert new_cell.dashboard.polyscopeVersion().startswith("5.26.")
    new_cell.in_step()
    now, _ = new_cell.robot.until(cycle_at, new_cell.receive.getTimestamp())
    assert new_cell.receive.getActualQ() == pytest.approx(now["q"], abs=1e-5)
    assert same_pose(new_cell.control.getForwardKinematics(OTHER, OFFSET), where(OTHER, OFFSET))
