"""Whole sessions with an arm on the network: ur-rtde, TCP, a simulated controller in a process of its own."""

from __future__ import annotations

import logging
import os
import re
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from cells import Palpate, cell_text, write_cell
from conftest import unused_port
from robots import Robot, loopback
from test_session import PATIENCE, attempts_of, check_complete, commanded_speeds, run_here, times_of

from drivers.ur3e.control_box.box import ControlBox
from drivers.ur3e.control_box.stage import READY, SEARCH
from drivers.ur3e.motion import Speed
from runtime import config, topics
from runtime.follower import Session
from runtime.in_process import run_in_process
from runtime.launcher import Order
from runtime.log.file import open_log
from runtime.messages import Attempt, Ending, Outcome, SearchGoal, nanoseconds_of

pytest.importorskip("rtde_control")

MS = 1_000_000
LOG = logging.getLogger(__name__)
BOARD = config.load("igbt").cell.board

# Transfers are no part of what these tests are about.
_HURRY = """
[drivers.ur_rtde.workcell]
transfer_speed = "600 mm/s"
acceleration = "3 m/s2"

[drivers.ur_rtde.skill]
gripper_time = "0.1 s"
"""
LUCKY = 8  # seed of a world in which the first two holes are found soon
HOLES = int(os.environ.get("PALPATE_WIRED_HOLES", "3"))  # of the board over the wire, in real time: 9 is a whole one


def wired_text(host: str, holes: int, *, hurry: bool = True, settings: str = "", **replacements: str) -> str:
    """A cell whose robot is at an address; the watchdog has patience with a machine that does other things too."""
    table = f'\n[drivers.ur_rtde]\naddress = "{host}"\nsimulated = true\nwatchdog = "2 Hz"\n{settings}'
    return cell_text(holes=holes, extra=table + _HURRY * hurry, robot='"ur_rtde"', **replacements)


def order(folder: Path, text: str, fresh: bool = False) -> Order:
    return Order(config.load(str(write_cell(folder, text))), folder / "logs", fresh=fresh)


@contextmanager
def running(order: Order) -> Iterator[Future[Session]]:
    """A session in this process, while a test does something to its robot."""
    with ThreadPoolExecutor(1) as pool:
        yield pool.submit(run_in_process, order)


def goals_of(path: Path) -> list[SearchGoal]:
    with open_log(path) as log:
        return [goal for _, goal in log.read(topics.SEARCH_GOAL)]


def alike(some: list[Attempt], others: list[Attempt]) -> float:
    """How far [m] candidates differ in attempts that are otherwise the same."""
    assert len(some) == len(others)
    for one, other in zip(some, others, strict=True):
        assert (one.search, one.number, one.hole) == (other.search, other.number, other.hole)
        assert one.outcome == other.outcome
    return max(max(abs(one.x - other.x), abs(one.y - other.y)) for one, other in zip(some, others, strict=True))


def last_log(folder: Path) -> Path:
    return max((folder / "logs").glob("*.mcap"), key=lambda path: path.stat().st_mtime)


# What the tests look at, and do, between two control cycles of the controller


def descending(box: ControlBox, search: int) -> bool:
    """Whether the arm is on its last millimetre above the board, in a search."""
    motion, (_, _, z) = box.arm.controller.motion, box.arm.pose[0]
    return box.registers.input_int[SEARCH] == search and isinstance(motion, Speed) and z < BOARD.z + 0.8e-3


def stop_descent(box: ControlBox, search: int) -> bool:
    found = descending(box, search)
    if found:
        box.arm.protective_stop("something was hit")
    return found


def reach_in(box: ControlBox, search: int) -> bool:
    found = descending(box, search)
    if found:
        box.open_safeguard(True)
    return found


def stands(box: ControlBox) -> bool:
    return not any(box.arm.controller.qd)


def answered(box: ControlBox) -> int:
    return box.registers.output_int[READY]


def at_full_speed(box: ControlBox) -> bool:
    return box.speed_slider == 1.0


