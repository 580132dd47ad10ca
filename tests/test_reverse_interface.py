"""A program that calls its client back is led over three sockets: what it does to the arm; see `reverse_client`."""

from __future__ import annotations

import os
import re
import struct
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path

import pytest
from reverse_client import (
    CANCELLED,
    DONE,
    END,
    FEEL,
    FORCE,
    FREE,
    HOME,
    MICRO,
    MOVE_C,
    MOVE_J,
    MOVE_L,
    MOVE_P,
    NO_FORCE,
    OPTIMOVE_J,
    OPTIMOVE_L,
    PAYLOAD,
    PROGRAM,
    SERVO,
    SHOW,
    SPEED_J,
    SPEED_L,
    SPLINE,
    STARVED,
    STAY,
    TCP,
    ZERO,
    Client,
    filled_in,
)
from robots import Robot

from drivers.ur3e.control_box.box import ControlBox

EXTERNAL = os.environ.get("PALPATE_EXTERNAL_CONTROL", "")


def push(box: ControlBox, wrench: list[float]) -> None:
    """A hand's wrench (6,) on the gripper, in base_link."""
    box.arm.scene.push(wrench)


def angles(box: ControlBox) -> list[float]:
    return box.arm.getTargetQ()


def speeds(box: ControlBox) -> list[float]:
    return box.arm.getTargetQd()


def pose(box: ControlBox) -> list[float]:
    """Of the TCP, in UR's base."""
    return box.arm.getTargetTCPPose()


def twist(box: ControlBox) -> list[float]:
    return box.arm.getTargetTCPSpeed()


def is_at(box: ControlBox, q: list[float]) -> bool:
    return max(abs(a - b) for a, b in zip(angles(box), q, strict=True)) < 1e-3


def rises(box: ControlBox, speed: float) -> bool:
    return abs(twist(box)[2] - speed) < 1e-3


def turns(box: ControlBox, joint: int, speed: float) -> bool:
    return abs(speeds(box)[joint] - speed) < 1e-3


def stands(box: ControlBox) -> bool:
    return box.arm.controller.idle and not any(speeds(box))


def rests(box: ControlBox, playing: bool) -> bool:
    return stands(box) and (box.runtime_state.name == "PLAYING") is playing


def displaced(box: ControlBox, axis: int, start: float, least: float) -> bool:
    return abs(pose(box)[axis] - start) > least


def belief(box: ControlBox) -> tuple[object, ...]:
    """What the program has told the arm: mass, its centre, TCP."""
    return box.arm.payload[0], list(box.arm.payload[1]), list(box.arm.tcp_offset)


def believes(box: ControlBox, *wanted: object) -> bool:
    return belief(box) == wanted


def complies(box: ControlBox, wanted: bool) -> bool:
    return (box.arm.controller.compliance is not None) is wanted


def feels(box: ControlBox, least: float) -> bool:
    return box.arm.getActualTCPForce()[2] > least


def now(box: ControlBox) -> float:
    return box.time


def shown(box: ControlBox) -> tuple[str, str, str, bool] | None:
    popup = box.popup
    return None if popup is None else (popup.title, popup.text, popup.kind, popup.blocking)


def said(box: ControlBox, text: str) -> bool:
    return any(text in line for line in box.programs.spoken)


def moved(base: Sequence[float], *changes: float) -> list[float]:
    """The first values of a list changed."""
    return [a + b for a, b in zip(base, [*changes, *([0.0] * (len(base) - len(changes)))], strict=True)]


@pytest.fixture(scope="module")
def robot() -> Iterator[Robot]:
    with Robot("empty") as running:
        yield running


@pytest.fixture
def client(robot: Robot) -> Iterator[Client]:
    led = Client(robot, PROGRAM)
    yield led
    led.close()


def test_a_stream_of_joint_angles_is_followed_and_carried_on_where_one_is_missing(client: Client) -> None:
    goal = list(HOME)
    for _ in range(100):
        goal[0] += 0.002
        client.order(SERVO, goal)
        client.robot.look(now)
    client.robot.until(is_at, goal)
    client.order(STAY)
    client.robot.until(rests, True)


