"""One contract for every arm: the simulated one in this process, and one on the network through ur-rtde.

What an arm says is compared with what its simulation knows.
"""

from __future__ import annotations

import logging
import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import numpy as np
import pytest
from robots import Robot

from drivers.ur3e import frames
from drivers.ur3e.arm import NORMAL, PROTECTIVE_STOP, RUNNING, SAFEGUARD_STOP, Arm
from drivers.ur3e.control_box.box import ControlBox
from drivers.ur3e.driver import MujocoUr3e
from drivers.ur3e.parameters import CYCLE, GRIPPER, UNLOCK_DELAY
from drivers.ur3e.simulated_arm import SimulatedArm
from drivers.ur3e.simulated_cell import SimulatedCell
from drivers.ur3e.skill import InsertionSkill
from drivers.ur3e.wired_arm import WiredArm
from runtime import config
from runtime.component import component
from runtime.errors import ArmError
from runtime.messages import Outcome

pytest.importorskip("rtde_control")

from drivers.ur3e.ur_connection import ConnectionLostError, UrConnection

Result = TypeVar("Result")

CELL = config.load("igbt").cell
PART = component(CELL.component)
TIP = GRIPPER.reach + PART.grip
ABOVE = (0.30, 0.02, 0.12)  # [m] base_link, of the TCP
HOLE = CELL.board.holes[0]
SOLID = (CELL.board.x + HOLE.x + 2.5e-3, CELL.board.y + HOLE.y + 3e-3)  # [m] no pin meets a hole there
CENTRE = list(GRIPPER.centre_of_mass)


class Bench(Protocol):
    """An arm to be tried, and the simulation behind it."""

    @property
    def arm(self) -> Arm:
        """The arm under test."""
        ...

    def look(self, function: Callable[..., Result], *arguments: object) -> Result:
        """What a function says of (simulated arm, *arguments)."""
        ...

    def safeguard(self, is_open: bool) -> None:
        """Somebody is within the arm's reach, or gone again."""
        ...

    def unlock(self) -> None:
        """Release a protective stop once that is possible."""
        ...

    def present_part(self) -> None:
        """See that a part is in the feeder."""
        ...

    def awake(self) -> None:
        """See that the arm obeys, however long nobody has asked anything of it."""
        ...


class SimulatedBench:
    """The arm of a simulated cell in this process."""

    def __init__(self) -> None:
        self._open = False
        self._cell: SimulatedCell = MujocoUr3e().setup().simulate(CELL, gate=lambda _time: not self._open)
        self._search = 0
        self.arm: SimulatedArm = self._cell.arm

    def look(self, function: Callable[..., Result], *arguments: object) -> Result:
        return function(self.arm, *arguments)

    def safeguard(self, is_open: bool) -> None:
        self._open = is_open

    def unlock(self) -> None:
        wait(self.arm, UNLOCK_DELAY)
        assert self.arm.unlockProtectiveStop()

    def present_part(self) -> None:
        self._search += 1
        self._cell.begin_search(self._search, 1, "1")

    def awake(self) -> None:
        """It sleeps with the test."""


class Permission:
    """A gate that a test opens and closes."""

    def __init__(self) -> None:
        self.granted = True

    def __call__(self, _time: int) -> bool:
        return self.granted


