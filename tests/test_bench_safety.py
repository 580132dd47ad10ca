"""palpate bench safety and palpate curtain: beams that are broken while a cell runs, and what the arm does then."""

from __future__ import annotations

import json
import random
import signal
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from cells import Palpate, cell_text, write_cell
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.light_curtain.script import script_of
from runtime.benchmark.safe_distance import minimum_distance
from runtime.benchmark.safety import FULL_SPEED, REAL_TIME, Break, Trials, figures_of, planned
from runtime.benchmark.stops import Motion, Permits, Stop, motion_of
from runtime.bus import Envelope
from runtime.cell import CurtainFault, Interruption, Safety
from runtime.cli import main
from runtime.clock import Stopwatch
from runtime.errors import BusError, InputError
from runtime.log.file import open_log
from runtime.messages import ArmStatus, CurtainCommand, Permit, Reset, SafetyState, header
from runtime.network.zenoh_bus import ZenohBus
from runtime.safety.plugin import InterlockDesk
from runtime.topics import ARM_STATUS, LIGHT_FIELD, PERMIT

MS = 1_000_000
S = 1000 * MS
CYCLE = 2 * MS


@pytest.fixture
def palpate(tmp_path: Path) -> Palpate:
    return Palpate(tmp_path)


def test_every_broken_beam_stops_the_arm_at_both_rates(palpate: Palpate) -> None:
    cell = write_cell(palpate.folder, cell_text(holes=2))
    file = palpate.folder / "figures.json"
    done = palpate.run("bench", "safety", "--cell", cell, "--trials", "8", "--seed", "3", "--json", file)
    assert done.returncode == 0, done.stderr
    assert not palpate.processes()
    figures = json.loads(file.read_text())
    assert (figures["trials"], figures["stopped"]) == (11, 11), done.stdout
    assert (figures["full_speed_trials"], figures["real_time_trials"]) == (8, 3)
    assert figures["full_speed_moving"] + figures["real_time_moving"] > 0
    assert 0 <= figures["full_speed_command_worst_ms"] <= 2, "the cycle after the break is the first that slows down"
    assert figures["full_speed_command_worst_ms"] < figures["full_speed_standstill_worst_ms"]
    assert figures["safe_distance_mm"] >= 2 * figures["full_speed_standstill_worst_ms"]
    assert "does not replace the stopping time measured at the real machine" in " ".join(done.stdout.split())


class Onlooker:
    """Hears what interlock and arm say, and does what an operator does."""

    def __init__(self, bus: ZenohBus) -> None:
        self.bus = bus
        bus.subscribe(PERMIT, ARM_STATUS)

    def permit(self, wanted: Callable[[Permit], bool]) -> Permit:
        return self._first(lambda item: item.topic == PERMIT.name and wanted(item.read(PERMIT))).read(PERMIT)

    def status(self, wanted: Callable[[ArmStatus], bool]) -> ArmStatus:
        found = self._first(lambda item: item.topic == ARM_STATUS.name and wanted(item.read(ARM_STATUS)))
        return found.read(ARM_STATUS)

    def _first(self, wanted: Callable[[Envelope], bool]) -> Envelope:
        watch = Stopwatch()
        while watch.seconds < 60:
            item = self.bus.inbox.receive(1.0)
            if isinstance(item, Envelope) and wanted(item):
                return item
        raise AssertionError("never heard")


def joined(running: subprocess.Popen[str], port: int) -> ZenohBus:
    """A bus of the cell that is about to start."""
    while True:
        assert running.poll() is None, running.communicate()
        try:
            return ZenohBus("operator", port, patience=1.0)
        except BusError:
            continue


def ended(running: subprocess.Popen[str]) -> None:
    """As Ctrl-C ends it."""
    if running.poll() is None:
        running.send_signal(signal.SIGINT)
        running.communicate(timeout=60)