def test_speeds_of_joints_and_of_the_tool_last_until_the_next_task(client: Client) -> None:
    client.order(SPEED_J, [0, 0, 0, 0, 0, 0.4])
    client.robot.until(turns, 5, 0.4)
    client.order(SPEED_L, [0, 0, 0.05, 0, 0, 0])
    client.robot.until(rises, 0.05)
    x, y, *_ = client.robot.look(twist)
    assert (x, y) == (pytest.approx(0.0, abs=1e-4),) * 2
    client.order(STAY)
    client.robot.until(rests, True)
    client.order(END)
    client.robot.until(said, "led to the end")


def test_a_path_runs_through_moves_of_every_kind(client: Client) -> None:
    start = client.robot.look(pose)
    far = moved(HOME, 0.2, 0, 0, 0, 0, 0.3)
    up, side = moved(start, 0, 0, 0.05), moved(start, 0.03, 0.03)
    via = moved(start, 0.03 * (1 - 0.5**0.5), 0.03 * 0.5**0.5)
    for kind, target, *rest in (
        (OPTIMOVE_J, far, 0.5, 0.5, 0.0),
        (MOVE_J, HOME, 10.0, 3.0, 0.0),
        (MOVE_L, up, 5.0, 0.5, 0.0),
        (MOVE_P, start, 5.0, 0.5, 0.0),
        (MOVE_C, [*side, *via], 5.0, 0.5, 0.0),
        (OPTIMOVE_L, start, 0.8, 0.8, 0.0),
    ):
        client.order(STAY)
        client.run_path((kind, target, *rest))
        assert client.answer(client.path) == DONE
        of_joints = kind in (MOVE_J, OPTIMOVE_J)
        size = 6 if of_joints else 3  # the same rotation has two vectors
        reached = client.robot.look(angles if of_joints else pose)
        assert reached[:size] == pytest.approx(target[:size], abs=1e-4), f"kind {kind}"


@pytest.mark.parametrize("share", [1.0, 0.5])
def test_a_spline_of_joint_speeds_arrives_whatever_the_speed_slider_says(client: Client, share: float) -> None:
    robot = client.robot
    robot.look(ControlBox.set_speed_slider, share)
    robot.until(scaled, share)
    middle, end = moved(HOME, 0.1, -0.05), moved(HOME, 0.2, -0.1, 0.1)
    begun = robot.look(now)
    client.run_path(
        (SPLINE, [*middle, 0.3, -0.15, 0.15, 0, 0, 0], 0, 0, 0.4),
        (SPLINE, [*end, 0, 0, 0, 0, 0, 0], 0, 0, 0.4),
    )
    assert client.answer(client.path) == DONE
    assert robot.look(angles) == pytest.approx(end, abs=2e-3)
    assert robot.look(now) - begun == pytest.approx(0.8 / share, abs=0.1)


def scaled(box: ControlBox, share: float) -> bool:
    """Whether the arm has taken up the speed slider's share."""
    return box.arm.controller.scaling == share


def test_a_path_is_cancelled_in_the_middle_of_a_critical_section_and_leaves_nothing_behind(client: Client) -> None:
    slow = moved(HOME, 1.0)
    client.run_path((MOVE_J, slow, 1.0, 0.3, 0.0), (MOVE_J, HOME, 1.0, 0.3, 0.0), (MOVE_J, slow, 1.0, 0.3, 0.0))
    client.robot.until(turns, 0, 0.3)
    client.order(STAY)
    assert client.answer(client.path) == CANCELLED
    client.robot.until(rests, True)
    assert not client.robot.look(is_at, slow)
    client.run_path((MOVE_J, HOME, 10.0, 3.0, 0.0))
    assert client.answer(client.path) == DONE
    assert client.robot.look(is_at, HOME)


def test_a_path_that_lacks_a_point_fails_after_its_timeout(client: Client) -> None:
    begun = client.robot.look(now)
    client.run_path((MOVE_J, HOME, 10.0, 3.0, 0.0), promised=2)
    assert client.answer(client.path) == STARVED
    assert 0.29 < client.robot.look(now) - begun < 1.0
    assert client.robot.look(rests, True)