def test_a_board_is_inserted_over_the_wire_as_it_is_in_one_process(tmp_path: Path) -> None:
    """The same seed and cell: the same attempts and outcomes, at positions that differ by what measuring them adds."""
    here = run_here(tmp_path / "here", cell_text(holes=HOLES))
    palpate = Palpate(tmp_path)
    with Robot("igbt", seed=1) as robot:
        done = palpate.launch(write_cell(tmp_path, wired_text(robot.host, HOLES, hurry=False)))
        beat = robot.beat
    assert done.returncode == 0, done.stderr
    assert f"{HOLES} of {HOLES} igbts inserted with meta search" in done.stdout
    assert not palpate.processes()
    (there,) = palpate.logs()
    check_complete(there)
    difference = alike(attempts_of(here), attempts_of(there))
    assert difference < 50e-6
    with open_log(here) as log, open_log(there) as wired:
        durations = [[result.duration for _, result in file.read(topics.SEARCH_RESULT)] for file in (log, wired)]
        traces = [trace for _, trace in wired.read(topics.TRACE)]
    assert durations[1] == pytest.approx(durations[0], rel=0.25)
    times = np.concatenate([times_of(trace) for trace in traces])
    assert (np.diff(times) > 0).all()
    share = len(times) / ((times[-1] - times[0]) / (2 * MS) + 1)
    assert share > 0.9
    LOG.info("%d attempts, candidates differ by at most %.1f um", len(attempts_of(there)), difference * 1e6)
    LOG.info("seconds per part: %.2f in process, %.2f over the wire", *(float(np.mean(each)) for each in durations))
    LOG.info("%.2f%% of the control cycles are in the trace; controller: %s", share * 100, beat)


def test_after_a_protective_stop_the_session_goes_on_and_so_does_the_next(tmp_path: Path) -> None:
    with Robot("igbt", seed=LUCKY) as robot:
        text = wired_text(robot.host, 2, seed=str(LUCKY))
        with running(order(tmp_path, text)) as session:
            robot.until(stop_descent, 1)
            results = session.result(PATIENCE).results
        assert [result.ending for result in results] == [Ending.ABORTED, Ending.INSERTED]
        first = last_log(tmp_path)
        check_complete(first)
        attempts = attempts_of(first)
        assert (attempts[0].outcome, attempts[0].reason) == (Outcome.ABORTED, "protective stop (safety mode 3)")
        assert [attempt.search for attempt in attempts[1:]] == [2] * (len(attempts) - 1)
        with open_log(first) as log:
            modes = [status.safety_mode for _, status in log.read(topics.ARM_STATUS)]
            said = [item.msg for _, item in log.read(topics.ROSOUT)]
        assert 3 in modes
        assert modes[-1] != 3
        assert "protective stop (safety mode 3): recovering" in said
        assert "safety mode protective stop: something was hit" in robot.lines
        assert robot.look(stands)
        assert robot.look(at_full_speed)
        again = run_in_process(order(tmp_path, wired_text(robot.host, 1, seed=str(LUCKY))))
        assert [(result.board, result.ending) for result in again.results] == [(2, Ending.INSERTED)]
        check_complete(again.log)


def test_a_cable_that_is_pulled_ends_the_session_and_the_next_one_knows_what_was_learnt(tmp_path: Path) -> None:
    palpate = Palpate(tmp_path)
    with Robot("igbt", seed=LUCKY) as robot:
        process = palpate.start(
            "launch", write_cell(tmp_path, wired_text(robot.host, 2, seed=str(LUCKY))), "--port", str(palpate.port)
        )
        robot.until(descending, 2)
        robot.kill()
        _, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == 1, err
    # ur-rtde's own thread, which reconnects for ever, now and then takes the arm's process down with it.
    lost = f"connection to {robot.host} lost; the arm halts by its watchdog"
    assert re.fullmatch(rf"palpate: arm: ({re.escape(lost)}|crashed \([^)]+\)( after: .+)?)", err.strip()), err
    assert not palpate.processes()
    (first,) = palpate.logs()
    check_complete(first)
    with open_log(first) as log:
        (result,) = [result for _, result in log.read(topics.SEARCH_RESULT)]
    assert (result.hole, result.ending) == ("1", Ending.INSERTED)
    with Robot("igbt", seed=LUCKY) as robot:
        done = palpate.launch(write_cell(tmp_path, wired_text(robot.host, 2, seed=str(LUCKY))))
    assert done.returncode == 0, done.stderr
    assert "2 of 2 igbts inserted" in done.stdout
    goals = goals_of(last_log(tmp_path))
    assert [(goal.board, len(goal.seats)) for goal in goals] == [(2, 1), (2, 2)]


