"""ur-rtde's receive interface: every value that it gives is that of the physics in the same control cycle."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from robots import Robot
from ur_rtde_clients import HOME, Cell, connected, cycle_at, joints, restored, trail
from ur_rtde_methods import covers

from drivers.ur3e import frames
from drivers.ur3e.control_box.box import ControlBox
from drivers.ur3e.kinematics import Kinematics
from drivers.ur3e.parameters import GRAVITY, JOINTS

Sample = tuple[dict[str, Any], dict[str, Any], dict[str, Any]]  # what the client has, that cycle, the one before


@pytest.fixture(scope="module")
def running() -> Iterator[Cell]:
    with connected(Robot("empty")) as cell:
        yield cell


@pytest.fixture
def cell(running: Cell) -> Cell:
    return restored(running)


def there(offset: float) -> list[float]:
    return [HOME[0] + offset, HOME[1] + 0.5 * offset, HOME[2], HOME[3] - offset, HOME[4], HOME[5] + offset]


def moving(cell: Cell, *names: str) -> Sample:
    """Getters' values in one cycle in the middle of a move, with that cycle of the physics."""
    assert cell.control.moveJ(there(0.4), 1.0, 2.0, True)
    cell.robot.until(fast)
    receive = cell.receive
    sample: dict[str, Any] = {}

    def taken() -> bool:
        stamp = receive.getTimestamp()
        sample.update({name: getattr(receive, name)() for name in names}, stamp=stamp)
        return bool(receive.getTimestamp() == stamp)

    cell.wait(taken)
    now, before = cell.robot.until(cycle_at, sample["stamp"])
    return sample, now, before


def fast(box: ControlBox) -> bool:
    return max(map(abs, box.arm.getActualQd())) > 0.5


def close(measured: list[float], expected: Any, tolerance: float = 1e-9) -> bool:
    return bool(np.abs(np.array(measured) - np.array(expected)).max() < tolerance)


@covers(
    "RTDEReceiveInterface",
    getTimestamp="controller time of the cycle that the other values are of",
    getActualQ="joint angles of the physics in the same cycle",
    getActualQd="joint speeds of the physics in the same cycle",
    getTargetQ="commanded joint angles of the same cycle",
    getTargetQd="commanded joint speeds of the same cycle",
    getTargetQdd="difference of the commanded speeds of two cycles",
)
def test_joints(cell: Cell) -> None:
    sample, now, before = moving(cell, "getActualQ", "getActualQd", "getTargetQ", "getTargetQd", "getTargetQdd")
    assert sample["stamp"] == now["time"]
    assert close(sample["getActualQ"], now["q"])
    assert close(sample["getActualQd"], now["qd"])
    assert close(sample["getTargetQ"], now["target_q"])
    assert close(sample["getTargetQd"], now["target_qd"])
    assert max(map(abs, sample["getTargetQd"])) > 0.4
    assert close(sample["getTargetQdd"], (np.array(now["target_qd"]) - before["target_qd"]) / 0.002)


@covers(
    "RTDEReceiveInterface",
    getActualTCPPose="Pinocchio's pose at the physics' joint angles",
    getTargetTCPPose="Pinocchio's pose at the commanded joint angles",
    getActualTCPSpeed="Pinocchio's Jacobian times the physics' joint speeds",
    getTargetTCPSpeed="Pinocchio's Jacobian times the commanded joint speeds",
)
def test_tool_centre_point(cell: Cell) -> None:
    offset = [0.01, -0.02, 0.1565, 0.1, 0.0, 0.2]
    assert cell.control.setTcp(offset)
    sample, now, _ = moving(
        cell, "getActualTCPPose", "getTargetTCPPose", "getActualTCPSpeed", "getTargetTCPSpeed", "getActualTCPForce"
    )
    kinematics = Kinematics()
    kinematics.set_tcp(offset)
    for pose, speed, q, qd in (
        ("getActualTCPPose", "getActualTCPSpeed", now["q"], now["qd"]),
        ("getTargetTCPPose", "getTargetTCPSpeed", now["target_q"], now["target_qd"]),
    ):
        assert close(sample[pose], frames.ur_pose(*kinematics.forward(np.array(q))))
        assert close(sample[speed], frames.turn_base_wrench((kinematics.jacobian() @ np.array(qd)).tolist()))
        assert math.hypot(*sample[speed][:3]) > 0.05


