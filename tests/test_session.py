"""Whole sessions, end to end: real processes, real Zenoh, real physics, real files."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
from cells import Palpate, cell_text, write_cell
from numpy.typing import NDArray

from runtime import config, topics
from runtime.bus import Envelope
from runtime.errors import BusError
from runtime.in_process import run_in_process
from runtime.launcher import Order
from runtime.log.file import open_log
from runtime.messages import Attempt, ControlTrace, Ending, Outcome, SafetyState, nanoseconds_of
from runtime.network.zenoh_bus import ZenohBus

PATIENCE = 60.0
# What nobody says in a session in which no sensor, button, other cell or person is asked for
ON_OCCASION = (topics.MUTING, topics.EMERGENCY_STOP, topics.MERGED, topics.INTERVENTION, topics.ANSWER_GIVEN)
MS = 1_000_000


@pytest.fixture
def palpate(tmp_path: Path) -> Palpate:
    return Palpate(tmp_path)


def attempts_of(path: Path) -> list[Attempt]:
    with open_log(path) as log:
        return [attempt for _, attempt in log.read(topics.ATTEMPT)]


def decisions_of(path: Path) -> list[tuple[object, ...]]:
    """Everything that was decided and felt, with session times."""
    found: list[tuple[object, ...]] = []
    with open_log(path) as log:
        for stamp, item in log.read(topics.CANDIDATE):
            found.append((stamp, item.search, item.number, item.proposal.x, item.proposal.y))
        for stamp, felt in log.read(topics.ATTEMPT):
            found.append((stamp, felt.search, felt.outcome, felt.depth, felt.peak_force))
        for stamp, result in log.read(topics.SEARCH_RESULT):
            found.append((stamp, result.search, result.ending, result.duration))
    return found


def times_of(trace: ControlTrace) -> NDArray[np.int64]:
    """Session times [ns] of the cycles of a trace."""
    first = nanoseconds_of(trace.header.stamp)
    return first + round(trace.period * 1e9) * np.arange(len(trace.position) // 6)


def commanded_speeds(traces: list[ControlTrace]) -> dict[int, float]:
    """How fast the quickest joint was told to move [rad/s] in the cycle that ended at a session time [ns]."""
    targets = np.concatenate([trace.target.reshape(-1, 6) for trace in traces])
    times = np.concatenate([times_of(trace) for trace in traces])
    speeds = np.abs(np.diff(targets, axis=0)).max(axis=1) / traces[0].period
    return dict(zip(times[1:].tolist(), speeds.tolist(), strict=True))


def run_here(folder: Path, text: str, **overrides: object) -> Path:
    """Run a cell in this process; returns its log."""
    folder.mkdir(exist_ok=True)
    cell_file = config.load(str(write_cell(folder, text)), overrides)
    return run_in_process(Order(cell_file, folder / "logs")).log


def wait_for_attempt(palpate: Palpate, process: subprocess.Popen[str]) -> None:
    """Listen in on the cell until the arm has tried something."""
    bus = None
    while bus is None:
        assert process.poll() is None, process.communicate()
        try:
            bus = ZenohBus("listener", palpate.port, patience=1.0)
        except BusError:
            continue
    with bus:
        bus.subscribe(topics.ATTEMPT)
        while True:
            item = bus.inbox.receive(1.0)
            if isinstance(item, Envelope):
                return
            assert process.poll() is None, process.communicate()


def wait_until_nothing_is_left(palpate: Palpate) -> None:
    deadline = time.monotonic() + PATIENCE
    while palpate.processes():
        assert time.monotonic() < deadline, palpate.processes()


def check_complete(path: Path) -> None:
    with open_log(path) as log:
        assert log.complete
        assert log.metadata["palpate.recording"]["lost"] == "0"
        assert int(log.metadata["palpate.recording"]["messages"]) == sum(topic.count for topic in log.topics)


def test_a_session_is_run_recorded_and_remembered(palpate: Palpate) -> None:
    cell = write_cell(palpate.folder, cell_text(holes=2))
    first = palpate.launch(cell)
    assert first.returncode == 0, first.stderr
    assert re.search(r"^1 +1 +\d+ +[\d.]+ s +inserted$", first.stdout, re.M), first.stdout
    assert "2 of 2 igbts inserted with meta search" in first.stdout
    assert "\x1b" not in first.stdout
    (log_path,) = palpate.logs()
    check_complete(log_path)
    with open_log(log_path) as log:
        assert cell.read_bytes() in log.attachments.values()
        assert any(name.endswith(".urdf") for name in log.attachments)
        assert log.metadata["palpate.session"]["seed"] == "1"
        assert "mujoco" in log.metadata["palpate.versions"]
        assert set(topics.topics()) - {topic.name for topic in log.topics} == {topic.name for topic in ON_OCCASION}
        first_goal = next(iter(log.read(topics.SEARCH_GOAL)))[1]
        assert (first_goal.seats, first_goal.prior.x, first_goal.prior.y) == ([], 0.0, 0.0)
        results = [result for _, result in log.read(topics.SEARCH_RESULT)]
        assert [result.ending for result in results] == [Ending.INSERTED, Ending.INSERTED]
    assert not palpate.processes()

    second = palpate.launch(cell)
    assert second.returncode == 0, second.stderr
    assert re.search(r"^2 +1 ", second.stdout, re.M), second.stdout
    with open_log(palpate.logs()[1]) as log:
        goals = [goal for _, goal in log.read(topics.SEARCH_GOAL)]
    assert [len(goal.seats) for goal in goals] == [2, 3]
    assert (goals[0].prior.x, goals[0].prior.y) != (0.0, 0.0)

    fresh = palpate.launch(cell, "--fresh", "--rerun", "save")
    assert fresh.returncode == 0, fresh.stderr
    assert palpate.logs()[2].with_suffix(".rrd").stat().st_size > 50_000
    assert decisions_of(palpate.logs()[2]) == decisions_of(log_path)


@pytest.mark.parametrize("component", ["igbt", "capacitor"])
def test_the_same_seed_gives_the_same_decisions_in_one_process_or_in_many(palpate: Palpate, component: str) -> None:
    text = cell_text(component, holes=1, strategy='"spiral"')
    here = run_here(palpate.folder / "here", text)
    there = palpate.launch(write_cell(palpate.folder, text))
    assert there.returncode == 0, there.stderr
    check_complete(here)
    assert decisions_of(here) == decisions_of(palpate.logs()[0])


def test_another_seed_is_another_world(tmp_path: Path) -> None:
    text = cell_text(holes=1)
    assert decisions_of(run_here(tmp_path / "a", text)) != decisions_of(run_here(tmp_path / "b", text, seed=2))


def test_a_strategy_sees_the_world_through_attempts_alone(tmp_path: Path) -> None:
    """Worlds that feel the same so far get the same candidates, however different they are."""
    runs = [
        run_here(tmp_path / name, cell_text(holes=1, hole_bias=f'"{bias} mm"', strategy='"hybrid"'))
        for name, bias in (("near", 0.3), ("far", 0.8))
    ]
    with open_log(runs[0]) as near, open_log(runs[1]) as far:
        truths = [next(iter(log.read(topics.TRUTH)))[1] for log in (near, far)]
    assert (truths[0].offset_x, truths[0].offset_y) != (truths[1].offset_x, truths[1].offset_y)
    same = [(a, b) for a, b in zip(*map(attempts_of, runs), strict=False) if a.outcome == b.outcome]
    assert len(same) > 3
    assert all((a.x, a.y) == (b.x, b.y) for a, b in same)


def test_a_search_that_finds_nothing_is_reported_and_the_cell_goes_on(palpate: Palpate) -> None:
    cell = write_cell(palpate.folder, cell_text(holes=2, max_attempts="2", hole_bias='"3 mm"', strategy='"linear"'))
    done = palpate.launch(cell)
    assert done.returncode == 0, done.stderr
    assert len(re.findall(r"exhausted: the budget of 2 attempts is spent", done.stdout)) == 2, done.stdout
    assert "0 of 2 igbts inserted" in done.stdout
    with open_log(palpate.logs()[0]) as log:
        assert [result.attempts for _, result in log.read(topics.SEARCH_RESULT)] == [2, 2]
        said = [item.msg for _, item in log.read(topics.ROSOUT) if item.name == "assembly"]
    assert len(said) == 2


@pytest.mark.parametrize("before_the_end", [1.5, 0.25], ids=["on the way", "in the descent"])
def test_a_broken_beam_stops_the_arm_in_that_cycle_and_the_attempt_goes_on(
    tmp_path: Path, before_the_end: float
) -> None:
    calm = run_here(tmp_path / "calm", cell_text(holes=1))
    tried = attempts_of(calm)[0]
    during = nanoseconds_of(tried.header.stamp) / 1e9 - before_the_end  # in the first attempt
    script = f'interruptions = [{{ at = "{during} s", clear_after = "1.5 s", reset_after = "0.5 s" }}]\n'
    text = cell_text(holes=1).replace("[safety]\n", "[safety]\n" + script)
    stopped = run_here(tmp_path / "stopped", text)
    broken, cleared = round(during * 1e9), round((during + 1.5) * 1e9)
    reset = round((during + 2.0) * 1e9)
    with open_log(stopped) as log:
        permits = [permit for _, permit in log.read(topics.PERMIT)]
        statuses = [(stamp, status) for stamp, status in log.read(topics.ARM_STATUS)]
        traces = [trace for _, trace in log.read(topics.TRACE)]
    refused = [permit for permit in permits if not permit.granted and nanoseconds_of(permit.header.stamp) > 0]
    assert nanoseconds_of(refused[0].header.stamp) == broken
    before = [permit for permit in permits if permit.granted and nanoseconds_of(permit.header.stamp) < broken]
    assert all(nanoseconds_of(permit.valid_until) <= broken for permit in before)
    assert {SafetyState(permit.state) for permit in refused} == {SafetyState.TRIPPED, SafetyState.LOCKED}
    assert all(
        permit.state == SafetyState.LOCKED for permit in refused if nanoseconds_of(permit.header.stamp) >= cleared
    )
    safeguard = [stamp for stamp, status in statuses if status.safety_mode == 5]
    assert broken <= safeguard[0] <= broken + 2 * MS
    resumed = [stamp for stamp, status in statuses if status.safety_mode == 1 and stamp > broken]
    assert reset <= resumed[0] <= reset + 2 * MS
    assert np.concatenate([times_of(trace) for trace in traces]).tolist() == list(
        range(2 * MS, 2 * MS * (1 + sum(len(times_of(trace)) for trace in traces)), 2 * MS)
    )
    speeds = commanded_speeds(traces)
    assert 0 <= speeds[broken + 2 * MS] < speeds[broken]
    held = [speed for stamp, speed in speeds.items() if broken + 100 * MS < stamp <= reset]
    assert len(held) == 950
    assert max(held) == 0.0
    again = attempts_of(stopped)
    assert again[0].number == 1
    assert (again[0].x, again[0].y, again[0].outcome) == (tried.x, tried.y, tried.outcome)
    assert again[0].outcome != Outcome.ABORTED
    later = (nanoseconds_of(again[0].header.stamp) - nanoseconds_of(tried.header.stamp)) / 1e9
    assert later == pytest.approx(2.0, abs=0.4)
    check_complete(stopped)


def test_ctrl_c_ends_a_session_in_good_order(palpate: Palpate) -> None:
    process = palpate.start("launch", "igbt", "--rate", "5", "--port", str(palpate.port))
    wait_for_attempt(palpate, process)
    assert len(palpate.processes()) == 8
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == 130, err
    assert err.strip() == "palpate: interrupted"
    assert "0 lost" in out
    assert not palpate.processes()
    check_complete(palpate.logs()[0])
    with open_log(palpate.logs()[0]) as log:
        last = [status for _, status in log.read(topics.ARM_STATUS)][-1]
        assert (last.activity, last.speed_scaling) == ("halted", 0.0)


def test_ctrl_c_while_starting_leaves_nothing_behind(palpate: Palpate) -> None:
    process = palpate.start("launch", "igbt", "--port", str(palpate.port))
    while len(palpate.processes()) < 3:
        assert process.poll() is None
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=PATIENCE)
    assert (process.returncode, err.strip()) == (130, "palpate: interrupted")
    wait_until_nothing_is_left(palpate)


@pytest.mark.parametrize("role", ["strategy", "interlock"])
def test_a_plugin_that_dies_ends_the_session_with_one_line(palpate: Palpate, role: str) -> None:
    process = palpate.start("launch", "igbt", "--rate", "5", "--port", str(palpate.port))
    wait_for_attempt(palpate, process)
    victims = [pid for pid, text in palpate.processes().items() if role in plugin_role(pid)]
    assert len(victims) == 1
    os.kill(victims[0], signal.SIGKILL)
    _, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == 1
    assert err.startswith(f"palpate: {role}: ")
    assert err.count("\n") == 1
    wait_until_nothing_is_left(palpate)
    with open_log(palpate.logs()[0]) as log:
        assert log.complete


def plugin_role(pid: int) -> str:
    return Path(f"/proc/{pid}/cmdline").read_bytes().decode().split("\0")[-2]


def test_the_plugins_end_when_the_launcher_is_killed(palpate: Palpate) -> None:
    process = palpate.start("launch", "igbt", "--rate", "5", "--port", str(palpate.port))
    wait_for_attempt(palpate, process)
    process.kill()
    process.communicate(timeout=PATIENCE)
    wait_until_nothing_is_left(palpate)
    with open_log(palpate.logs()[0]) as log:
        assert log.complete
        assert any(True for _ in log.read(topics.ATTEMPT))


def test_a_second_cell_is_refused_and_the_first_goes_on(palpate: Palpate) -> None:
    first = palpate.start("launch", "igbt", "--rate", "5", "--port", str(palpate.port))
    wait_for_attempt(palpate, first)
    second = palpate.launch("igbt", "--logs", "elsewhere")
    assert second.returncode == 2
    assert second.stderr.count("\n") == 1
    assert f"port {palpate.port}" in second.stderr
    assert "another cell" in second.stderr
    assert first.poll() is None
    first.send_signal(signal.SIGINT)
    first.communicate(timeout=PATIENCE)
    check_complete(palpate.logs()[0])
    assert not palpate.processes()


def test_a_session_in_one_process_is_stopped_and_told_like_any_other(palpate: Palpate) -> None:
    cell = write_cell(palpate.folder, cell_text(holes=1))
    done = palpate.run("launch", cell, "--in-process")
    assert done.returncode == 0, done.stderr
    assert "1 of 1 igbts inserted" in done.stdout
    check_complete(palpate.logs()[0])
    process = palpate.start("launch", "igbt", "--rate", "1.0", "--in-process")
    while len(palpate.logs()) < 2 or palpate.logs()[1].stat().st_size < 50_000:
        assert process.poll() is None
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=PATIENCE)
    assert (process.returncode, err.strip()) == (130, "palpate: interrupted")
    check_complete(palpate.logs()[1])
