"""ur-rtde's forces and contacts: a part is picked, and pressed onto the board beside a hole; a hand pushes the arm."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from robots import Robot
from ur_rtde_clients import FAST, HOME, Cell, begin_trail, connected, push, restored, standing, trail
from ur_rtde_methods import covers

from drivers.ur3e import frames
from drivers.ur3e.arm import GRIPPER_PIN
from drivers.ur3e.control_box.box import ControlBox
from drivers.ur3e.parameters import GRIPPER
from drivers.ur3e.workcell import Workcell
from runtime import config
from runtime.component import component

CELL = config.load("igbt").cell
PART = component(CELL.component)
TCP = [0.0, 0.0, GRIPPER.reach + PART.grip, 0.0, 0.0, 0.0]  # of the pin tips
TOP = CELL.board.z  # [m]
FREE = 2e-3  # [m] of the pin tips above the board
# Pins of 0.6 mm are 4 mm beside the middle of a hole of 1.5 mm.
SPOT = (CELL.board.x, CELL.board.y + 4e-3)
DOWN = [0.0, 0.0, -1.0, 0.0, 0.0, 0.0]
ALONG_Z = [0, 0, 1, 0, 0, 0]
BASE = [0.0] * 6


@pytest.fixture(scope="module")
def running() -> Iterator[Cell]:
    with connected(Robot("igbt")) as cell:
        restored(cell)
        pick(cell)
        yield cell


@pytest.fixture
def cell(running: Cell) -> Cell:
    """The part's pin tips stand a little above the board, and the sensor is zeroed."""
    robot, control = running.robot, running.control
    if robot.look(height) < TOP + FREE / 2:
        robot.look(ControlBox.stop)
        running.wait(lambda: not control.isProgramRunning())
    if not control.isProgramRunning():
        control.reuploadScript()
        running.wait(control.isProgramRunning)
    robot.look(push, [0.0] * 6)
    assert control.moveL(at(*SPOT, TOP + FREE), 0.1, 1.0)
    robot.until(standing)
    assert control.zeroFtSensor()
    return running


def at(x: float, y: float, z: float) -> list[float]:
    """UR's pose of the pin tips at a place in base_link, tool down."""
    return frames.ur_pose((x, y, z), frames.tool_down(0.0))


def pick(cell: Cell) -> None:
    """Fetch the feeder's part, and carry it over the board."""
    control, io, station = cell.control, cell.io, Workcell()
    feeder = station.feeder_x, station.feeder_y
    above = TOP + station.clearance_height
    assert control.setTcp(TCP)
    io.setToolDigitalOut(GRIPPER_PIN, False)
    q = control.getInverseKinematics(at(*feeder, above), HOME)
    assert control.moveJ(q, *FAST)
    assert control.moveL(at(*feeder, station.feeder_z), 0.25, 2.0)
    io.setToolDigitalOut(GRIPPER_PIN, True)
    cell.robot.until(holding)
    assert control.setPayload(GRIPPER.mass + PART.mass, GRIPPER.centre_of_mass)
    assert control.moveL(at(*feeder, above), 0.25, 2.0)
    assert control.moveL(at(*SPOT, above), 0.25, 2.0)


def holding(box: ControlBox) -> bool:
    return box.arm.holding


def height(box: ControlBox) -> float:
    """[m] of the pin tips."""
    return box.arm.pose[0][2]


def place(box: ControlBox) -> tuple[float, ...]:
    return box.arm.pose[0]


def felt(box: ControlBox) -> list[float]:
    """Wrench (6,) in UR's base."""
    return box.arm.getActualTCPForce()


def presses(box: ControlBox, force: float) -> bool:
    return box.arm.wrench[2] > force


def upward(cell: Cell, cycles: int = 200) -> float:
    """[N] mean force of the board on the part over some control cycles, as the receive interface gives it."""
    forces = []
    for _ in range(cycles):
        forces.append(cell.receive.getActualTCPForce()[2])
        cell.receive.waitPeriod(cell.receive.initPeriod())
    return float(np.mean(forces))


def press(cell: Cell, force: float, kind: int = 2, limit: float = 0.02) -> None:
    frame = BASE if kind == 2 else at(*SPOT, TOP)
    assert cell.control.forceMode(frame, ALONG_Z, [0.0, 0.0, -force, 0.0, 0.0, 0.0], kind, [limit] * 3 + [0.1] * 3)