class WiredBench:
    """An arm on the network, and the controller's process."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.permission = Permission()
        self.seen: list[tuple[int, int, float]] = []  # session time [ns], safety mode, speed scaling
        self.arm = WiredArm(UrConnection(robot.host), gate=self.permission, watchdog=2.0, observe=self._note)
        self.arm.begin_session()

    def _note(self) -> None:
        self.seen.append((self.arm.time, self.arm.safety_mode, self.arm.getSpeedScaling()))

    def look(self, function: Callable[..., Result], *arguments: object) -> Result:
        result: Result = self.robot.look(_of_arm, function, *arguments)
        return result

    def safeguard(self, is_open: bool) -> None:
        self.robot.look(ControlBox.open_safeguard, is_open)

    def unlock(self) -> None:
        self.arm.recover()

    def present_part(self) -> None:
        """The cell around a controller presents one whenever there is none."""
        self.robot.until(_part_waits)

    def awake(self) -> None:
        """Between two tests nobody feeds the watchdog."""
        self.permission.granted = True
        self.arm.cycle()
        if self.arm.program_ended:
            self.arm.recover()
        self.seen.clear()


def _of_arm(box: ControlBox, function: Callable[..., Any], *arguments: object) -> Any:
    return function(box.arm, *arguments)


def _part_waits(box: ControlBox) -> bool:
    return bool(box.arm.scene.part_waiting)


@pytest.fixture(scope="module")
def wired_bench() -> Iterator[WiredBench]:
    with Robot("igbt", seed=1) as robot:
        bench = WiredBench(robot)
        yield bench
        bench.arm.close()


@pytest.fixture(params=["simulated", "wired"], scope="module")
def made(request: pytest.FixtureRequest) -> Bench:
    if request.param == "simulated":
        return SimulatedBench()
    bench: Bench = request.getfixturevalue("wired_bench")
    return bench


@pytest.fixture
def bench(made: Bench) -> Bench:
    made.awake()
    begin(made.arm)
    return made


@pytest.fixture
def wired(wired_bench: WiredBench) -> WiredBench:
    wired_bench.awake()
    begin(wired_bench.arm)
    return wired_bench


def begin(arm: Arm) -> None:
    """An empty gripper high above the board, wherever the test before has left it."""
    arm.setTcp([0.0, 0.0, TIP, 0.0, 0.0, 0.0])
    arm.setToolDigitalOut(0, False)
    arm.setPayload(GRIPPER.mass, CENTRE)
    assert arm.moveL(pose(*ABOVE), 0.5, 2.0)
    wait(arm, 0.1)


def pose(x: float, y: float, z: float, yaw: float = 0.0) -> list[float]:
    return frames.ur_pose((x, y, z), frames.tool_down(yaw))


def wait(arm: Arm, seconds: float) -> None:
    end = arm.getTimestamp() + seconds - CYCLE / 2
    while arm.getTimestamp() < end:
        arm.waitPeriod(arm.initPeriod())


@dataclass(frozen=True)
class Truth:
    """What a simulation knows of its arm."""

    q: list[float]
    target_q: list[float]
    qd: list[float]
    pose: list[float]
    target_pose: list[float]
    speed: list[float]
    force: list[float]
    raw: list[float]
    tcp: tuple[float, ...]
    payload: tuple[float, tuple[float, ...]]
    holding: bool
    idle: bool
    stop_reason: str


def truth(arm: SimulatedArm) -> Truth:
    return Truth(
        q=arm.getActualQ(),
        target_q=arm.getTargetQ(),
        qd=arm.getActualQd(),
        pose=arm.getActualTCPPose(),
        target_pose=arm.getTargetTCPPose(),
        speed=arm.getActualTCPSpeed(),
        force=arm.getActualTCPForce(),
        raw=arm.getFtRawWrench(),
        tcp=arm.tcp_offset,
        payload=arm.payload,
        holding=arm.holding,
        idle=arm.controller.idle,
        stop_reason=arm.stop_reason,
    )


def distance(a: list[float], b: list[float]) -> tuple[float, float]:
    """How far [m], [rad] two poses are from each other."""
    (here, now), (there, then) = frames.ros_pose(a), frames.ros_pose(b)
    turn = frames.vector_of_rotation(frames.product(then, frames.transpose(now)))
    return math.dist(here, there), math.hypot(*turn)


def close(a: list[float], b: list[float], metres: float, radians: float) -> bool:
    """Whether two poses are the same, but for so much."""
    off, turned = distance(a, b)
    return off < metres and turned < radians


def slider(box: ControlBox) -> float:
    return box.speed_slider


def path_until(arm: Arm, target: list[float]) -> list[list[float]]:
    """Measured poses until the commanded one has arrived."""
    found = []
    while not close(arm.getTargetTCPPose(), target, 1e-7, 1e-5):
        arm.waitPeriod(arm.initPeriod())
        found.append(arm.getActualTCPPose())
        assert len(found) < 5 / CYCLE
    return found


def hold_part_over_board(bench: Bench) -> None:
    """A part in the gripper, pin tips 0.3 mm above solid board, the sensor zeroed."""
    arm, cell = bench.arm, MujocoUr3e().workcell
    bench.present_part()
    arm.moveL(pose(cell.feeder_x, cell.feeder_y, cell.feeder_z + 0.03), 0.5, 2.0)
    arm.moveL(pose(cell.feeder_x, cell.feeder_y, cell.feeder_z), 0.1)
    arm.setToolDigitalOut(0, True)
    assert bench.look(truth).holding
    arm.setPayload(GRIPPER.mass + PART.mass, CENTRE)
    arm.moveL(pose(cell.feeder_x, cell.feeder_y, 0.12), 0.5, 2.0)
    arm.moveL(pose(*SOLID, 0.10), 0.5, 2.0)
    arm.moveL(pose(*SOLID, CELL.board.z + 0.3e-3), 0.05)
    wait(arm, 0.2)
    arm.zeroFtSensor()


# The contract


def test_it_says_what_the_simulation_knows(bench: Bench) -> None:
    arm = bench.arm
    known = bench.look(truth)
    assert arm.getActualQ() == pytest.approx(known.q, abs=1e-5)
    assert arm.getTargetQ() == pytest.approx(known.target_q, abs=1e-9)
    assert arm.getActualQd() == pytest.approx(known.qd, abs=1e-3)
    assert arm.getTargetQd() == [0.0] * 6
    assert close(arm.getActualTCPPose(), known.pose, 2e-6, 1e-5)
    assert close(arm.getTargetTCPPose(), known.target_pose, 1e-9, 1e-6)
    assert arm.getActualTCPSpeed() == pytest.approx(known.speed, abs=1e-3)
    assert arm.getActualTCPForce() == pytest.approx(known.force, abs=2.0)  # noise of the sensor at another time
    assert arm.getFtRawWrench() == pytest.approx(known.raw, abs=2.0)
    assert (arm.getRobotMode(), arm.getSafetyMode(), arm.getSpeedScaling()) == (RUNNING, NORMAL, 1.0)
    before = arm.getTimestamp()
    wait(arm, 0.1)
    assert arm.getTimestamp() - before == pytest.approx(0.1, abs=0.02)
    assert arm.isSteady()


def test_an_arm_at_rest_needs_no_torque_beyond_what_holds_its_weight(bench: Bench) -> None:
    assert bench.arm.isSteady()
    assert max(map(abs, bench.arm.getJointTorques())) < 0.5


def test_move_l_arrives_in_a_straight_line(bench: Bench) -> None:
    arm = bench.arm
    target = pose(0.33, -0.05, 0.10, 0.1)
    start, end = np.array(arm.getActualTCPPose()[:3]), np.array(target[:3])
    assert arm.moveL(target, 0.2, 1.0, asynchronous=True)
    points = np.array(path_until(arm, target))[:, :3] - start
    along = (end - start) / np.linalg.norm(end - start)
    assert np.linalg.norm(points - np.outer(points @ along, along), axis=1).max() < 0.15e-3
    assert len(points) * CYCLE == pytest.approx(np.linalg.norm(end - start) / 0.2 + 0.2, abs=0.15)
    assert arm.moveL(pose(*ABOVE), 0.2, 1.0)
    wait(arm, 0.1)
    assert close(bench.look(truth).pose, pose(*ABOVE), 5e-6, 1e-4)


def test_move_j_arrives_with_all_joints_together(bench: Bench) -> None:
    arm = bench.arm
    start = np.array(arm.getTargetQ())
    target = start + np.array([0.2, -0.1, 0.1, 0.1, -0.2, 0.3])
    assert arm.moveJ(target.tolist(), 1.0, 2.0, asynchronous=True)
    wait(arm, 0.3)
    share = (np.array(arm.getTargetQ()) - start) / (target - start)
    assert 0.05 < share[0] < 0.95
    assert np.ptp(share) < 1e-6
    assert arm.moveJ(start.tolist(), 1.0, 2.0)
    assert arm.getTargetQ() == pytest.approx(start, abs=1e-6)
    wait(arm, 0.1)
    assert bench.look(truth).q == pytest.approx(start, abs=1e-4)


def test_speed_l_goes_on_until_it_is_stopped(bench: Bench) -> None:
    arm = bench.arm
    assert arm.speedL([0.02, 0.0, -0.01, 0, 0, 0], 0.5)
    wait(arm, 0.5)
    assert bench.look(truth).speed[:3] == pytest.approx([0.02, 0, -0.01], abs=2e-4)
    assert arm.getActualTCPSpeed()[:3] == pytest.approx([0.02, 0, -0.01], abs=2e-4)
    assert not arm.isSteady()
    assert arm.speedStop(1.0)
    here = arm.getTargetTCPPose()
    moved = np.array(here[:3]) - pose(*ABOVE)[:3]
    assert moved[0] / moved[2] == pytest.approx(-2.0, rel=0.02)
    wait(arm, 0.1)
    assert close(bench.look(truth).pose, here, 0.05e-3, 1e-3)
    assert arm.isSteady()


def test_stop_l_ends_a_motion_on_its_way(bench: Bench) -> None:
    arm = bench.arm
    target = pose(0.33, -0.05, 0.10)
    assert arm.moveL(target, 0.1, asynchronous=True)
    wait(arm, 0.3)
    arm.stopL(2.0)
    wait(arm, 0.1)
    assert arm.isSteady()
    known = bench.look(truth)
    assert known.idle
    assert distance(known.pose, target)[0] > 0.02
    assert distance(known.pose, pose(*ABOVE))[0] > 0.01


def test_servo_l_follows(bench: Bench) -> None:
    arm = bench.arm
    begun = arm.getTimestamp()
    behind = []
    while (elapsed := arm.getTimestamp() - begun) < 1.0:
        target = pose(ABOVE[0] + 0.01 * math.sin(elapsed * math.pi), ABOVE[1], ABOVE[2])
        assert arm.servoL(target, 0, 0, CYCLE, 0.03, 300)
        arm.waitPeriod(arm.initPeriod())
        behind.append(distance(arm.getActualTCPPose(), target)[0])
    assert 0.2e-3 < max(behind[50:]) < 2.5e-3
    assert arm.servoStop()
    wait(arm, 0.1)
    assert distance(bench.look(truth).pose, pose(*ABOVE))[0] < 1.5e-3
    assert arm.isSteady()


def test_a_part_is_held_pressed_down_and_let_go(bench: Bench) -> None:
    hold_part_over_board(bench)
    arm = bench.arm
    limits = [0.01, 0.01, 0.01, 0.1, 0.1, 0.1]
    assert arm.forceMode([0.0] * 6, [0, 0, 1, 0, 0, 0], [0.0, 0.0, -5.0, 0.0, 0.0, 0.0], 2, limits)
    wait(arm, 1.0)
    felt, true = [], []
    for _ in range(10):
        wait(arm, 0.02)
        felt.append(arm.getActualTCPForce()[2])
        true.append(bench.look(truth).force[2])
    assert np.mean(felt) == pytest.approx(5.0, abs=0.5)
    assert np.mean(true) == pytest.approx(5.0, abs=0.5)
    assert arm.forceModeStop()
    assert arm.getSafetyMode() == NORMAL
    here = bench.look(truth).pose
    wait(arm, 0.1)
    assert distance(bench.look(truth).pose, here)[0] < 0.02e-3
    arm.moveL(pose(*SOLID, CELL.board.z + 0.05), 0.1)
    assert arm.setToolDigitalOut(0, False)
    assert not bench.look(truth).holding


def test_pins_slide_into_their_holes(bench: Bench) -> None:
    """Force mode down and a speed across at the same time, one ended without the other, again and again."""
    bench.present_part()
    skill = InsertionSkill(bench.arm, MujocoUr3e().workcell, CELL.board, PART)
    skill.pick()
    bench.look(put_holes, CELL.board.x + HOLE.x, CELL.board.y + HOLE.y)
    felt = skill.slide(HOLE, [(-1e-3, 0.0), (1e-3, 0.0)])
    assert (felt.outcome, felt.reason) == (Outcome.SEATED, "")
    assert 0.5e-3 < felt.travelled < 1.8e-3
    assert felt.depth > 0.95 * PART.depth
    assert not bench.look(complies)
    skill.release()
    assert not bench.look(truth).holding


def put_holes(arm: SimulatedArm, x: float, y: float) -> None:
    arm.scene.place_holes(x, y, HOLE.orientation or 0.0)


def complies(arm: SimulatedArm) -> bool:
    return arm.controller.compliance is not None


def test_tool_contact_counts_back_to_the_touch(bench: Bench) -> None:
    hold_part_over_board(bench)
    arm = bench.arm
    down = [0.0, 0.0, -1.0, 0.0, 0.0, 0.0]
    assert arm.toolContact(down) == 0
    arm.speedL([0, 0, -0.005, 0, 0, 0])
    count = 0
    while arm.getActualTCPForce()[2] < 8.0 and count < 300:
        arm.waitPeriod(arm.initPeriod())
        count += 1
    assert count < 300
    arm.speedStop()
    wait(arm, 0.1)
    first, then = arm.toolContact(down), arm.getTimestamp()
    assert first > 25
    wait(arm, 0.1)
    elapsed = (arm.getTimestamp() - then) / CYCLE
    assert arm.toolContact(down) - first == pytest.approx(elapsed, abs=25)
    assert arm.toolContact([0.0, 0.0, 1.0, 0.0, 0.0, 0.0]) == 0


def test_zeroing_takes_away_what_is_measured(bench: Bench) -> None:
    arm = bench.arm
    arm.setPayload(GRIPPER.mass - 0.5, CENTRE)
    wait(arm, 0.05)
    assert np.mean([force_after(arm, CYCLE) for _ in range(20)]) < -3.5
    assert arm.zeroFtSensor()
    assert np.mean([force_after(arm, CYCLE) for _ in range(20)]) == pytest.approx(0.0, abs=1.0)
    assert bench.look(truth).force[2] == pytest.approx(0.0, abs=2.0)
    arm.setPayload(GRIPPER.mass, CENTRE)
    assert np.mean([force_after(arm, CYCLE) for _ in range(20)]) > 3.5
    arm.zeroFtSensor()


def force_after(arm: Arm, seconds: float) -> float:
    wait(arm, seconds)
    return arm.getActualTCPForce()[2]


def test_tcp_and_payload_are_those_that_were_set(bench: Bench) -> None:
    arm = bench.arm
    flange = arm.getActualTCPPose()
    offset = [0.01, -0.02, TIP + 0.03, 0.1, 0.2, -0.3]
    assert arm.setTcp(offset)
    assert bench.look(truth).tcp == pytest.approx(offset, abs=1e-9)
    assert close(arm.getActualTCPPose(), bench.look(truth).pose, 2e-6, 1e-5)
    assert distance(arm.getActualTCPPose(), flange)[0] == pytest.approx(math.hypot(0.01, 0.02, 0.03), abs=1e-4)
    assert arm.setPayload(1.25, [0.01, 0.02, 0.05])
    mass, centre = bench.look(truth).payload
    assert (mass, *centre) == pytest.approx((1.25, 0.01, 0.02, 0.05), abs=1e-6)


def test_inverse_and_forward_kinematics_agree(bench: Bench) -> None:
    arm = bench.arm
    target = pose(0.28, 0.05, 0.12, 0.3)
    q = arm.getInverseKinematics(target)
    assert arm.getForwardKinematics(q)[:3] == pytest.approx(target[:3], abs=1e-7)
    assert close(arm.getForwardKinematics(q), target, 1e-7, 1e-6)
    assert close(arm.getForwardKinematics(), arm.getActualTCPPose(), 2e-6, 1e-5)
    flange = arm.getForwardKinematics(q, [0.0] * 6)
    assert flange[2] - target[2] == pytest.approx(TIP, abs=1e-7)
    far = arm.getInverseKinematics(target, [angle + 2 * math.pi * (index == 5) for index, angle in enumerate(q)])
    assert far[5] - q[5] == pytest.approx(2 * math.pi, abs=1e-6)
    with pytest.raises(ArmError, match="out of reach"):
        arm.getInverseKinematics(pose(0.9, 0.0, 0.1))


def test_a_safeguard_stop_makes_a_motion_last_longer(bench: Bench) -> None:
    arm = bench.arm
    target = pose(0.30, -0.08, 0.12)
    assert arm.moveL(target, 0.1, 0.5, asynchronous=True)
    wait(arm, 0.4)
    bench.safeguard(True)
    wait(arm, 0.3)
    assert arm.getSafetyMode() == SAFEGUARD_STOP
    assert arm.getSpeedScaling() == 0.0
    assert max(map(abs, arm.getTargetQd())) == 0.0
    held = arm.getTargetQ()
    wait(arm, 0.2)
    assert arm.getTargetQ() == held
    bench.safeguard(False)
    path = path_until(arm, target)
    assert arm.getSafetyMode() == NORMAL
    across = np.array(path)[:, [0, 2]] - [pose(*ABOVE)[0], ABOVE[2]]
    assert np.abs(across).max() < 0.3e-3


def test_a_protective_stop_ends_what_moves_and_refuses_the_rest_until_it_is_released(bench: Bench) -> None:
    arm = bench.arm
    assert arm.speedL([0.0, 0.02, 0.0, 0.0, 0.0, 0.0])
    wait(arm, 0.2)
    bench.look(SimulatedArm.protective_stop, "a test")
    wait(arm, 0.1)
    assert arm.getSafetyMode() == PROTECTIVE_STOP
    assert not arm.moveL(pose(*ABOVE))
    assert not arm.speedL([0.0, 0.0, 0.02, 0.0, 0.0, 0.0])
    bench.unlock()
    assert arm.getSafetyMode() == NORMAL
    assert arm.moveL(pose(*ABOVE))
    known = bench.look(truth)
    assert known.tcp == pytest.approx([0.0, 0.0, TIP, 0.0, 0.0, 0.0], abs=1e-9)
    assert known.payload[0] == pytest.approx(GRIPPER.mass, abs=1e-9)


# What only an arm on the network can meet


def switch_input(box: ControlBox, number: int, on: bool) -> None:
    box.wiring.set_input(number, on)


@pytest.mark.parametrize("number", [0, 8, 17])
def test_a_sensor_is_heard_where_it_is_wired(wired: WiredBench, number: int) -> None:
    for on in (True, False):
        wired.robot.look(switch_input, number, on)
        wait(wired.arm, 0.1)
        assert [other for other in range(18) if wired.arm.digital_input(other)] == [number] * on


def test_without_a_permit_it_stands_on_its_path_and_goes_on_with_the_next(wired: WiredBench) -> None:
    arm, robot = wired.arm, wired.robot
    target = pose(0.30, -0.08, 0.12)
    assert arm.moveL(target, 0.1, 0.5, asynchronous=True)
    wait(arm, 0.4)
    wired.permission.granted = False
    refused = arm.time
    while not arm.standing:
        arm.cycle()
        assert arm.getSafetyMode() == SAFEGUARD_STOP
    assert arm.time - refused < 0.2e9
    logging.getLogger(__name__).info("permit withdrawn at 0.1 m/s to standstill: %.0f ms", (arm.time - refused) / 1e6)
    held, here = arm.getTargetQ(), arm.getTargetTCPPose()
    wait(arm, 0.2)
    assert arm.getTargetQ() == held
    robot.look(ControlBox.set_speed_slider, 1.0)  # somebody at the pendant
    wait(arm, 0.2)
    assert robot.look(slider) == 0.0
    assert arm.standing
    assert distance(arm.getTargetTCPPose(), here)[0] < 2e-3
    wired.permission.granted = True
    path = path_until(arm, target)
    assert arm.getSafetyMode() == NORMAL
    across = np.array(path)[:, [0, 2]] - [pose(*ABOVE)[0], ABOVE[2]]
    assert np.abs(across).max() < 0.3e-3


def test_an_arm_that_hears_nothing_stops_by_itself(wired: WiredBench) -> None:
    arm = wired.arm
    assert arm.speedL([0.0, 0.01, 0.0, 0.0, 0.0, 0.0])
    wired.robot.until(lies_still)  # and this process feeds nobody meanwhile
    arm.cycle()
    assert arm.program_ended
    with pytest.raises(ArmError, match="did not take a speed: its control program has ended"):
        arm.speedL([0.0, 0.01, 0.0, 0.0, 0.0, 0.0])
    arm.recover()
    assert arm.moveL(pose(*ABOVE))


def test_a_program_that_is_started_anew_does_not_obey_what_the_last_one_was_told(wired: WiredBench) -> None:
    arm = wired.arm
    assert arm.speedL([0.0, 0.0, -0.01, 0.0, 0.0, 0.0])
    wired.robot.until(has_no_program)
    wired.robot.until(lies_still)
    wait(arm, 0.05)
    here = arm.getTargetTCPPose()
    arm.recover()
    wait(arm, 0.3)
    assert close(arm.getTargetTCPPose(), here, 1e-6, 1e-6)
    assert arm.moveL(pose(*ABOVE))


def has_no_program(box: ControlBox) -> bool:
    return box.runtime_state.name == "STOPPED"


def lies_still(box: ControlBox) -> bool:
    return box.arm.controller.idle


def test_a_motion_that_somebody_else_ends_is_named(wired: WiredBench) -> None:
    arm = wired.arm
    assert arm.moveL(pose(0.30, -0.08, 0.12), 0.1, asynchronous=True)
    wait(arm, 0.2)
    assert wired.robot.look(ControlBox.stop)
    with pytest.raises(ArmError, match="its control program has ended"):
        arm.moveL(pose(*ABOVE))


def test_it_says_why_an_arm_does_not_work() -> None:
    with Robot("empty") as robot:
        arm = WiredArm(UrConnection(robot.host), gate=lambda _time: True, watchdog=2.0)
        arm.begin_session()
        wait(arm, 0.1)
        robot.look(ControlBox.press_emergency_stop, True)
        with pytest.raises(ArmError, match="emergency stop: clear it on the pendant"):
            wait(arm, 2.0)
        arm.close()
        for power_on in (False, True):
            with pytest.raises(ArmError, match=r"not in normal mode \(.*EMERGENCY_STOP\): clear it on the pendant"):
                UrConnection(robot.host, power_on=power_on)
        robot.look(ControlBox.press_emergency_stop, False)
        with pytest.raises(ArmError, match=r"not ready to move \(.*POWER_OFF\): power the arm on .* power_on = true"):
            UrConnection(robot.host)
        arm = WiredArm(UrConnection(robot.host, power_on=True), gate=lambda _time: True, watchdog=2.0)
        arm.begin_session()
        wait(arm, 0.1)
        robot.look(ControlBox.power_off)
        with pytest.raises(ArmError, match=r"the arm is no longer powered \(robot mode 3\)"):
            wait(arm, 2.0)
        arm.close()
        arm = WiredArm(UrConnection(robot.host, power_on=True), gate=lambda _time: True, watchdog=2.0)
        arm.begin_session()
        wait(arm, 0.1)
        robot.kill()
        with pytest.raises(ConnectionLostError, match=rf"connection to {re.escape(robot.host)} lost"):
            wait(arm, 5.0)
        arm.close()
        with pytest.raises(ArmError, match=rf"no connection to {re.escape(robot.host)}"):
            UrConnection(robot.host)
