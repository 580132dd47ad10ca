"""A program that calls its client back is led over three sockets: what it does to the arm; see `reverse_client`."""

from __future__ import annotations

import os
import re
import struct
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
import reverse_client as led
from reverse_client import Client, filled_in
from robots import Robot

from drivers.ur3e.control_box.box import ControlBox

EXTERNAL = os.environ.get("PALPATE_EXTERNAL_CONTROL", "")


@pytest.fixture(scope="module")
def robot() -> Iterator[Robot]:
    with Robot("empty") as running:
        yield running


@pytest.fixture
def client(robot: Robot) -> Iterator[Client]:
    leader = Client(robot, led.PROGRAM)
    yield leader
    leader.close()


def test_a_stream_of_joint_angles_is_followed_and_carried_on_where_one_is_missing(client: Client) -> None:
    goal = list(led.HOME)
    for _ in range(100):
        goal[0] += 0.002
        client.order(led.SERVO, goal)
        client.robot.look(led.now)
    client.robot.until(led.is_at, goal)
    client.order(led.STAY)
    client.robot.until(led.rests, True)


def test_speeds_of_joints_and_of_the_tool_last_until_the_next_task(client: Client) -> None:
    client.order(led.SPEED_J, [0, 0, 0, 0, 0, 0.4])
    client.robot.until(led.turns, 5, 0.4)
    client.order(led.SPEED_L, [0, 0, 0.05, 0, 0, 0])
    client.robot.until(led.rises, 0.05)
    x, y, *_ = client.robot.look(led.twist)
    assert [x, y] == pytest.approx([0.0, 0.0], abs=1e-4)
    client.order(led.STAY)
    client.robot.until(led.rests, True)
    client.order(led.END)
    client.robot.until(led.said, "led to the end")


def test_a_path_runs_through_moves_of_every_kind(client: Client) -> None:
    start = client.robot.look(led.pose)
    far = led.moved(led.HOME, 0.2, 0, 0, 0, 0, 0.3)
    up, side = led.moved(start, 0, 0, 0.05), led.moved(start, 0.03, 0.03)
    via = led.moved(start, 0.03 * (1 - 0.5**0.5), 0.03 * 0.5**0.5)
    for kind, target, a, v in (
        (led.OPTIMOVE_J, far, 0.5, 0.5),
        (led.MOVE_J, led.HOME, 10.0, 3.0),
        (led.MOVE_L, up, 5.0, 0.5),
        (led.MOVE_P, start, 5.0, 0.5),
        (led.MOVE_C, [*side, *via], 5.0, 0.5),
        (led.OPTIMOVE_L, start, 0.8, 0.8),
    ):
        client.order(led.STAY)
        client.run_path((kind, target, a, v, 0.0))
        assert client.answer(client.path) == led.DONE
        of_joints = kind in (led.MOVE_J, led.OPTIMOVE_J)
        size = 6 if of_joints else 3  # the same rotation has two vectors
        reached = client.robot.look(led.angles if of_joints else led.pose)
        assert reached[:size] == pytest.approx(target[:size], abs=1e-4), f"kind {kind}"


@pytest.mark.parametrize("share", [1.0, 0.5])
def test_a_spline_of_joint_speeds_arrives_whatever_the_speed_slider_says(client: Client, share: float) -> None:
    robot = client.robot
    robot.look(ControlBox.set_speed_slider, share)
    robot.until(scaled, share)
    middle, end = led.moved(led.HOME, 0.1, -0.05), led.moved(led.HOME, 0.2, -0.1, 0.1)
    begun = robot.look(led.now)
    client.run_path(
        (led.SPLINE, [*middle, 0.3, -0.15, 0.15, 0, 0, 0], 0, 0, 0.4),
        (led.SPLINE, [*end, 0, 0, 0, 0, 0, 0], 0, 0, 0.4),
    )
    assert client.answer(client.path) == led.DONE
    assert robot.look(led.angles) == pytest.approx(end, abs=2e-3)
    assert robot.look(led.now) - begun == pytest.approx(0.8 / share, abs=0.1)


def scaled(box: ControlBox, share: float) -> bool:
    """Whether the arm has taken up the speed slider's share."""
    return box.arm.controller.scaling == share


def test_a_path_is_cancelled_in_the_middle_of_a_critical_section_and_leaves_nothing_behind(client: Client) -> None:
    slow = led.moved(led.HOME, 1.0)
    client.run_path(
        (led.MOVE_J, slow, 1.0, 0.3, 0.0),
        (led.MOVE_J, led.HOME, 1.0, 0.3, 0.0),
        (led.MOVE_J, slow, 1.0, 0.3, 0.0),
    )
    client.robot.until(led.turns, 0, 0.3)
    client.order(led.STAY)
    assert client.answer(client.path) == led.CANCELLED
    client.robot.until(led.rests, True)
    assert not client.robot.look(led.is_at, slow)
    client.run_path((led.MOVE_J, led.HOME, 10.0, 3.0, 0.0))
    assert client.answer(client.path) == led.DONE
    assert client.robot.look(led.is_at, led.HOME)