@covers(
    "RTDEControlInterface",
    forceMode="the part is pressed onto the board with the force; the free axis keeps to its speed limit on the way",
    forceModeStop="the arm stands, and no longer gives way",
)
@covers("RTDEReceiveInterface", getActualTCPForce="what the board does to the part: the force that is pressed with")
def test_force_mode(cell: Cell) -> None:
    cell.robot.look(begin_trail)
    press(cell, 10.0, limit=4e-3)
    cell.robot.until(presses, 8.0)
    downward = [-cycle["twist"][2] for cycle in cell.robot.look(trail)]
    assert 3e-3 < max(downward) < 4.1e-3
    assert upward(cell) == pytest.approx(10.0, abs=1.5)
    assert cell.robot.look(height) == pytest.approx(TOP, abs=3e-4)
    press(cell, 20.0)
    cell.robot.until(presses, 18.0)
    assert upward(cell) == pytest.approx(20.0, abs=1.5)
    assert cell.control.forceModeStop()
    cell.robot.until(standing)
    before = cell.robot.look(place)
    cell.robot.look(push, [8.0, 0.0, 8.0, 0.0, 0.0, 0.0])
    cell.in_step()
    assert math.dist(cell.robot.look(place), before) < 1e-3


@covers(
    "RTDEControlInterface",
    forceModeSetDamping="a higher damping moves more slowly towards the contact",
    forceModeSetGainScaling="twice the gain moves twice as fast, as far as the damping is the same",
)
def test_how_eagerly_force_mode_moves(cell: Cell) -> None:
    control = cell.control
    assert control.moveL(at(*SPOT, TOP + 0.012), 0.1, 1.0)

    def top_speed(damping: float, gain: float) -> float:
        assert control.forceModeSetDamping(damping)
        assert control.forceModeSetGainScaling(gain)
        assert control.moveL(at(*SPOT, TOP + 0.012), 0.1, 1.0)
        assert control.zeroFtSensor()
        cell.robot.look(begin_trail)
        press(cell, 10.0, limit=0.5)
        cell.robot.until(lower_than, TOP + 0.008)
        speed = float(-np.min([cycle["twist"][2] for cycle in cell.robot.look(trail)]))
        assert control.forceModeStop()
        cell.robot.until(standing)
        return speed

    usual = top_speed(0.025, 0.5)
    assert top_speed(0.025, 1.0) == pytest.approx(2 * usual, rel=0.3)
    assert top_speed(0.5, 0.5) < 0.7 * usual
    assert control.forceModeSetDamping(0.025)
    assert control.forceModeSetGainScaling(0.5)


def lower_than(box: ControlBox, z: float) -> bool:
    return box.arm.pose[0][2] < z


@covers("RTDEControlInterface", zeroFtSensor="the wrench reads zero in contact; what the sensor itself has stays")
def test_zeroing_the_sensor(cell: Cell) -> None:
    press(cell, 15.0)
    cell.robot.until(presses, 13.0)
    assert cell.control.forceModeStop()
    cell.robot.until(standing)
    pressed = upward(cell)
    assert pressed > 8.0
    raw = np.mean(cell.receive.getFtRawWrench()[:3])
    assert cell.control.zeroFtSensor()
    cell.in_step()
    assert abs(upward(cell)) < 1.0
    assert np.mean(cell.receive.getFtRawWrench()[:3]) == pytest.approx(raw, abs=2.0)


@covers(
    "RTDEControlInterface",
    toolContact="cycles since contact began, pressed; 0 in the air (ur-rtde gives the answer to the call before)",
)
def test_tool_contact(cell: Cell) -> None:
    control = cell.control
    control.toolContact(DOWN)
    cell.wait(lambda: control.toolContact(DOWN) == 0)
    press(cell, 15.0)
    cell.robot.until(presses, 13.0)
    cell.wait(lambda: control.toolContact(DOWN) > 20)
    cell.wait(lambda: control.toolContact([0.0] * 6) > 20)
    cell.wait(lambda: control.toolContact([0.0, 0.0, 1.0, 0.0, 0.0, 0.0]) == 0)
    assert control.forceModeStop()