def test_an_operator_breaks_the_beam_of_a_running_cell(
    palpate: Palpate, capsys: pytest.CaptureFixture[str], request: pytest.FixtureRequest
) -> None:
    cell = write_cell(palpate.folder, cell_text(holes=2, boards="5"))
    running = palpate.start("launch", cell, "--rate", "1.0", "--port", str(palpate.port))
    request.addfinalizer(lambda: ended(running))

    def curtain(action: str) -> str:
        assert main(["curtain", action, "--port", str(palpate.port)]) == 0
        return capsys.readouterr().out

    with joined(running, palpate.port) as bus:
        onlooker = Onlooker(bus)
        onlooker.status(lambda status: status.safety_mode == 1 and status.activity == "pick")
        assert curtain("state").startswith("light field clear, outputs on and on")
        said = curtain("break")
        assert said.startswith("light field interrupted until 'palpate curtain clear', outputs off and off")
        stopped = onlooker.status(lambda status: status.safety_mode == 5)
        if stopped.speed_scaling > 0:
            onlooker.status(lambda status: status.speed_scaling == 0)
        assert curtain("reset").startswith("light field interrupted")
        assert onlooker.permit(lambda permit: permit.resets > 1).state == SafetyState.TRIPPED
        assert curtain("clear").startswith("light field clear, outputs on and on")
        assert onlooker.permit(lambda permit: permit.state != SafetyState.TRIPPED).state == SafetyState.LOCKED
        curtain("reset")
        going = onlooker.permit(lambda permit: permit.granted)
        onlooker.status(lambda status: status.safety_mode == 1)
        refused = bus.request(LIGHT_FIELD, CurtainCommand("brake"), 10.0)
        assert not refused.ok
        assert "did you mean 'break'? known: break, clear, reset, state" in refused.error
    ended(running)
    (path,) = palpate.logs()
    with open_log(path) as log:
        motion = motion_of(log)
        begin, end = (message.header.stamp.sec * S + message.header.stamp.nanosec for message in (stopped, going))
        stop = motion.stop(begin - CYCLE, end)
    assert stop is not None
    assert not stop.failure


def test_without_a_cell_there_is_no_curtain(palpate: Palpate, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["curtain", "break", "--port", str(palpate.port)]) == 1
    assert f"no light curtain answers on 127.0.0.1:{palpate.port}" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--trials", "0"], "--trials 0 is no number from 1 to"),
        (["--resolution", "80"], "a resolution of 80 mm is none of a light curtain"),
        (["--response", "-1"], "--response -1 is no number of ms"),
        (["--cell", "nosuch"], "no cell file 'nosuch'"),
        (["--rate", "2"], "invalid choice: '2'"),
    ],
)
def test_wrong_input_is_told_before_anything_is_measured(
    arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["bench", "safety", *arguments]) == 2
    assert said in capsys.readouterr().err


# The curtain, when nobody could have known


def test_a_break_that_no_script_foresaw_is_refused_under_the_same_moment() -> None:
    script, desk = script_of(Safety()), InterlockDesk.of(Safety())
    desk.hear(script.word(0, -1))
    permit = desk.hear(Reset(header(0), "operator"))
    assert permit is not None
    assert permit.granted
    for broken, granted in ((False, True), (True, False), (False, False)):
        permit = desk.hear(script.word(80 * MS, 80 * MS, broken=broken))
        assert permit is not None
        assert permit.granted is granted


@settings(deadline=None)
@given(st.integers(0, 5 * S), st.booleans())
def test_a_broken_field_switches_off_what_is_not_stuck(now: int, scripted: bool) -> None:
    fault = CurtainFault(at=1.0, kind="channel_1_stuck", ends_after=2.0)
    interruptions = (Interruption(at=2.0),) if scripted else ()
    word = script_of(Safety(curtain_faults=(fault,), interruptions=interruptions)).word(now, now, broken=True)
    assert word.channel_1 is (S <= now < 3 * S)
    assert not word.channel_2
    assert word.channel_2_off_time == 0, "off, and in no test pulse"


# Judging a stop


def moving(before: int, fall: int, after: int, lag: int = 0) -> Motion:
    """An arm at 1 rad/s for `before` cycles, that brakes in `fall` cycles and stands for `after`; it lags behind."""
    commanded = np.concatenate([np.ones(before), np.linspace(1, 0, fall + 1)[1:], np.zeros(after)])
    measured = np.concatenate([np.ones(lag), commanded])[: len(commanded)]
    return Motion(0, CYCLE, commanded, measured)


@settings(deadline=None)
@given(st.integers(1, 40), st.integers(1, 60), st.integers(0, 12), st.integers(0, CYCLE - 1), st.integers(0, 5))
def test_a_stop_is_measured_from_the_beam(before: int, fall: int, lag: int, early: int, late: int) -> None:
    """The beam breaks `early` ns before the cycle that brakes, or `late` cycles more."""
    late = min(late, before - 1)
    beam, reset = (before - late) * CYCLE - early, (before + fall + 20) * CYCLE
    stop = moving(before, fall, 25, lag).stop(beam, reset)
    assert stop is not None
    assert (stop.moving, stop.failure) == (True, "")
    assert stop.command == pytest.approx((late * CYCLE + early) / S)
    slow = fall - 1  # cycles of the fall whose speed is not zero: all but the last
    assert stop.standstill == pytest.approx((late * CYCLE + early + (slow + lag) * CYCLE) / S)


