"""palpate bench bus and palpate bench log, as a user runs them."""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import subprocess
from pathlib import Path

import pytest
from cells import Palpate
from log_samples import messages, record

from runtime.benchmark.figures import percentile, ratio, shares
from runtime.cli import main


@pytest.fixture
def palpate(tmp_path: Path) -> Palpate:
    return Palpate(tmp_path)


def figures_of(palpate: Palpate, *arguments: str | Path) -> tuple[str, dict[str, float]]:
    file = palpate.folder / "figures.json"
    done = palpate.run("bench", *arguments, "--json", file)
    assert done.returncode == 0, done.stderr
    assert not palpate.processes()
    return done.stdout, json.loads(file.read_text())


def test_the_bus_is_measured_beside_raw_zenoh(palpate: Palpate) -> None:
    said, figures = figures_of(palpate, "bus", "--messages", "600", "--contenders", "palpate,raw")
    assert "raw Zenoh, callback" in said
    assert "pyzmq" not in said
    assert {"rtt_ratio", "flood_delivered_per_s", "flood_cpu_s_per_10000"} <= set(figures)
    assert figures["flood_lost"] == figures["raw_flood_lost"] == figures["rtt_lost"] == 0
    assert 0 < figures["rtt_p50_us"] <= figures["rtt_p99_us"]
    assert 0 < figures["raw_rtt_p50_us"] <= figures["raw_rtt_p99_us"]


def test_the_log_is_measured_beside_the_mcap_writer(palpate: Palpate) -> None:
    log = palpate.folder / "sample.mcap"
    sent = record(log, messages(("1",)))
    names = "recorder,recorder_inbox,log_writer,raw_mcap"
    said, figures = figures_of(palpate, "log", "--messages", "500", "--contenders", names, "--log", log)
    assert "palpate recorder, from Zenoh" in said
    assert figures["recorder_lost"] == figures["recorder_inbox_lost"] == figures["log_writer_lost"] == 0
    assert figures["recorder_msgs_per_s"] > 0
    assert figures["raw_mcap_msgs_per_s"] > 0
    assert figures["read_msgs_per_s"] > 0
    assert figures["log_writer_bytes_per_message"] > 20
    assert figures["view_messages"] == sent
    assert 0 < figures["view_index_s"] <= figures["view_open_s"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["bus", "--contenders", "carrier-pigeon"], "'carrier-pigeon' is no contender of bench bus"),
        (["log", "--contenders", "rawmcap"], "did you mean 'raw_mcap'?"),
        (["bus", "--messages", "3"], "--messages 3 is no number from 100"),
        (["log", "--log", "nowhere.mcap"], "there is no log nowhere.mcap"),
    ],
)
def test_wrong_input_is_explained_before_anything_is_measured(
    capsys: pytest.CaptureFixture[str], arguments: list[str], said: str
) -> None:
    assert main(["bench", *arguments]) == 2
    shown = capsys.readouterr()
    assert said in shown.err
    assert not shown.out


def test_an_interrupted_measurement_leaves_no_process(palpate: Palpate) -> None:
    process = palpate.start("bench", "bus", "--messages", "2000000", "--contenders", "palpate,raw_channel")
    while len(palpate.processes()) < 6:  # the command, those that start others, the router, and the first ends
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(0.1)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert errors == "palpate: interrupted\n"
    for pid in palpate.processes():  # what starts the others ends by itself once the command has
        with contextlib.suppress(ProcessLookupError):
            assert select.select([os.pidfd_open(pid)], [], [], 10.0)[0]


def test_percentiles_ratios_and_shares() -> None:
    assert percentile([4.0, 1.0, 3.0, 2.0], 0.5) == 3.0
    assert percentile([1.0], 0.99) == 1.0
    assert ratio([2.0, 9.0, 4.0], [1.0, 3.0, 4.0]) == 2.0
    assert shares(10, 4) == [2, 3, 2, 3]
    assert shares(2, 4) == [1, 1, 1, 1]
