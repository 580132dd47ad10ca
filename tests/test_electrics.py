"""Currents, voltages, heat and momentum of the simulated arm."""

import math

import numpy as np
import pytest

from drivers.ur3e import frames
from drivers.ur3e.control_box.electrics import TORQUE_CONSTANT, Electrics
from drivers.ur3e.parameters import GRAVITY, GRIPPER, JOINTS
from drivers.ur3e.scene import Scene
from drivers.ur3e.simulated_arm import SimulatedArm
from runtime.cell import Board, Hole
from runtime.component import component


@pytest.fixture
def arm() -> SimulatedArm:
    return SimulatedArm(Scene(Board("single", (Hole("h1", 0.0, 0.0),), z=-1.0), component("capacitor")), noise=None)


def test_an_arm_at_rest_carries_its_weight(arm: SimulatedArm) -> None:
    arm.moveJ([0.0, 0.0, 0.0, 0.0, 0.0, 0.0])  # stretched out
    for _ in range(500):
        arm.cycle()
    electrics = Electrics(arm)
    torque = electrics.joint_torque
    # 7.5 kg behind the shoulder's lift joint, with their centre of mass at some 0.26 m.
    assert sum(joint.mass for joint in JOINTS[1:]) + GRIPPER.mass == pytest.approx(7.5, abs=0.1)
    assert abs(torque[1]) == pytest.approx(7.5 * GRAVITY * 0.26, rel=0.2)
    assert torque[0] == pytest.approx(0.0, abs=1e-3)
    assert list(electrics.joint_current) == pytest.approx([t / k for t, k in zip(torque, TORQUE_CONSTANT, strict=True)])
    assert list(electrics.target_moment) == pytest.approx(list(torque), abs=0.05)


def test_momentum_is_mass_times_speed(arm: SimulatedArm) -> None:
    electrics = Electrics(arm)
    assert electrics.momentum == pytest.approx(0.0, abs=1e-6)
    q, step = np.array(arm.getActualQ()), 1e-6
    arm.moveJ([*(q + 0.5)], asynchronous=True)
    for _ in range(150):
        arm.cycle()
    moving = electrics.momentum
    # The same by the centre of mass: total mass times how fast it moves.
    kinematics = electrics._kinematics
    import pinocchio

    here, speed = np.array(arm.getActualQ()), np.array(arm.getActualQd())
    before = pinocchio.centerOfMass(kinematics.model, kinematics._data, here - step * speed).copy()
    after = pinocchio.centerOfMass(kinematics.model, kinematics._data, here + step * speed).copy()
    mass = sum(inertia.mass for inertia in kinematics.model.inertias)
    assert moving == pytest.approx(mass * float(np.linalg.norm(after - before)) / (2 * step), rel=1e-4)


def test_the_accelerometer_feels_gravity(arm: SimulatedArm) -> None:
    electrics = Electrics(arm)
    acceleration = electrics.tool_acceleration
    assert math.hypot(*acceleration) == pytest.approx(GRAVITY, rel=1e-6)
    assert frames.rotate(arm.controller.rotation, acceleration) == pytest.approx((0.0, 0.0, GRAVITY), abs=1e-3)


def test_holding_warms_the_joints_and_without_power_they_cool(arm: SimulatedArm) -> None:
    electrics = Electrics(arm)
    for _ in range(50_000):
        electrics.advance()
    warm = list(electrics.joint_temperature)
    loads = np.abs(electrics.joint_current)
    assert warm[int(np.argmax(loads))] == max(warm)
    assert all(28.0 <= temperature < 60.0 for temperature in warm)
    electrics.powered = electrics.released = False
    for _ in range(50_000):
        electrics.advance()
    assert all(cool < hot for cool, hot in zip(electrics.joint_temperature, warm, strict=True))


def test_without_power_no_current_flows(arm: SimulatedArm) -> None:
    electrics = Electrics(arm)
    assert electrics.robot_current > 0.3
    assert 40.0 < electrics.robot_voltage < electrics.main_voltage
    electrics.powered = electrics.released = False
    assert electrics.robot_current == 0.0
    assert list(electrics.joint_current) == [0.0] * 6
    assert list(electrics.joint_torque) == [0.0] * 6
    assert list(electrics.joint_voltage) == [0.0] * 6
