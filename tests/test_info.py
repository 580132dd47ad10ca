"""palpate info: what a log says of itself, of any program and in any state."""

from __future__ import annotations

import ast
import json
import os
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any

import log_samples
import pytest
from command_line import CommandLine
from mcap.writer import IndexType, Writer

from runtime import messages as m
from runtime.bus import Envelope, encode
from runtime.declaration import type_name
from runtime.log.file import open_log
from runtime.log.info import info_of
from runtime.log.sizes import payload_bytes
from runtime.log.writer import LogWriter
from runtime.registry import DRIVERS, STRATEGIES

SESSION = {
    "session": "20260101-120000",
    "cell": "sample.toml",
    "robot": "mujoco_ur3e",
    "strategy": "meta",
    "component": "igbt",
    "board_type": "sample-4",
    "boards": "1",
    "seed": "7",
    "rate": "max",
    "settings": json.dumps(log_samples.DOCUMENT),
}
SAID = m.Log(m.stamp_of(5), 20, "strategy", "hello", "", "", 0)
METADATA = {"palpate.session": SESSION, "palpate.versions": {"palpate": "0.1.0", "mcap": "1.6.0"}}


@pytest.fixture
def palpate(tmp_path: Path) -> CommandLine:
    return CommandLine(tmp_path)