def test_a_broken_beam_and_the_arms_own_safeguard_stop_it_and_the_same_attempt_goes_on(tmp_path: Path) -> None:
    calm = attempts_of(run_here(tmp_path / "calm", cell_text(holes=1)))
    script = 'interruptions = [{ at = "1 s", clear_after = "0.8 s", reset_after = "0.4 s" }]\n'
    with Robot("igbt", seed=1) as robot:
        text = wired_text(robot.host, 1).replace("[safety]\n", "[safety]\n" + script)
        with running(order(tmp_path, text)) as session:
            robot.until(reach_in, 1)
            robot.until(stands)
            robot.look(ControlBox.open_safeguard, False)
            stopped = session.result(PATIENCE)
        assert [result.ending for result in stopped.results] == [Ending.INSERTED]
        # The controller still holds its answer to search 1, and the board its part, when all of that is forgotten.
        assert robot.look(answered) == 1
        afresh = run_in_process(order(tmp_path, wired_text(robot.host, 1), fresh=True))
    log_path = stopped.log
    check_complete(log_path)
    assert [goal.search for goal in goals_of(afresh.log)] == [1]
    assert alike(attempts_of(log_path), attempts_of(afresh.log)) < 50e-6
    with open_log(log_path) as log:
        permits = [permit for _, permit in log.read(topics.PERMIT)]
        statuses = [(stamp, status.safety_mode) for stamp, status in log.read(topics.ARM_STATUS)]
        traces = [trace for _, trace in log.read(topics.TRACE)]
    broken = min(
        nanoseconds_of(permit.header.stamp)
        for permit in permits
        if not permit.granted and nanoseconds_of(permit.header.stamp) >= 1000 * MS
    )
    resumed = min(
        nanoseconds_of(permit.header.stamp)
        for permit in permits
        if permit.granted and nanoseconds_of(permit.header.stamp) > broken
    )
    assert resumed - broken == pytest.approx(1200 * MS, abs=60 * MS)
    speeds = commanded_speeds(traces)
    before = [speed for stamp, speed in speeds.items() if broken - 20 * MS < stamp <= broken]
    assert min(before) > 0.01
    standstill = min(stamp for stamp, speed in speeds.items() if stamp > broken and speed == 0.0)
    assert standstill - broken < 300 * MS
    assert max(speed for stamp, speed in speeds.items() if standstill <= stamp <= resumed) == 0.0
    LOG.info("beam to standstill: %.0f ms, from %.2f rad/s", (standstill - broken) / MS, max(before))
    stops = [mode for _, mode in statuses if mode in (1, 5)]
    changes = [mode for mode, last in zip(stops, [0, *stops], strict=False) if mode != last]
    assert changes[:2] == [5, 1]
    assert changes.count(5) >= 3  # before the first permit, for the beam, for the arm's own input
    again = attempts_of(log_path)
    assert [(one.number, one.outcome) for one in again] == [(one.number, one.outcome) for one in calm]
    assert again[0].duration > calm[0].duration * 0.5


def test_bad_input_is_told_in_one_line(tmp_path: Path) -> None:
    palpate = Palpate(tmp_path)
    nobody = loopback()

    def said(text: str) -> tuple[int, str]:
        palpate.port = unused_port()
        done = palpate.launch(write_cell(tmp_path, text))
        assert not palpate.processes()
        return done.returncode, done.stderr.strip()

    code, line = said(wired_text(nobody, 1))
    assert code == 1
    assert re.fullmatch(rf"palpate: arm: no connection to {re.escape(nobody)}: .*", line), line
    code, line = said(cell_text(holes=1, robot='"ur_rtde"'))
    assert code == 2
    assert re.fullmatch(r"palpate: small\.toml: drivers\.ur_rtde\.address: missing; .*", line), line
    code, line = said(wired_text("192.168.0.300", 1))
    assert code == 2
    assert re.fullmatch(r"palpate: small\.toml: drivers\.ur_rtde\.address: '192\.168\.0\.300' is neither .*", line)
    with Robot("empty") as robot:
        robot.look(ControlBox.press_emergency_stop, True)
        robot.until(is_off)
        code, line = said(wired_text(robot.host, 1, settings="power_on = true\n"))
        assert code == 1
        assert re.fullmatch(r"palpate: arm: .* not in normal mode \(.*EMERGENCY_STOP\): clear it .*", line), line
        robot.look(ControlBox.press_emergency_stop, False)
        code, line = said(wired_text(robot.host, 1))
        assert code == 1
        assert re.fullmatch(r"palpate: arm: .* is not ready to move \(.*POWER_OFF\): power the arm on .*", line), line


def is_off(box: ControlBox) -> bool:
    return box.robot_mode.name == "POWER_OFF"