@covers(
    "RTDEReceiveInterface",
    getTargetMoment="Pinocchio's inverse dynamics of the commanded motion, with the rotors",
    getTargetCurrent="in proportion to the target moment",
    getActualCurrent="in proportion to the motors' torque in the physics, gravity included",
    getJointControlOutput="the current that the joints' controllers ask for: as measured",
    getActualMomentum="Pinocchio's momentum of arm and gripper at the physics' speeds",
    getActualRobotCurrent="more while moving than at rest",
    getActualRobotVoltage="drops with the current that the arm draws",
    getActualJointVoltage="below that at the base, by each joint's current",
    getActualMainVoltage="48 V supply",
    getActualExecutionTime="machine time of the cycle, in milliseconds",
)
def test_dynamics_and_electricity(cell: Cell) -> None:
    names = ("getTargetMoment", "getTargetCurrent", "getActualCurrent", "getJointControlOutput", "getActualMomentum")
    more = ("getActualRobotCurrent", "getActualRobotVoltage", "getActualJointVoltage", "getActualMainVoltage")
    at_rest = cell.receive.getActualRobotCurrent(), cell.receive.getActualRobotVoltage()
    sample, now, before = moving(cell, *names, *more, "getActualExecutionTime")
    kinematics = Kinematics()
    q, qd = np.array(now["target_q"]), np.array(now["target_qd"])
    qdd = (qd - before["target_qd"]) / 0.002
    rotors = np.array([joint.armature for joint in JOINTS])
    moment = kinematics.mass_matrix(q) @ qdd + rotors * qdd + kinematics.bias(q, qd)
    assert close(sample["getTargetMoment"], moment, 1e-6)
    torque = np.array(now["torque"]) + kinematics.bias(np.array(now["q"]), np.zeros(6))
    constants = np.array(sample["getTargetMoment"]) / sample["getTargetCurrent"]
    assert all(5.0 < constant < 15.0 for constant in constants)
    assert close(sample["getActualCurrent"], torque / constants, 1e-6)
    assert sample["getJointControlOutput"] == sample["getActualCurrent"]
    assert sample["getActualMomentum"] == pytest.approx(kinematics.momentum(np.array(now["q"]), np.array(now["qd"])))
    assert sample["getActualMomentum"] > 0.1
    assert sample["getActualRobotCurrent"] > at_rest[0]
    assert sample["getActualRobotVoltage"] < at_rest[1] < sample["getActualMainVoltage"] == 48.0
    assert all(40.0 < voltage <= sample["getActualRobotVoltage"] for voltage in sample["getActualJointVoltage"])
    assert sample["getActualExecutionTime"] == pytest.approx(1e3 * now["execution"])


def raw(box: ControlBox) -> list[float]:
    return box.arm.sensor.raw[:]


@covers(
    "RTDEReceiveInterface",
    getFtRawWrench="the sensor's reading of the same cycle",
    getActualToolAccelerometer="gravity along the tool at rest, and what a stop adds",
)
def test_sensors_at_the_flange(cell: Cell) -> None:
    rest = cell.receive.getActualToolAccelerometer()
    _, rotation = Kinematics().tool(np.array(HOME))
    assert close(rest, frames.unrotate(rotation, (0.0, 0.0, GRAVITY)), 0.05)
    sample, now, _ = moving(cell, "getFtRawWrench")
    assert close(sample["getFtRawWrench"], now["raw"])
    assert math.hypot(*now["raw"][:3]) > 5.0  # the gripper's weight
    largest = 0.0

    def stopped() -> bool:
        nonlocal largest
        ahead = np.array(cell.receive.getActualToolAccelerometer()) - rest
        largest = max(largest, float(np.linalg.norm(ahead)))
        return bool(cell.robot.look(steady))

    cell.control.stopJ(10.0, True)
    cell.wait(stopped)
    assert largest > 0.5


def steady(box: ControlBox) -> bool:
    return box.steady


def warm(box: ControlBox) -> list[float]:
    return box.electrics.joint_temperature


