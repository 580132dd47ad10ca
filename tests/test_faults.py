"""The matrix of faults, in part: cells that are struck as `palpate bench faults` does it; and what it would find."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cells import Palpate

from runtime.benchmark.faults import all_faults, chosen
from runtime.benchmark.promises import STOP_LIMIT, stops_of
from runtime.benchmark.small_cell import small, toml
from runtime.cli import main
from runtime.messages import ControlTrace, Permit, SafetyState, header, stamp_of
from runtime.network.zenoh_bus import ZenohBus, ZenohRouter

MS = 1_000_000
CYCLE = 2 * MS


@pytest.fixture
def palpate(tmp_path: Path) -> Palpate:
    return Palpate(tmp_path)


STRUCK = ("kill -9 recorder", "crash arm", "full disk posterior", "shared store and kill -9")


def test_a_cell_keeps_its_promises(palpate: Palpate) -> None:
    done = palpate.run("bench", "faults", "--only", ",".join(STRUCK), "--json", "figures.json")
    assert (done.returncode, done.stderr) == (0, ""), done.stdout
    told = {line.split("  ")[0]: line for line in done.stdout.splitlines()}
    for fault, outcome in zip(
        STRUCK, ("recorder: was killed", "arm: ", "posterior: ", "posterior: was killed"), strict=True
    ):
        assert outcome in told[fault], done.stdout
    figures = json.loads((palpate.folder / "figures.json").read_text())
    assert figures["faults_tried"] == figures["faults_passed"] == len(STRUCK)
    assert figures["evidence_lost"] == figures["logs_unreadable"] == figures["processes_left"] == 0
    assert figures["worst_stop_ms"] <= 1e3 * STOP_LIMIT
    assert not palpate.processes()


def test_a_router_does_not_forget_who_was_gone(free_port: int) -> None:
    with ZenohRouter(free_port) as router:
        for _ in range(2):
            with ZenohBus("strategy", free_port) as bus:
                bus.announce()
                assert router.wait_for({"strategy"}, 20.0) == set()
            while not router.lost_touch({"strategy", "arm"}, 0.0):
                assert router.wait_for({"arm"}, 0.01) == {"arm"}
        assert router.lost_touch({"strategy", "arm"}, 0.0) == {"strategy"}
        assert router.lost_touch({"strategy", "arm"}, 1000.0) == set()


def test_every_plugin_is_in_the_matrix(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "faults", "--list"]) == 0
    listed = capsys.readouterr().out
    for role in ("arm", "light_curtain", "interlock", "strategy", "posterior", "assembly", "recorder", "viewer"):
        for what in ("kill -9", "SIGSTOP", "slow", "crash"):
            assert f"\n{what} {role} " in f"\n{listed}"
    names = [fault.name for fault in all_faults()]
    assert len(set(names)) == len(names)
    assert [fault.name for fault in chosen("crash *, NaN")] == [
        name for name in names if name.startswith("crash ") or name == "NaN"
    ]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--only", "foo"], "no fault is called 'foo'"),
        (["--tries", "0"], "--tries 0 is no number from 1 to 1000"),
        (["--cell", "foo"], "no cell file 'foo'"),
    ],
)
def test_what_cannot_be_measured_is_told(arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "faults", *arguments]) == 2
    assert said in capsys.readouterr().err


def moved(speeds: list[float]) -> list[tuple[float, Any]]:
    """The trace of one joint that was told to move at these speeds [rad/s], cycle by cycle from the second on."""
    targets = np.zeros((len(speeds) + 1, 6))
    targets[1:, 0] = np.cumsum(speeds) * CYCLE / 1e9
    return [(1.0, ControlTrace(header(CYCLE), CYCLE / 1e9, targets.ravel(), targets.ravel(), targets.ravel()))]


def granted(since: int, until: int, at: float = 0.0) -> tuple[float, Any]:
    """A permit that held between two session times [ns] and was heard at a machine time [s]."""
    return at, Permit(header(since), True, SafetyState.PERMITTED, "", stamp_of(until))


BRAKING = [1.0] * 50 + [1.0 - step / 10 for step in range(1, 11)] + [0.0] * 50  # the permit ends with cycle 50


def test_an_arm_that_brakes_once_its_permit_ends_has_stopped_in_time() -> None:
    ends = 51 * CYCLE
    stop, broken = stops_of(moved(BRAKING), [granted(0, ends)])
    assert (stop, broken) == (pytest.approx(9 * 2e-3), [])


def test_an_arm_that_goes_on_without_a_permit_is_found_out() -> None:
    assert stops_of(moved([1.0] * 200), [granted(0, 51 * CYCLE)])[1] == [
        "the arm moved for 300 ms without a permit from 0.102 s on"
    ]
    [told] = stops_of(moved([1.0] * 200), [granted(0, 51 * CYCLE), granted(51 * CYCLE, 201 * CYCLE, at=2.0)])[1]
    assert told.startswith("the arm moved for 300 ms")  # by a permit that came when all was over
    assert stops_of(moved([1.0] * 200), [granted(0, 51 * CYCLE), granted(51 * CYCLE, 201 * CYCLE)]) == (None, [])


def test_an_arm_that_begins_to_move_without_a_permit_is_found_out() -> None:
    speeds = [0.0] * 60 + [0.1] * 5 + [0.0] * 60
    assert stops_of(moved(speeds), [granted(0, 51 * CYCLE)])[1] == [
        "the arm began to move without a permit after 0.102 s"
    ]


def test_a_small_cell_is_a_cell() -> None:
    document = small("igbt", 2, {"strategy": "bayes-slide"})
    assert [hole["name"] for hole in document["board"]["holes"]] == ["1", "2"]
    assert tomllib.loads(toml(document)) == document