def test_a_path_that_lacks_a_point_fails_after_its_timeout(client: Client) -> None:
    begun = client.robot.look(led.now)
    client.run_path((led.MOVE_J, led.HOME, 10.0, 3.0, 0.0), promised=2)
    assert client.answer(client.path) == led.STARVED
    assert 0.29 < client.robot.look(led.now) - begun < 1.0
    assert client.robot.look(led.rests, True)


def test_what_is_set_reaches_the_arm(client: Client) -> None:
    client.set(led.TCP, 0.0, 0.0, 0.1, 0.0, 0.0, 0.25)
    client.set(led.PAYLOAD, 1.5, 0.01, 0.0, 0.05)
    client.robot.until(led.believes, 1.5, [0.01, 0.0, 0.05], [0.0, 0.0, 0.1, 0.0, 0.0, 0.25])
    client.robot.until(led.feels, 5.0)  # a mass that is not there seems to be pulled up
    client.set(led.ZERO)
    client.set(led.SHOW, 1.0, 2.0)
    window = client.robot.until(led.shown)
    assert window is not None
    title, text, kind, blocking = window
    assert (title, kind, blocking) == ("Settings", "warning", False)
    assert re.fullmatch(r"value \[1(\.0)?, 2(\.0)?, 0(\.0)?, .*\]", text)
    assert not client.robot.look(led.feels, 2.0)


def test_force_mode_yields_along_its_axis_only(client: Client) -> None:
    robot = client.robot
    client.set(led.ZERO)
    client.set(led.FORCE, *(0, 0, 1, 0, 0, 0), *[0.0] * 6, *[0.1] * 6)
    robot.until(led.complies, True)
    x, y, z, *_ = robot.look(led.pose)
    robot.look(led.push, [10.0, 10.0, 10.0, 0, 0, 0])
    robot.until(led.displaced, 2, z, 5e-3)
    assert robot.look(led.pose)[:2] == pytest.approx([x, y], abs=1e-3)
    client.set(led.NO_FORCE)
    robot.until(led.complies, False)


def test_freedrive_goes_where_the_hand_goes_until_another_task_comes(client: Client) -> None:
    robot = client.robot
    client.order(led.FREE)
    robot.until(led.complies, True)
    x = robot.look(led.pose)[0]
    robot.look(led.push, [25.0, 0, 0, 0, 0, 0])
    robot.until(led.displaced, 0, x, 0.02)
    client.order(led.STAY)
    robot.until(led.complies, False)
    robot.until(led.rests, True)


def test_the_tool_stops_at_a_contact_and_goes_back_to_where_it_began(client: Client) -> None:
    robot = client.robot
    client.set(led.ZERO)
    client.set(led.FEEL)
    client.order(led.SPEED_L, [0, 0, -0.05, 0, 0, 0])
    robot.until(led.rises, -0.05)
    robot.look(led.push, [0, 0, 30.0, 0, 0, 0])
    touched = robot.look(led.pose)[2]
    client.settings.setblocking(False)
    steps = 0
    while not steps:
        client.order(led.SPEED_L, [0, 0, -0.05, 0, 0, 0])
        robot.look(led.now)
        with suppress(BlockingIOError):
            steps = client.answer(client.settings)
    assert 0 < steps < 100
    assert abs(robot.look(led.pose)[2] - touched) < 3e-3


def test_a_client_that_floods_the_program_does_not_hold_it_up(client: Client) -> None:
    flood = struct.pack(">8i", led.STAY, 0, *[0] * 6) * 5000
    client.orders.sendall(flood)
    client.order(led.SPEED_J, [0, 0, 0, 0, 0, 0.4])
    client.robot.until(led.turns, 5, 0.4)


@pytest.mark.parametrize("silent", [True, False], ids=["silence", "hung up"])
def test_losing_the_client_stops_the_arm_and_ends_the_program(client: Client, silent: bool) -> None:
    client.order(led.SPEED_J, [0.2, 0, 0, 0, 0, 0], patience=400 if silent else 0)
    client.robot.until(led.turns, 0, 0.2)
    if not silent:
        client.close()
    client.robot.until(led.rests, False)
    assert client.robot.look(led.said, "no orders any more in task 2")
    if silent:
        assert client.orders.recv(1) == b""


@pytest.mark.skipif(
    not EXTERNAL, reason="PALPATE_EXTERNAL_CONTROL does not name UR's external_control.urscript (of its client library)"
)
def test_urs_own_program_waits_for_commands_and_follows_joint_angles(robot: Robot) -> None:
    client = Client(robot, filled_in(Path(EXTERNAL).read_text(encoding="utf-8"), (5, 22, 0)))
    robot.until(led.said, "External control active")
    servo, stop, goal = 1, -2, list(led.HOME)
    for _ in range(50):
        goal[5] += 0.004
        client.orders.sendall(struct.pack(">8i", 500, *(round(q * led.MICRO) for q in goal), servo))
        robot.look(led.now)
    robot.until(led.is_at, goal)
    client.orders.sendall(struct.pack(">8i", 500, *[0] * 6, stop))
    robot.until(led.rests, False)
    client.close()