@covers(
    "RTDEReceiveInterface",
    getJointTemperatures="above ambient, as the simulation has them",
    getJointMode="253, running, for each joint; 239 without power",
    getRobotMode="7 running; 3 without power",
    getSafetyMode="1 normal; 5 while the safeguard input is open",
    getSafetyStatusBits="bit 0 normal; bits 4 and 10 in a safeguard stop",
    getRobotStatus="bits 0 power and 1 program",
    getRuntimeState="2 playing; 4 paused",
)
def test_modes(cell: Cell) -> None:
    receive, robot = cell.receive, cell.robot
    assert receive.getJointTemperatures() == pytest.approx(robot.look(warm), abs=0.01)
    assert all(25.0 < value < 60.0 for value in receive.getJointTemperatures())
    assert receive.getJointMode() == [253] * 6
    assert (receive.getRobotMode(), receive.getSafetyMode(), receive.getRuntimeState()) == (7, 1, 2)
    assert (receive.getSafetyStatusBits(), receive.getRobotStatus()) == (1, 0b11)
    robot.look(ControlBox.open_safeguard, True)
    cell.wait(lambda: receive.getSafetyMode() == 5)
    assert receive.getSafetyStatusBits() == 1 << 4 | 1 << 10
    robot.look(ControlBox.open_safeguard, False)
    cell.wait(lambda: receive.getSafetyMode() == 1)
    robot.look(ControlBox.pause)
    cell.wait(lambda: receive.getRuntimeState() == 4)
    assert receive.getRobotStatus() == 0b01
    robot.look(ControlBox.power_off)
    cell.wait(lambda: receive.getRobotMode() == 3)
    assert receive.getJointMode() == [239] * 6
    assert receive.getRobotStatus() == 0
    robot.look(ControlBox.brake_release)
    cell.wait(lambda: receive.getRobotMode() == 7)


@covers(
    "RTDEReceiveInterface",
    getSpeedScaling="of the trajectory: 1 as long as nothing but the slider slows it",
    getTargetSpeedFraction="the slider",
    getSpeedScalingCombined="the share of the programmed speed at which the physics moves; 0 while paused",
)
def test_speed_scaling(cell: Cell) -> None:
    receive = cell.receive
    assert (receive.getSpeedScaling(), receive.getTargetSpeedFraction(), receive.getSpeedScalingCombined()) == (1, 1, 1)
    assert cell.io.setSpeedSlider(0.4)
    assert cell.control.moveJ(there(0.3), 1.0, 10.0, True)
    cell.wait(lambda: max(map(abs, receive.getTargetQd())) > 0.39)
    assert receive.getTargetSpeedFraction() == pytest.approx(0.4)
    assert receive.getSpeedScaling() == pytest.approx(1.0)
    assert receive.getSpeedScalingCombined() == pytest.approx(0.4)
    cell.robot.look(ControlBox.pause)
    cell.wait(lambda: receive.getSpeedScalingCombined() == 0.0)
    cell.robot.look(ControlBox.play)
    cell.robot.until(steady)
    assert max(max(map(abs, cycle["target_qd"])) for cycle in cell.robot.look(trail)) < 0.4001


def wire(box: ControlBox, bits: int, first: float, second: float) -> None:
    box.wiring.digital_in = bits
    box.wiring.analog_in = [first, second]


@covers(
    "RTDEReceiveInterface",
    getActualDigitalInputBits="what the surroundings put on the inputs: standard, configurable, tool",
    getDigitalInState="one bit of them",
    getActualDigitalOutputBits="what is on the outputs",
    getDigitalOutState="one bit of them",
    getStandardAnalogInput0="what the surroundings put on the input [A]",
    getStandardAnalogInput1="what the surroundings put on the input [A]",
    getStandardAnalogOutput0="what the IO interface put on the output [A]",
    getStandardAnalogOutput1="what the IO interface put on the output [V]",
)
def test_inputs_and_outputs(cell: Cell) -> None:
    receive, io = cell.receive, cell.io
    cell.robot.look(wire, 1 << 3 | 1 << 10 | 1 << 17, 0.012, 0.007)
    cell.wait(lambda: receive.getActualDigitalInputBits() == 1 << 3 | 1 << 10 | 1 << 17)
    assert [bit for bit in range(18) if receive.getDigitalInState(bit)] == [3, 10, 17]
    assert receive.getStandardAnalogInput0() == pytest.approx(0.012)
    assert receive.getStandardAnalogInput1() == pytest.approx(0.007)
    io.setStandardDigitalOut(2, True)
    io.setAnalogOutputCurrent(0, 0.5)
    io.setAnalogOutputVoltage(1, 0.25)
    cell.wait(lambda: receive.getStandardAnalogOutput1() == pytest.approx(2.5))
    assert receive.getStandardAnalogOutput0() == pytest.approx(0.012)
    assert receive.getActualDigitalOutputBits() == 1 << 2
    assert receive.getDigitalOutState(2)
    assert not receive.getDigitalOutState(3)
    io.setStandardDigitalOut(2, False)
    cell.wait(lambda: receive.getActualDigitalOutputBits() == 0)