@pytest.fixture(scope="module")
def sample(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("log") / "sample.mcap"
    log_samples.record(path, metadata=METADATA)
    return path


def test_a_session_is_told(palpate: CommandLine, sample: Path) -> None:
    done = palpate.run("info", sample)
    assert (done.returncode, done.stderr) == (0, "")
    told = done.stdout
    for expected in ("complete", "2026-01-01 12:00:00", "sample.toml: 1 x sample-4, igbt", "mujoco_ur3e", "mcap 1.6.0"):
        assert expected in told
    rows = [line.split() for line in told.splitlines()]
    assert ["1", "2", "5", "3.9", "s", "inserted"] in rows
    assert "2 of 2 parts inserted with 10 attempts" in told
    assert "stopped once, 0.5 s in all" in told
    assert "warning of interlock: the light field is interrupted" in told


def test_programs_get_the_same_as_one_json_object(palpate: CommandLine, sample: Path) -> None:
    done = palpate.run("info", sample, "--json")
    told = json.loads(done.stdout)
    assert (told["complete"], told["seed"], told["strategy"], told["lost"]) == (True, 7, "meta", 0)
    assert told["size_bytes"] == sample.stat().st_size
    assert [(row["hole"], row["outcome"], row["attempts"]) for row in told["searches"]] == [
        ("1", "inserted", 5),
        ("2", "inserted", 5),
    ]
    [stop] = told["stops"]
    assert (stop["kind"], stop["reason"]) == ("safeguard stop", "the light field is interrupted")
    assert stop["duration_s"] == pytest.approx(0.5)
    assert [row["text"] for row in told["warnings"]] == ["the light field is interrupted"]
    with open_log(sample) as log:
        counted = {topic.name: topic.count for topic in log.topics}
        sizes = dict.fromkeys(counted, 0)
        for envelope in log.messages():
            sizes[envelope.topic] += len(envelope.payload)
        seconds = (log.end - log.start) / 1e9
    assert {row["name"]: (row["count"], row["bytes"], row["lost"]) for row in told["topics"]} == {
        name: (count, sizes[name], 0) for name, count in counted.items()
    }
    [joints] = [row for row in told["topics"] if row["name"] == "/joint_states"]
    assert joints["rate_hz"] == pytest.approx(counted["/joint_states"] / seconds)


def test_a_log_that_is_cut_short_is_told_as_far_as_it_goes(palpate: CommandLine, sample: Path) -> None:
    whole = sample.read_bytes()
    cut = palpate.folder / "cut.mcap"
    for share in (0.5, 0.6, 0.7, 0.8, 0.9):  # where a search ends in the file depends on how often it was flushed
        cut.write_bytes(whole[: int(share * len(whole))])
        told = json.loads(palpate.run("info", cut, "--json").stdout)
        if told["searches"]:
            break
    assert not told["complete"]
    assert told["lost"] is None
    assert [row["hole"] for row in told["searches"]] == ["1"]
    assert 0 < told["messages"] < json.loads(palpate.run("info", sample, "--json").stdout)["messages"]
    assert {row["lost"] for row in told["topics"]} == {None}
    shown = palpate.run("info", cut).stdout
    assert "not complete" in shown.splitlines()[0]
    assert "cut.mcap is cut short" in shown.splitlines()[-1]


def test_losses_stand_beside_their_topics(tmp_path: Path) -> None:
    path = tmp_path / "lossy.mcap"
    with LogWriter(path) as log:
        log.write(Envelope("/rosout", "rcl_interfaces/msg/Log", encode(SAID), 5, 3, bytes(16)))
        lost, unsigned = {"/rosout": 2, "/clock": 4}, ["/rosout"]
        log.add_metadata(
            "palpate.recording",
            {"lost": "6", "lost_topics": json.dumps(lost), "unsigned_topics": json.dumps(unsigned)},
        )
    with open_log(path) as read:
        info = info_of(read)
    assert info.lost == 6
    told = {topic.name: (topic.type, topic.count, topic.lost, topic.end_known) for topic in info.topics}
    assert told["/clock"] == ("rosgraph_msgs/msg/Clock", 0, 4, True)  # nothing of it ever arrived
    assert told["/rosout"] == ("rcl_interfaces/msg/Log", 1, 2, False)
    shown = CommandLine(tmp_path).run("info", path).stdout
    assert "2 or more" in shown
    assert "ended without a last word: /rosout" in shown


@pytest.mark.parametrize("settings", [{}, {"use_chunking": False}, {"index_types": IndexType.NONE}])
def test_a_log_of_another_program_shows_what_it_can(palpate: CommandLine, settings: dict[str, Any]) -> None:
    path = palpate.folder / "foreign.mcap"
    start = 1_800_000_000 * 10**9
    with path.open("wb") as file:
        writer = Writer(file, **settings)
        writer.start("ros2")
        schema = writer.register_schema("acme_msgs/msg/Range", "ros2msg", b"float64 metres\n")
        ranges = writer.register_channel("/range", "cdr", schema)
        schema = writer.register_schema("Result", "jsonschema", b"{}")
        other = writer.register_channel("/search/result", "json", schema)
        for number in range(10):
            writer.add_message(ranges, start + number * 10**8, bytes(12), start, number)
        writer.add_message(other, start, b"{}", start)
        writer.finish()
    done = palpate.run("info", path)
    assert (done.returncode, done.stderr) == (0, "")
    assert "acme_msgs/Range" in done.stdout
    told = json.loads(palpate.run("info", path, "--json").stdout)
    assert told["recorded"].startswith("2027-01-15")
    assert (told["session"], told["searches"], told["lost"]) == ("", [], None)
    [row] = [row for row in told["topics"] if row["name"] == "/range"]
    assert (row["count"], row["bytes"]) == (10, 120)
    assert row["rate_hz"] == pytest.approx(10 / 0.9)
    assert "/search/result carries Result in this log" in " ".join(told["notes"])


def test_metadata_that_says_little_is_no_reason_to_fail(palpate: CommandLine) -> None:
    path = palpate.folder / "bare.mcap"
    with LogWriter(path) as log:
        log.write(Envelope("/rosout", "rcl_interfaces/msg/Log", encode(SAID), 5, 3, bytes(16)))
        log.add_metadata("palpate.session", {"session": "yesterday", "settings": "{"})
        log.add_metadata("palpate.recording", {"lost": "some"})
    for done in (palpate.run("info", path), palpate.run("info", path, "--json")):
        assert (done.returncode, done.stderr) == (0, "")
    told = json.loads(done.stdout)
    assert (told["session"], told["recorded"], told["lost"], told["seed"]) == ("yesterday", "", None, "")


def stops(path: Path, *phases: tuple[m.Phase, int]) -> list[tuple[float, float]]:
    """Beginnings and lengths [s] of the stops of a log in which the arm is stopped from 1 s, the end being at 3 s."""
    with LogWriter(path) as log:
        status = m.ArmStatus(m.header(10**9), 7, 3, 0.0, "stopped", "")
        log.write(Envelope("/arm/status", type_name(m.ArmStatus), encode(status), 10**9, 1, bytes(16)))
        for number, (phase, stamp) in enumerate(phases, 1):
            state = m.SessionState(m.header(stamp), "s", int(phase), "")
            log.write(Envelope("/session/state", type_name(m.SessionState), encode(state), stamp, number, bytes(16)))
    with open_log(path) as read:
        return [(stop.start, stop.duration) for stop in info_of(read).stops]


def test_the_halt_that_ends_a_session_is_no_stop(tmp_path: Path) -> None:
    assert stops(tmp_path / "a.mcap", (m.Phase.CLOSING, 2 * 10**9), (m.Phase.DONE, 3 * 10**9)) == [(1.0, 2.0)]
    assert stops(tmp_path / "b.mcap", (m.Phase.CLOSING, 9 * 10**8), (m.Phase.DONE, 3 * 10**9)) == []
    assert stops(tmp_path / "c.mcap", (m.Phase.RUNNING, 3 * 10**9)) == [(1.0, 2.0)]


def test_a_session_notes_the_versions_of_its_plugins(tmp_path: Path) -> None:
    info = tmp_path / "acme_rings-2.5.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: acme-rings\nVersion: 2.5\n")
    (info / "entry_points.txt").write_text("[palpate.strategies]\nrings = acme.rings:Rings\n")
    plugins = [(DRIVERS, "mujoco_ur3e"), (STRATEGIES, "rings"), (STRATEGIES, "none")]
    program = f"from runtime.registry import packages; print(packages({plugins}))"
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True)
    assert ast.literal_eval(done.stdout) == {"palpate": version("palpate"), "acme-rings": "2.5"}


def test_an_index_that_is_damaged_is_done_without(sample: Path, tmp_path: Path) -> None:
    whole = sample.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[:-200])
    assert payload_bytes(cut) is None
    assert payload_bytes(tmp_path / "none.mcap") is None


def test_bad_input_is_one_line(palpate: CommandLine) -> None:
    (palpate.folder / "text.mcap").write_text("hello")
    for name, said in (("none.mcap", "there is no log none.mcap"), ("text.mcap", "is no MCAP file")):
        done = palpate.run("info", name)
        assert (done.returncode, done.stdout) == (2, "")
        assert said in done.stderr
        assert done.stderr.count("\n") == 1