@covers(
    "RTDEControlInterface",
    moveUntilContact="goes down until the part touches the board, and back to where it touched it first",
)
def test_moving_until_contact(cell: Cell) -> None:
    cell.robot.look(begin_trail)
    assert cell.control.moveUntilContact([0.0, 0.0, -0.01, 0.0, 0.0, 0.0])
    cell.robot.until(standing)
    assert cell.robot.look(height) == pytest.approx(TOP, abs=3e-4)
    lowest = min(cycle["position"][2] for cycle in cell.robot.look(trail))
    assert lowest < cell.robot.look(height)
    assert abs(cell.robot.look(felt)[2]) < 30.0


@covers(
    "RTDEControlInterface",
    startContactDetection="an asynchronous move ends where the part touches the board",
    readContactDetection="false on the way, true after the contact",
    stopContactDetection="whether there was a contact; none if it ends in the air",
)
def test_contact_detection(cell: Cell) -> None:
    control = cell.control
    assert control.startContactDetection()
    assert control.moveL(at(*SPOT, TOP - 2e-3), 0.005, 0.5, True)
    assert not control.readContactDetection()
    cell.robot.until(standing)  # asking all the time may make ur-rtde's script miss the contact
    assert control.readContactDetection()
    assert cell.robot.look(height) == pytest.approx(TOP, abs=3e-4)
    assert control.stopContactDetection()
    assert control.startContactDetection(DOWN)
    assert not control.stopContactDetection()


def away_from(box: ControlBox, start: tuple[float, ...], axis: int, distance: float) -> bool:
    return abs(box.arm.pose[0][axis] - start[axis]) > distance


@covers(
    "RTDEControlInterface",
    freedriveMode="the arm follows a hand's push along the free axes of the feature, and no others",
    endFreedriveMode="it no longer gives way",
    teachMode="the arm follows a hand's push",
    endTeachMode="it no longer gives way",
    getFreedriveStatus="0 free to move, 1 close to a singularity",
)
def test_hand_guiding(cell: Cell) -> None:
    control, robot = cell.control, cell.robot
    assert control.moveL(at(*SPOT, TOP + 0.1), 0.25, 2.0)

    def holds() -> None:
        robot.until(standing)
        start = robot.look(place)
        robot.look(push, [25.0, 0.0, 0.0, 0.0, 0.0, 0.0])
        for _ in range(50):
            cell.in_step()
        assert math.dist(robot.look(place), start) < 2e-3
        robot.look(push, [0.0] * 6)

    holds()
    start = robot.look(place)
    assert control.freedriveMode([0, 1, 0, 0, 0, 0], BASE)
    assert control.getFreedriveStatus() == 0
    robot.look(push, [25.0, 25.0, 0.0, 0.0, 0.0, 0.0])
    robot.until(away_from, start, 1, 0.02)
    robot.look(push, [0.0] * 6)
    x, _, z = robot.look(place)
    assert (x, z) == pytest.approx((start[0], start[2]), abs=2e-3)
    assert control.endFreedriveMode()
    holds()
    start = robot.look(place)
    assert control.teachMode()
    robot.look(push, [25.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    robot.until(away_from, start, 0, 0.02)
    robot.look(push, [0.0] * 6)
    assert control.endTeachMode()
    holds()
    assert control.moveJ([*HOME[:4], -0.01, HOME[5]], *FAST)
    assert control.freedriveMode()
    assert control.getFreedriveStatus() == 1
    assert control.endFreedriveMode()
    assert control.moveJ(HOME, *FAST)


def gripped(box: ControlBox) -> dict[str, Any]:
    return {"holding": box.arm.holding, "bits": box.wiring.digital_out}


@covers("RTDEIOInterface", setToolDigitalOut="the gripper takes the feeder's part, and lets it go")
def test_the_gripper(cell: Cell) -> None:
    assert cell.robot.look(gripped) == {"holding": True, "bits": 1 << 16}
    cell.io.setToolDigitalOut(GRIPPER_PIN, False)
    cell.wait(lambda: not cell.robot.look(holding))
    assert cell.robot.look(gripped) == {"holding": False, "bits": 0}