def test_an_arm_that_stood_still_has_stopped_at_once() -> None:
    motion = Motion(0, CYCLE, np.zeros(100), np.zeros(100))
    assert motion.stop(50 * CYCLE - 1, 90 * CYCLE) == Stop(False, 1e-9, 1e-9)


@pytest.mark.parametrize(
    ("motion", "reset", "failure"),
    [
        (moving(10, 20, 5), 25, "did not stand still before the reset"),
        (moving(10, 5, 20, lag=18), 30, "did not stand still before the reset"),
        (Motion(0, CYCLE, np.repeat([1.0, 0.0, 1.0, 0.0], 10), np.zeros(40)), 35, ""),
        (Motion(0, CYCLE, np.repeat([0.0, 1.0, 0.0], 12), np.zeros(36)), 30, "began to move after the beam"),
    ],
    ids=["commanded", "measured", "moves in between", "starts"],
)
def test_what_is_no_stop_is_told(motion: Motion, reset: int, failure: str) -> None:
    stop = motion.stop(10 * CYCLE, reset * CYCLE)
    assert stop is not None
    if failure:
        assert failure in stop.failure
    else:
        assert stop.command >= 20 * CYCLE / S, "motion in between counts: the command came after it"


def test_what_the_log_does_not_reach_is_not_judged() -> None:
    motion = moving(10, 5, 20)
    assert motion.stop(10 * CYCLE, 36 * CYCLE) is None
    assert motion.stop(-1, 30 * CYCLE) is None


def test_a_grant_before_the_reset_is_no_refusal() -> None:
    permits = Permits((0, 10, 20, 30), (True, False, False, True))
    assert permits.refused(5, 30)
    assert not permits.refused(5, 31)
    assert not permits.refused(0, 30)
    assert not permits.refused(21, 30), "nothing was said"


# Moments, figures, distance


def test_moments_are_drawn_in_order_and_can_be_scripted() -> None:
    breaks = planned(200, random.Random(1))
    moments = [moment for one in breaks for moment in (one.at, one.clear, one.reset)]
    assert moments == sorted(set(moments))
    assert breaks == planned(200, random.Random(1))
    assert Break(1_500_000_000, 1_600_000_000, 1_900_000_001).scripted == {
        "at": "1.500000000 s",
        "clear_after": "0.100000000 s",
        "reset_after": "0.300000001 s",
    }


def test_figures_without_a_prefix_are_those_of_real_time() -> None:
    fast = Trials(FULL_SPEED, [Stop(True, 0.001, 0.1), Stop(False), Stop(True, failure="went on")])
    slow = Trials(REAL_TIME, [Stop(True, 0.004, 0.12)])
    figures = figures_of([fast, slow], 14e-3, 15e-3)
    assert (figures["trials"], figures["stopped"]) == (4, 3)
    assert (figures["full_speed_trials"], figures["full_speed_stopped"], figures["full_speed_moving"]) == (3, 2, 1)
    assert figures["command_p99_ms"] == figures["real_time_command_p99_ms"] == pytest.approx(4)
    assert figures["full_speed_command_p99_ms"] == pytest.approx(1)
    assert figures["stop_time_ms"] == pytest.approx(135)
    assert figures["safe_distance_mm"] == pytest.approx(270)
    assert figures_of([fast], 14e-3, 0.0)["command_worst_ms"] == pytest.approx(1)


@pytest.mark.parametrize(
    ("stop_time", "resolution", "distance"),
    [
        (0.1, 14e-3, 0.2),
        (0.01, 14e-3, 0.1),  # never nearer than 100 mm
        (0.1, 30e-3, 0.328),
        (0.1, 10e-3, 0.2),  # a finer curtain brings nothing more
        (0.25, 14e-3, 0.5),
        (0.26, 14e-3, 0.5),  # beyond 500 mm a person walks, but no nearer than that
        (0.5, 14e-3, 0.8),
        (0.1, 60e-3, 1.01),
    ],
)
def test_distances_are_those_of_iso_13855(stop_time: float, resolution: float, distance: float) -> None:
    assert minimum_distance(stop_time, resolution) == pytest.approx(distance)


@pytest.mark.parametrize("resolution", [0.0, -1e-3, 0.071])
def test_a_resolution_beyond_the_standard_is_refused(resolution: float) -> None:
    with pytest.raises(InputError):
        minimum_distance(0.1, resolution)
