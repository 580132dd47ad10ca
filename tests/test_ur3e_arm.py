"""The simulated arm as its client sees it: motions, force mode, sensor, stops."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from drivers.ur3e import frames
from drivers.ur3e.arm import NORMAL, PROTECTIVE_STOP, SAFEGUARD_STOP, Arm
from drivers.ur3e.force_torque import ForceTorqueNoise, ForceTorqueSensor
from drivers.ur3e.parameters import CYCLE, GRAVITY, GRIPPER
from drivers.ur3e.scene import Scene
from drivers.ur3e.simulated_arm import SimulatedArm
from runtime.cell import Board, Hole
from runtime.component import component
from runtime.errors import ArmError

PART = component("capacitor")
BOARD = Board("single", (Hole("h1", 0.0, 0.0),))
TIP = GRIPPER.reach + PART.grip
ABOVE = (0.30, 0.02, 0.10)


def make(
    seed: int = 1,
    noise: ForceTorqueNoise | None = None,
    gate: Callable[[int], bool] | None = None,
    observe: Callable[[SimulatedArm], None] | None = None,
) -> SimulatedArm:
    arm = SimulatedArm(Scene(BOARD, PART), seed, noise=noise, gate=gate, observe=observe)
    arm.setTcp([0, 0, TIP, 0, 0, 0])
    return arm


def pose(x: float, y: float, z: float, yaw: float = 0.0) -> list[float]:
    return frames.ur_pose((x, y, z), frames.tool_down(yaw))


def distance(arm: SimulatedArm, target: list[float]) -> tuple[float, float]:
    """How far [m], [rad] the arm is from a pose."""
    position, rotation = frames.ros_pose(target)
    here, now = arm.pose
    return math.dist(here, position), math.hypot(
        *frames.vector_of_rotation(frames.product(rotation, frames.transpose(now)))
    )


def wait(arm: SimulatedArm, seconds: float) -> None:
    for _ in range(round(seconds / CYCLE)):
        arm.waitPeriod(arm.initPeriod())


def holding(noise: ForceTorqueNoise | None = None, gate: Callable[[int], bool] | None = None) -> SimulatedArm:
    """An arm that has a part over solid board, just above it."""
    arm = make(noise=noise, gate=gate)
    cell = arm.scene.workcell
    arm.scene.present_part(True)
    arm.moveL(pose(cell.feeder_x, cell.feeder_y, cell.feeder_z))
    arm.setToolDigitalOut(0, True)
    assert arm.holding
    arm.setPayload(GRIPPER.mass + PART.mass, GRIPPER.centre_of_mass)
    arm.moveL(pose(0.30, 0.0, 0.10))
    arm.moveL(pose(0.30 + 1e-3, 0.001, 0.0503), 0.05)
    wait(arm, 0.2)
    arm.zeroFtSensor()
    return arm


def test_it_is_an_arm() -> None:
    arm: Arm = make()
    assert arm.getRobotMode() == 7
    assert arm.getSafetyMode() == NORMAL
    assert arm.getSpeedScaling() == 1.0


def test_move_l_arrives_in_a_straight_line() -> None:
    path: list[frames.Vector] = []
    arm = make(observe=lambda arm: path.append(arm.pose[0]))
    arm.moveL(pose(*ABOVE))
    path.clear()
    target = pose(0.33, -0.05, 0.08, 0.6)
    assert arm.moveL(target, 0.1, 0.5)
    wait(arm, 0.1)
    off, turned = distance(arm, target)
    assert off < 5e-6
    assert turned < 1e-4
    start, end = np.array(ABOVE), np.array([0.33, -0.05, 0.08])
    along = (end - start) / np.linalg.norm(end - start)
    points = np.array(path) - start
    across = points - np.outer(points @ along, along)
    assert np.abs(across).max() < 0.1e-3
    speeds = np.linalg.norm(np.diff(path, axis=0), axis=1) / CYCLE
    assert speeds.max() < 0.1 * 1.03


def test_move_j_arrives_with_all_joints_together() -> None:
    arm = make()
    start = np.array(arm.getActualQ())
    target = start + np.array([0.3, -0.2, 0.1, 0.2, -0.3, 0.5])
    assert arm.moveJ(target, 1.0, 2.0, asynchronous=True)
    wait(arm, 0.3)
    share = (np.array(arm.getTargetQ()) - start) / (target - start)
    assert 0.05 < share[0] < 0.95
    assert np.ptp(share) < 1e-9
    wait(arm, 1.0)
    assert np.abs(np.array(arm.getActualQ()) - target).max() < 1e-4
    assert arm.isSteady()


def test_speed_l_goes_on_until_it_is_stopped() -> None:
    arm = make()
    arm.moveL(pose(*ABOVE))
    assert arm.speedL([0.02, 0.0, -0.01, 0, 0, 0], 0.5)
    wait(arm, 1.0)
    speed = arm.getActualTCPSpeed()
    assert speed[:3] == pytest.approx([0.02, 0, -0.01], abs=2e-4)
    assert speed[3:] == pytest.approx([0, 0, 0], abs=1e-3)
    assert not arm.isSteady()
    assert arm.speedStop(1.0)
    here = arm.pose[0]
    assert here[0] - ABOVE[0] == pytest.approx(-0.02, abs=1e-3)  # UR's base has x the other way
    assert here[2] - ABOVE[2] == pytest.approx(-0.01, abs=1e-3)
    wait(arm, 0.2)
    assert math.dist(arm.pose[0], here) < 0.1e-3
    assert arm.isSteady()


def test_servo_l_follows() -> None:
    arm = make()
    arm.moveL(pose(*ABOVE))
    for index in range(1000):
        cycle = arm.initPeriod()
        target = pose(ABOVE[0] + 0.01 * math.sin(index * CYCLE * math.pi), ABOVE[1], ABOVE[2])
        arm.servoL(target, 0, 0, CYCLE, 0.03, 300)
        arm.waitPeriod(cycle)
        if index > 100:
            assert distance(arm, target)[0] < 1.5e-3
    for _ in range(300):
        arm.servoL(pose(*ABOVE), 0, 0, CYCLE, 0.03, 300)
        arm.waitPeriod(arm.initPeriod())
    assert distance(arm, pose(*ABOVE))[0] < 5e-6
    assert arm.servoStop()
    assert arm.isSteady()


@pytest.mark.parametrize("force", [3.0, 5.0, 10.0, 20.0])
def test_force_mode_presses_as_asked(force: float) -> None:
    arm = holding(ForceTorqueNoise())
    down = [0.0, 0.0, -force, 0.0, 0.0, 0.0]
    felt = []
    arm.forceMode([0.0] * 6, [0, 0, 1, 0, 0, 0], down, 2, [0.01, 0.01, 0.01, 0.1, 0.1, 0.1])
    for _ in range(750):
        arm.waitPeriod(arm.initPeriod())
        felt.append(arm.getActualTCPForce()[2])
    assert np.mean(felt[-250:]) == pytest.approx(force, abs=0.5)
    assert arm.forceModeStop()
    assert arm.getSafetyMode() == NORMAL


def test_force_mode_yields_along_an_axis_while_a_line_is_followed() -> None:
    arm = holding()
    arm.forceMode([0.0] * 6, [0, 0, 1, 0, 0, 0], [0, 0, -5, 0, 0, 0], 2, [0.01] * 3 + [0.1] * 3)
    wait(arm, 0.5)
    target = pose(0.303, 0.004, 0.08)
    assert arm.moveL(target, 0.01)
    assert arm.getActualTCPForce()[2] == pytest.approx(5.0, abs=0.5)
    here = arm.pose[0]
    assert math.hypot(here[0] - 0.303, here[1] - 0.004) < 0.1e-3
    assert here[2] < 0.0505


def test_force_mode_of_an_unknown_type_is_refused() -> None:
    with pytest.raises(ArmError, match=r"type 4 is not known; known: 1"):
        make().forceMode([0] * 6, [0] * 6, [0] * 6, 4, [1] * 6)


def test_tool_contact_counts_back_to_the_touch() -> None:
    arm = holding()
    arm.speedL([0, 0, -0.005, 0, 0, 0])
    steps = 0
    while not arm.toolContact([0, 0, -1, 0, 0, 0]) and steps < 500:
        arm.waitPeriod(arm.initPeriod())
        steps += 1
    assert 0 < steps < 500
    assert arm.pose[0][2] < BOARD.z + 1e-5
    wait(arm, 0.06)
    arm.speedStop()
    wait(arm, 0.05)
    before = arm.toolContact([0, 0, -1, 0, 0, 0])
    assert before > 25
    wait(arm, 0.1)
    assert arm.toolContact([0, 0, -1, 0, 0, 0]) == before + 50
    assert arm.toolContact([0, 0, 0, 0, 0, 0]) > 0
    assert arm.toolContact([0, 0, 1, 0, 0, 0]) == 0
    assert arm.toolContact([1, 0, 0, 0, 0, 0]) == 0


def test_too_much_force_is_a_protective_stop() -> None:
    arm = holding()
    assert not arm.moveL(pose(0.301, 0.001, 0.045), 0.05)
    assert arm.getSafetyMode() == PROTECTIVE_STOP
    assert "exceeds 100 N" in arm.stop_reason
    assert not arm.moveL(pose(*ABOVE))
    assert not arm.unlockProtectiveStop()
    wait(arm, 5.0)
    assert arm.unlockProtectiveStop()
    assert arm.moveL(pose(0.301, 0.001, 0.06))


def test_zeroing_takes_away_what_is_measured() -> None:
    arm = make(noise=ForceTorqueNoise(white=(0.0, 0.0), drift=(0.0, 0.0)))
    wait(arm, 0.5)
    assert max(map(abs, arm.getActualTCPForce()[:3])) > 0.2
    arm.zeroFtSensor()
    wait(arm, 0.1)
    assert max(map(abs, arm.getActualTCPForce())) < 0.02
    assert arm.getFtRawWrench()[2] > 5.0  # the gripper's weight is still there in the raw wrench: tool z points down


def test_the_payload_is_compensated_in_every_orientation() -> None:
    arm = make()
    start = np.array(arm.getActualQ())
    for change in ([0, 0, 0, 0.8, 0.5, 1.0], [0, 0.2, -0.3, -1.0, -0.7, 2.0]):
        arm.moveJ(start + change)
        wait(arm, 0.5)
        assert max(map(abs, arm.getActualTCPForce()[:3])) < 0.02
    arm.setPayload(GRIPPER.mass - 0.1, GRIPPER.centre_of_mass)
    wait(arm, CYCLE)
    assert np.linalg.norm(arm.getActualTCPForce()[:3]) == pytest.approx(0.1 * GRAVITY, abs=0.02)
    assert arm.getActualTCPForce()[2] < 0  # the forgotten mass pulls down


def test_a_wrong_move_is_named() -> None:
    arm = make()
    with pytest.raises(ArmError, match=r"no straight way to TCP at \(700\.00"):
        arm.moveL(pose(0.7, 0, 0.1))
    with pytest.raises(ArmError, match=r"elbow_joint at 229\.2 deg"):
        arm.moveJ([0, -1, 4, 0, 0, 0])
    arm.speedL([-0.25, 0, 0, 0, 0, 0], 1.0)
    with pytest.raises(ArmError, match=r"singular|limits"):
        wait(arm, 5.0)
    assert arm.getActualTCPSpeed()[0] > -0.3
    wait(arm, 0.5)
    assert arm.isSteady()


def test_inverse_and_forward_kinematics_agree() -> None:
    arm = make()
    target = pose(0.28, 0.05, 0.12, 0.3)
    q = arm.getInverseKinematics(target)
    assert arm.getForwardKinematics(q)[:3] == pytest.approx(target[:3], abs=1e-9)
    assert arm.getForwardKinematics() == pytest.approx(arm.getActualTCPPose(), abs=1e-9)


class Interruption:
    """A gate that withholds permission between two times [s]."""

    def __init__(self, start: float, end: float) -> None:
        self.start, self.end = start, end

    def __call__(self, time: int) -> bool:
        return not self.start <= time * 1e-9 < self.end


@pytest.mark.parametrize("kind", ["moveL", "moveJ"])
def test_a_safeguard_stop_keeps_the_path_and_goes_on(kind: str) -> None:
    rows: list[tuple[int, int, float, frames.Vector, list[float]]] = []

    def observe(arm: SimulatedArm) -> None:
        rows.append((arm.time, arm.safety_mode, arm.getSpeedScaling(), arm.pose[0], arm.getTargetQd()))

    arm = make(gate=Interruption(0.5, 1.5), observe=observe)
    target = pose(0.30, 0.20, 0.12)
    start = np.array(arm.pose[0])
    if kind == "moveL":
        assert arm.moveL(target, 0.25)
    else:
        assert arm.moveJ(arm.getInverseKinematics(target), 0.6)
    wait(arm, 0.2)
    assert distance(arm, target)[0] < 2e-5
    times = np.array([row[0] for row in rows]) * 1e-9
    first = int(np.argmax([row[1] == SAFEGUARD_STOP for row in rows]))
    assert times[first] == pytest.approx(0.5 + CYCLE)  # reported at the end of the first cycle without permission
    speeds = np.array([np.abs(row[4]).max() for row in rows])
    assert speeds[first] < speeds[first - 1]  # braking begins in that cycle
    standing = int(np.argmax(speeds[first:] == 0.0)) + first
    assert times[standing] - 0.5 < 0.1
    during = (times > times[standing] + 0.1) & (times < 1.5)
    held = np.array([rows[i][3] for i in np.flatnonzero(during)])
    assert np.ptp(held, axis=0).max() < 5e-6
    assert np.abs(np.diff(speeds)).max() < 15.0 * CYCLE * 1.1  # no joint brakes or resumes harder than assumed
    if kind == "moveL":
        points = np.array([row[3] for row in rows]) - start
        way = np.array([0.30, 0.20, 0.12]) - start
        along = way / np.linalg.norm(way)
        assert np.linalg.norm(points - np.outer(points @ along, along), axis=1).max() < 0.3e-3


def test_at_peck_speed_a_safeguard_stop_takes_one_cycle() -> None:
    commanded: list[list[float]] = []
    gate = Interruption(1.5, 9.0)
    arm = make(gate=gate, observe=lambda arm: commanded.append(arm.getTargetQd()))
    arm.moveL(pose(*ABOVE))
    assert arm.time < 1.4e9
    arm.speedL([0, 0, -0.005, 0, 0, 0], 0.5)
    while arm.time < 1.5e9:
        arm.waitPeriod(arm.initPeriod())
    assert any(commanded[-1])
    height = arm.getTargetTCPPose()[2]
    wait(arm, 0.1)
    assert not any(commanded[-50])
    assert arm.getTargetTCPPose()[2] == height
    gate.end = 0.0
    wait(arm, 1.0)
    assert arm.getActualTCPSpeed()[2] == pytest.approx(-0.005, abs=1e-4)


def test_a_safeguard_stop_freezes_force_mode() -> None:
    gate = Interruption(math.inf, math.inf)
    arm = holding(gate=gate)
    arm.forceMode([0.0] * 6, [0, 0, 1, 0, 0, 0], [0, 0, -5, 0, 0, 0], 2, [0.01] * 3 + [0.1] * 3)
    wait(arm, 0.5)
    gate.start = arm.time * 1e-9
    wait(arm, CYCLE)
    q = arm.getTargetQ()
    wait(arm, 0.5)
    assert arm.getTargetQ() == q
    assert arm.getSafetyMode() == SAFEGUARD_STOP
    gate.start = math.inf
    wait(arm, 0.6)
    assert arm.getSpeedScaling() == 1.0
    assert arm.getActualTCPForce()[2] == pytest.approx(5.0, abs=0.3)


def test_the_same_seed_gives_the_same_bits() -> None:
    def record(seed: int) -> list[list[float]]:
        rows: list[list[float]] = []
        arm = make(
            seed, ForceTorqueNoise(), observe=lambda arm: rows.append([*arm.getActualQ(), *arm.getFtRawWrench()])
        )
        arm.moveL(pose(*ABOVE))
        arm.speedL([0, 0, -0.02, 0, 0, 0])
        wait(arm, 0.2)
        return rows

    first = record(5)
    assert record(5) == first
    assert record(6) != first


def test_the_sensors_noise_has_the_size_it_is_said_to_have() -> None:
    sensor = ForceTorqueSensor(3, ForceTorqueNoise(drift=(0.0, 0.0), bias=(0.0, 0.0), cutoff=1e4))
    samples = []
    for _ in range(10_000):
        sensor.update([0.0] * 6, frames.IDENTITY)
        samples.append(list(sensor.raw))
    deviation = np.std(samples, axis=0)
    assert deviation[:3] == pytest.approx([0.3] * 3, rel=0.05)
    assert deviation[3:] == pytest.approx([0.010] * 3, rel=0.05)
    one, next_one = np.array(samples[:-1])[:, 0], np.array(samples[1:])[:, 0]
    assert np.corrcoef(one, next_one)[0, 1] == pytest.approx(0.6, abs=0.05)