def write_registers(box: ControlBox) -> None:
    for index in range(12, 20):
        box.registers.output_int[index] = -index
        box.registers.output_double[index] = index + 0.5


@covers(
    "RTDEReceiveInterface",
    getOutputIntRegister="registers 12 to 19 as a program writes them",
    getOutputDoubleRegister="registers 12 to 19 as a program writes them",
)
def test_output_registers(cell: Cell) -> None:
    cell.robot.look(write_registers)
    cell.wait(lambda: cell.receive.getOutputIntRegister(19) == -19)
    assert [cell.receive.getOutputIntRegister(index) for index in range(12, 20)] == [-i for i in range(12, 20)]
    assert [cell.receive.getOutputDoubleRegister(index) for index in range(12, 20)] == [i + 0.5 for i in range(12, 20)]


@covers(
    "RTDEReceiveInterface",
    getPayload="mass as a client has said it to the arm",
    getPayloadCog="its centre",
    getPayloadInertia="its inertia",
)
def test_payload(cell: Cell) -> None:
    assert cell.control.setTargetPayload(1.25, [0.01, 0.02, 0.03], [1e-3, 2e-3, 3e-3, 0.0, 0.0, 1e-4])
    cell.wait(lambda: cell.receive.getPayload() == 1.25)
    assert cell.receive.getPayloadCog() == pytest.approx([0.01, 0.02, 0.03])
    assert cell.receive.getPayloadInertia() == pytest.approx([1e-3, 2e-3, 3e-3, 0.0, 0.0, 1e-4])


@covers(
    "RTDEReceiveInterface",
    initPeriod="begins a period of the receiving rate",
    waitPeriod="ends it: as many control cycles pass in the simulation",
)
def test_periods_are_control_cycles(cell: Cell) -> None:
    begin = cell.receive.getTimestamp()
    for _ in range(100):
        cell.receive.waitPeriod(cell.receive.initPeriod())
    cell.in_step()
    assert cell.receive.getTimestamp() - begin > 0.19


@covers(
    "RTDEReceiveInterface",
    startFileRecording="writes a CSV file, row by row what the joints did in the simulation",
    stopFileRecording="ends it",
)
@pytest.mark.parametrize("variables", [["timestamp", "actual_q"], []])
def test_a_recording_is_what_the_joints_did(cell: Cell, tmp_path: Path, variables: list[str]) -> None:
    path = tmp_path / "record.csv"
    assert cell.receive.startFileRecording(str(path), variables)
    assert cell.control.moveJ(there(0.1), 1.0, 4.0)
    assert cell.receive.stopFileRecording()
    known = {round(cycle["time"], 6): cycle["q"] for cycle in cell.robot.look(trail)}
    with path.open() as file:
        rows = list(csv.DictReader(file))
    matching = [row for row in rows if float(row["timestamp"]) in known]
    assert len(matching) > 50
    for row in matching:
        angles = [float(row[f"actual_q_{index}"]) for index in range(6)]
        assert close(angles, known[float(row["timestamp"])], 0.02)  # a row may be cut by the next cycle
    if not variables:
        assert {"robot_mode", "ft_raw_wrench_5", "output_double_register_19"} <= set(rows[0])


@covers(
    "RTDEReceiveInterface",
    isConnected="whether packages come",
    disconnect="packages end, values stay as they were",
    reconnect="packages come again",
)
def test_connection(cell: Cell) -> None:
    receive = cell.receive
    assert receive.isConnected()
    receive.disconnect()
    assert not receive.isConnected()
    stale = receive.getTimestamp()
    cell.control.moveJ(there(0.05), *(3.0, 10.0))
    assert receive.getTimestamp() == stale
    assert receive.reconnect()
    assert receive.isConnected()
    assert receive.getTimestamp() > stale
    assert close(receive.getActualQ(), cell.robot.look(joints), 1e-4)
