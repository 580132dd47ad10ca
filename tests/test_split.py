"""A session in several files is one session to a reader; one that stays in memory is written down when it matters."""

import json
import math
import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import log_samples
import pytest
from cells import cell_text, write_cell
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.rosbag2 import Reader

from runtime import config
from runtime import messages as m
from runtime import topics as t
from runtime.bus import Envelope, encode
from runtime.context import Context
from runtime.errors import InputError
from runtime.in_process import run_in_process
from runtime.launcher import Order, new_session
from runtime.local_bus import LocalExchange
from runtime.log.file import open_log
from runtime.log.recording import FileRecording, Opening
from runtime.log.snapshot_ring import SNAPSHOT, RingRecording, parse_span
from runtime.log.split import Split, parse_split
from runtime.log.writer import SUMMARY
from runtime.recorder import Recorder

SECOND = 1_000_000_000  # [ns]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("100MB", Split(bytes=100e6)),
        ("1.5 GiB", Split(bytes=1.5 * 2**30)),
        ("1000kb", Split(bytes=1e6)),
        ("60s", Split(seconds=60)),
        ("10 min", Split(seconds=600)),
        ("2h", Split(seconds=7200)),
    ],
)
def test_a_limit_is_a_size_or_a_time(text: str, expected: Split) -> None:
    assert parse_split(text) == expected


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("100", "neither a size such as 100MB"),
        ("fast", "neither a size"),
        ("-5s", "neither a size"),
        ("1 parsec", "neither a size"),
        ("10kB", "at least 1 MB"),
        ("0.5s", "at least 1 s"),
    ],
)
def test_another_limit_is_refused_with_what_would_do(text: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        parse_split(text)


def test_a_span_of_memory_is_a_number_of_seconds() -> None:
    assert (parse_span("30"), parse_span("1.5"), parse_span("2min")) == (30.0, 1.5, 120.0)
    for text in ("0", "soon", "2h", "nan", "1e9"):
        with pytest.raises(InputError, match="no time from 1 s to 3600 s"):
            parse_span(text)


@pytest.fixture(scope="module")
def parts(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """The sample session in files of 2 s."""
    path = tmp_path_factory.mktemp("split") / "sample.mcap"
    log_samples.record(path, split=Split(seconds=2.0))
    found = sorted(path.parent.glob("*.mcap"))
    assert found[0] == path.with_name("sample.mcap")
    return found


def sent() -> list[tuple[str, int, bytes]]:
    return [(topic.name, stamp, encode(message)) for _, topic, message, stamp in log_samples.messages()]


def test_all_files_are_read_as_one_session(parts: list[Path]) -> None:
    expected = sent()
    with open_log(parts[0]) as log:
        assert log.complete
        assert log.files == tuple(parts)
        assert len(parts) >= 3
        found = [(item.topic, item.stamp, item.payload) for item in log.messages() if item.topic != t.COUNTS.name]
        counts = {topic.name: topic.count for topic in log.topics}
        assert (log.start, log.end) == (0, max(stamp for _, stamp, _ in expected))
        assert log.metadata[SUMMARY]["messages"] == str(sum(counts.values()))
        assert log.metadata[SUMMARY]["lost_topics"] == "{}"
    assert Counter(found) == Counter(expected)
    assert [stamp for _, stamp, _ in found] == sorted(stamp for _, stamp, _ in found)
    del counts[t.COUNTS.name]
    assert counts == Counter(name for name, _, _ in expected)


def test_a_stretch_of_time_is_read_across_files(parts: list[Path]) -> None:
    clocks = sorted(stamp for name, stamp, _ in sent() if name == t.CLOCK.name)
    for start, end in ((1.0, 3.0), (1.9, 2.1), (4.5, math.inf)):
        expected = [stamp for stamp in clocks if start * SECOND <= stamp < end * SECOND]
        last = None if end == math.inf else round(end * SECOND)
        with open_log(parts[0]) as log:
            assert [item.stamp for item in log.messages([t.CLOCK.name], round(start * SECOND), last)] == expected


def test_each_file_stands_alone(parts: list[Path]) -> None:
    original = {name: payload for name, _, payload in sent() if name in (t.TF_STATIC.name, t.ROBOT_DESCRIPTION.name)}
    for path in parts[1:]:
        with open_log(path) as log:
            assert log.complete
            assert len(log.files) == 1
            assert json.loads(log.metadata["palpate.session"]["settings"]) == log_samples.DOCUMENT
            assert set(log.attachments) == {"sample.toml", "robot_description.urdf"}
            first = {item.topic: item for item in log.messages(original)}
            assert {name: item.payload for name, item in first.items()} == original
            assert {item.stamp for item in first.values()} == {log.start}, "restated where the file begins"
            assert log.end - log.start <= 2.1 * SECOND
        with Reader(path) as bag:
            assert bag.start_time >= log.start
    said = log_samples.rerun(parts[1].parent, "mcap", "check", str(parts[1]))
    assert {line.split()[0] for line in said.splitlines() if " /" in line} == {"ok"}


def test_a_missing_file_is_named_and_the_others_are_read(parts: list[Path], tmp_path: Path) -> None:
    for path in parts:
        (tmp_path / path.name).write_bytes(path.read_bytes())
    (tmp_path / "sample.part2.mcap").unlink()
    with open_log(tmp_path / "sample.mcap") as log:
        assert not log.complete
        with pytest.raises(InputError, match=r"^sample\.part2\.mcap is missing: the rest was used$"):
            log.check_complete("the rest was used")
        assert {item.stamp // (2 * SECOND) for item in log.messages([t.CLOCK.name])} >= {0, 2}
    for path in parts[2:]:
        (tmp_path / path.name).unlink()
    with open_log(tmp_path / "sample.mcap") as log, pytest.raises(InputError, match=r"sample\.part2\.mcap is missing"):
        log.check_complete("")


def no_account(messages: int, undefined: Counter[str]) -> dict[str, str]:
    return {"messages": str(messages)}


def line(number: int, stamp: int, text: str = "") -> Envelope:
    payload = encode(m.Log(m.stamp_of(stamp), 20, "test", text, "", "", number))
    return Envelope(t.ROSOUT.name, "rcl_interfaces/msg/Log", payload, stamp, number, bytes(16))


@given(st.lists(st.integers(0, 20 * SECOND), max_size=40))
@settings(max_examples=25, deadline=None)
def test_any_stamps_come_back_sorted_from_any_files(factory: Any, stamps: list[int]) -> None:
    path = factory.mktemp("stamps") / "a.mcap"
    recording = FileRecording(path, Opening(), no_account, Split(seconds=5.0))
    for number, stamp in enumerate(stamps, 1):
        recording.write(line(number, stamp))
    recording.finish()
    recording.close()
    with open_log(path) as log:
        found = [(item.stamp, item.sequence) for item in log.messages()]
        assert log.complete
    assert found == sorted((stamp, number) for number, stamp in enumerate(stamps, 1))


@pytest.fixture(scope="session")
def factory(tmp_path_factory: pytest.TempPathFactory) -> pytest.TempPathFactory:
    return tmp_path_factory


def test_files_of_a_size_are_of_about_that_size(tmp_path: Path) -> None:
    noise = log_samples.np.random.default_rng(1)
    recording = FileRecording(tmp_path / "a.mcap", Opening(), no_account, Split(bytes=1e6))
    for number in range(1, 1301):
        recording.write(line(number, number, noise.bytes(1000).hex()))  # 1 kB once compressed
        recording.tend()
    recording.finish()
    recording.close()
    *full, last = (tmp_path / name for name in ("a.mcap", "a.part2.mcap"))
    assert all(1e6 <= path.stat().st_size < 1.2e6 for path in full)
    with open_log(tmp_path / "a.mcap") as log:
        assert [item.sequence for item in log.messages()] == list(range(1, 1301))
        assert log.files[-1] == last


class Session:
    """A recorder at work, and a plugin that speaks."""

    def __init__(self, exchange: LocalExchange) -> None:
        self.plugin = log_samples.context(exchange, "launcher")
        self.plugin.ready()

    def say(self, topic: t.Topic[Any], message: Any, stamp: float) -> None:
        self.plugin.clock.advance(round(stamp * SECOND))
        self.plugin.bus.publisher(topic).send(message, round(stamp * SECOND))

    def log(self, stamp: float, level: int = 20, text: str = "all is well") -> None:
        self.say(t.ROSOUT, m.Log(m.stamp_of(round(stamp * SECOND)), level, "arm", text, "", "", 0), stamp)

    def phase(self, stamp: float, phase: m.Phase, text: str = "") -> None:
        self.say(t.SESSION, m.SessionState(m.header(round(stamp * SECOND)), "s", int(phase), text), stamp)

    def ask(self, reason: str = "") -> m.SnapshotReply:
        return self.plugin.bus.request(t.SNAPSHOT, m.SnapshotRequest(reason), 20.0)


@contextmanager
def recorded(path: Path, **options: Any) -> Iterator[Session]:
    """A session that is recorded while the block lasts."""
    exchange = LocalExchange()
    surroundings: Context = log_samples.context(exchange, "recorder")
    recorder = threading.Thread(target=Recorder(path, **options).run, args=(surroundings,))
    recorder.start()
    while exchange.wait_for({"recorder"}, 1.0):
        pass
    session = Session(exchange)
    try:
        yield session
    finally:
        session.plugin.close()
        surroundings.stop()
        recorder.join()


def test_a_snapshot_holds_the_last_seconds_and_what_was_latched_before(tmp_path: Path) -> None:
    path = tmp_path / "s.mcap"
    with recorded(path, snapshot=5.0) as session:
        session.say(t.ROBOT_DESCRIPTION, m.String("<robot/>"), 0.0)
        session.phase(0.0, m.Phase.RUNNING)
        for tenth in range(200):
            session.log(tenth / 10)
        reply = session.ask("the gripper sounded odd")
        again = session.ask()
        session.phase(20.0, m.Phase.CLOSING)
    assert (reply.error, reply.path) == ("", str(tmp_path / "s-snapshot-1.mcap"))
    assert again.path == str(tmp_path / "s-snapshot-2.mcap")
    assert not path.exists()
    with open_log(reply.path) as log:
        assert log.complete
        stamps = [item.stamp for item in log.messages([t.ROSOUT.name])]
        assert stamps == [round(tenth / 10 * SECOND) for tenth in range(149, 200)]
        assert reply.messages == len(stamps)
        assert [message.data for _, message in log.read(t.ROBOT_DESCRIPTION)] == ["<robot/>"]
        assert [message.phase for _, message in log.read(t.SESSION)] == [m.Phase.RUNNING]
        assert log.start == stamps[0]
        assert log.metadata[SNAPSHOT]["reason"] == "the gripper sounded odd"
        assert set(log.attachments) == {"robot_description.urdf"}
        assert log.metadata[SUMMARY]["lost"] == "0"


def attempt(outcome: m.Outcome) -> m.Attempt:
    pose = m.Pose(m.Point(0.0, 0.0, 0.0), m.Quaternion(0.0, 0.0, 0.0, 1.0))
    wrench = m.Wrench(m.Vector3(0.0, 0.0, 0.0), m.Vector3(0.0, 0.0, 0.0))
    return m.Attempt(m.header(0), 1, 3, 1, "7", 0.0, 0.0, int(outcome), "protective stop", pose, wrench, 0.0, 0.0, 1.0)


FAILURES = {
    "session": (t.SESSION, m.SessionState(m.header(0), "s", int(m.Phase.FAILED), "arm: died"), "arm: died"),
    "error": (t.ROSOUT, m.Log(m.stamp_of(0), 40, "arm", "no power", "", "", 0), "arm: no power"),
    "attempt": (t.ATTEMPT, attempt(m.Outcome.ABORTED), "hole 7 was aborted: protective stop"),
    "stop": (t.ARM_STATUS, m.ArmStatus(m.header(0), 7, 3, 0.0, "peck", "igbt"), "safety mode 3: peck"),
    "fault": (t.PERMIT, m.Permit(m.header(0), False, 3, "channels", m.stamp_of(0)), "interlock is in fault: channels"),
}
HARMLESS = {
    "warning": (t.ROSOUT, m.Log(m.stamp_of(0), 30, "arm", "given up", "", "", 0)),
    "blocked": (t.ATTEMPT, attempt(m.Outcome.BLOCKED)),
    "beam": (t.ARM_STATUS, m.ArmStatus(m.header(0), 7, 5, 0.0, "safeguard stop", "igbt")),
    "tripped": (t.PERMIT, m.Permit(m.header(0), False, 2, "light field interrupted", m.stamp_of(0))),
}


@pytest.mark.parametrize("kind", FAILURES)
def test_a_failure_is_written_down_with_what_led_to_it_and_came_after(tmp_path: Path, kind: str) -> None:
    topic, message, said = FAILURES[kind]
    with recorded(tmp_path / "s.mcap", snapshot=5.0) as session:
        for tenth in range(100):
            session.log(tenth / 10)
        session.say(topic, message, 10.0)
        for tenth in range(101, 150):
            session.log(tenth / 10)
        session.phase(15.0, m.Phase.CLOSING)
    [path] = tmp_path.glob("*.mcap")
    with open_log(path) as log:
        assert said in log.metadata[SNAPSHOT]["reason"]
        stamps = [item.stamp / SECOND for item in log.messages([t.ROSOUT.name])]
        assert log.end >= 11.0 * SECOND
        assert min(stamps) <= log.end / SECOND - 4.8
        assert list(log.read(topic))


def test_what_is_no_failure_and_not_asked_for_is_not_written(tmp_path: Path) -> None:
    with recorded(tmp_path / "s.mcap", snapshot=5.0) as session:
        session.log(1.0)
        for topic, message in HARMLESS.values():
            session.say(topic, message, 2.0)
        session.phase(9.0, m.Phase.DONE)
    assert list(tmp_path.iterdir()) == []


def test_a_launcher_that_vanished_is_a_failure(tmp_path: Path) -> None:
    with recorded(tmp_path / "s.mcap", snapshot=5.0) as session:
        session.phase(1.0, m.Phase.RUNNING)
        session.log(1.0)
    with open_log(tmp_path / "s-snapshot-1.mcap") as log:
        assert log.metadata[SNAPSHOT]["reason"] == "the launcher ended without a word"
        assert [message.msg for _, message in log.read(t.ROSOUT)] == ["all is well"]


def test_a_recorder_of_everything_refuses_a_snapshot(tmp_path: Path) -> None:
    with recorded(tmp_path / "s.mcap") as session:
        reply = session.ask()
        session.phase(1.0, m.Phase.DONE)
    assert reply.path == ""
    assert "is recorded whole" in reply.error
    assert "--snapshot SECONDS" in reply.error


def test_memory_is_bounded_whatever_comes(tmp_path: Path) -> None:
    ring = RingRecording(tmp_path / "s.mcap", Opening(), no_account, 3600.0, limit=100_000)
    for number in range(1, 2001):
        ring.write(line(number, 7, "x" * 1000))
    reply = ring.snapshot("")
    assert 60 <= reply.messages <= 100
    with open_log(reply.path) as log:
        assert [item.sequence for item in log.messages()][-1] == 2000


def test_a_failure_again_and_again_takes_no_more_than_a_recording(tmp_path: Path) -> None:
    ring = RingRecording(tmp_path / "s.mcap", Opening(), no_account, 10.0)
    for number in range(1, 601):
        ring.write(line(number, number * SECOND // 10))
        if number >= 100:
            ring.fail(f"failure {number}")
        ring.tend()
    ring.finish()
    files = sorted(tmp_path.glob("*.mcap"))
    told = []
    for path in files:
        with open_log(path) as log:
            told.append({item.sequence for item in log.messages()})
    assert len(files) <= 6
    assert set.union(*told) >= set(range(100, 601)), "from the first failure on nothing is missing"


def test_a_cell_is_recorded_in_files_of_a_length(tmp_path: Path) -> None:
    cell = config.load(str(write_cell(tmp_path, cell_text(holes=1))), {})
    session = run_in_process(Order(cell, tmp_path / "logs", split=Split(seconds=3.0)))
    with open_log(session.log) as log:
        assert log.complete
        assert len(log.files) == math.ceil(log.end / (3.0 * SECOND))
        assert log.metadata[SUMMARY]["lost_topics"] == "{}"
        assert {topic.name: topic.count for topic in log.topics}[t.TF_STATIC.name] == 1
        assert [state.phase for _, state in log.read(t.SESSION)][-2:] == [m.Phase.DONE, m.Phase.CLOSING]


def test_a_session_never_takes_the_name_of_one_that_left_snapshots(tmp_path: Path) -> None:
    now = datetime.now()
    for second in range(5):
        name = (now + timedelta(seconds=second)).strftime("%Y%m%d-%H%M%S")
        (tmp_path / f"{name}-snapshot-1.mcap").touch()
    assert new_session(tmp_path).name.endswith("-2")