def test_what_is_set_reaches_the_arm(client: Client) -> None:
    client.set(TCP, 0.0, 0.0, 0.1, 0.0, 0.0, 0.25)
    client.set(PAYLOAD, 1.5, 0.01, 0.0, 0.05)
    client.robot.until(believes, 1.5, [0.01, 0.0, 0.05], [0.0, 0.0, 0.1, 0.0, 0.0, 0.25])
    client.robot.until(feels, 5.0)  # a mass that is not there seems to be pulled up
    client.set(ZERO)
    client.set(SHOW, 1.0, 2.0)
    title, text, kind, blocking = client.robot.until(shown)
    assert (title, kind, blocking) == ("Settings", "warning", False)
    assert re.fullmatch(r"value \[1(\.0)?, 2(\.0)?, 0(\.0)?, .*\]", text)
    assert not client.robot.look(feels, 2.0)


def test_force_mode_yields_along_its_axis_only(client: Client) -> None:
    robot = client.robot
    client.set(ZERO)
    client.set(FORCE, *(0, 0, 1, 0, 0, 0), *[0.0] * 6, *[0.1] * 6)
    robot.until(complies, True)
    x, y, z, *_ = robot.look(pose)
    robot.look(push, [10.0, 10.0, 10.0, 0, 0, 0])
    robot.until(displaced, 2, z, 5e-3)
    assert robot.look(pose)[:2] == pytest.approx([x, y], abs=1e-3)
    client.set(NO_FORCE)
    robot.until(complies, False)


def test_freedrive_goes_where_the_hand_goes_until_another_task_comes(client: Client) -> None:
    robot = client.robot
    client.order(FREE)
    robot.until(complies, True)
    x = robot.look(pose)[0]
    robot.look(push, [25.0, 0, 0, 0, 0, 0])
    robot.until(displaced, 0, x, 0.02)
    client.order(STAY)
    robot.until(complies, False)
    robot.until(rests, True)


def test_the_tool_stops_at_a_contact_and_goes_back_to_where_it_began(client: Client) -> None:
    robot = client.robot
    client.set(ZERO)
    client.set(FEEL)
    client.order(SPEED_L, [0, 0, -0.05, 0, 0, 0])
    robot.until(rises, -0.05)
    robot.look(push, [0, 0, 30.0, 0, 0, 0])
    touched = robot.look(pose)[2]
    client.settings.setblocking(False)
    steps = 0
    while not steps:
        client.order(SPEED_L, [0, 0, -0.05, 0, 0, 0])
        robot.look(now)
        with suppress(BlockingIOError):
            steps = client.answer(client.settings)
    assert 0 < steps < 100
    assert abs(robot.look(pose)[2] - touched) < 3e-3


def test_a_client_that_floods_the_program_does_not_hold_it_up(client: Client) -> None:
    flood = struct.pack(">8i", STAY, 0, *[0] * 6) * 5000
    client.orders.sendall(flood)
    client.order(SPEED_J, [0, 0, 0, 0, 0, 0.4])
    client.robot.until(turns, 5, 0.4)


@pytest.mark.parametrize("silent", [True, False], ids=["silence", "hung up"])
def test_losing_the_client_stops_the_arm_and_ends_the_program(client: Client, silent: bool) -> None:
    client.order(SPEED_J, [0.2, 0, 0, 0, 0, 0], patience=400 if silent else 0)
    client.robot.until(turns, 0, 0.2)
    if not silent:
        client.close()
    client.robot.until(rests, False)
    assert client.robot.look(said, "no orders any more in task 2")
    if silent:
        assert client.orders.recv(1) == b""


@pytest.mark.skipif(
    not EXTERNAL, reason="PALPATE_EXTERNAL_CONTROL does not name UR's external_control.urscript (of its client library)"
)
def test_urs_own_program_waits_for_commands_and_follows_joint_angles(robot: Robot) -> None:
    client = Client(robot, filled_in(Path(EXTERNAL).read_text(encoding="utf-8"), (5, 22, 0)))
    robot.until(said, "External control active")
    servo, stop, goal = 1, -2, list(HOME)
    for _ in range(50):
        goal[5] += 0.004
        client.orders.sendall(struct.pack(">8i", 500, *(round(q * MICRO) for q in goal), servo))
        robot.look(now)
    robot.until(is_at, goal)
    client.orders.sendall(struct.pack(">8i", 500, *[0] * 6, stop))
    robot.until(rests, False)
    client.close()
