"""A recording holds what was sent, says what is missing, and can be read even when its recorder was killed."""

import itertools
import json
import multiprocessing
import random
import resource
import signal
import socket
import sqlite3
import threading
from collections import Counter
from pathlib import Path

import log_samples
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import Writer
from rosbags.interfaces import ConnectionExtRosbag2
from rosbags.rosbag2 import Reader

from runtime import messages as m
from runtime import topics as t
from runtime.bus import Envelope, encode
from runtime.context import Context
from runtime.errors import LogError, SessionError
from runtime.local_bus import LocalExchange
from runtime.log.file import open_log
from runtime.log.writer import SUMMARY, LogWriter
from runtime.network.zenoh_bus import ZenohBus, ZenohRouter
from runtime.recorder import Recorder

ROSOUT = "rcl_interfaces/msg/Log"


def envelope(number: int, stamp: int | None = None, text: str = "hello", topic: str = "/rosout") -> Envelope:
    payload = encode(m.Log(m.stamp_of(number), 20, "test", text, "", "", 0))
    return Envelope(topic, ROSOUT, payload, number * 1000 if stamp is None else stamp, number, bytes(16))


@pytest.fixture(scope="module")
def sample(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, int]:
    path = tmp_path_factory.mktemp("log") / "sample.mcap"
    return path, log_samples.record(path)


def test_everything_that_was_sent_is_in_the_file(sample: tuple[Path, int]) -> None:
    path, sent = sample
    expected = Counter(topic.name for _, topic, _, _ in log_samples.messages())
    with open_log(path) as log:
        assert log.complete
        counts = {topic.name: topic.count for topic in log.topics}
        assert {name: count for name, count in counts.items() if name != t.COUNTS.name} == expected
        summary = log.metadata[SUMMARY]
        assert (summary["messages"], summary["lost"]) == (str(sent), "0")
        assert json.loads(summary["lost_topics"]) == {}
        assert json.loads(summary["unsigned_topics"]) == []


def test_messages_come_back_as_they_were_in_session_time(sample: tuple[Path, int]) -> None:
    original = [(stamp, message) for _, topic, message, stamp in log_samples.messages() if topic is t.ATTEMPT]
    with open_log(sample[0]) as log:
        assert list(log.read(t.ATTEMPT)) == original
        stamps = [item.stamp for item in log.messages()]
        assert stamps == sorted(stamps)
        assert (log.start, log.end) == (stamps[0], stamps[-1])


def test_a_part_of_the_log_can_be_read(sample: tuple[Path, int]) -> None:
    with open_log(sample[0]) as log:
        every = [item.stamp for item in log.messages([t.CLOCK.name])]
        first, last = every[10], every[20]
        assert [item.stamp for item in log.messages([t.CLOCK.name], first, last)] == every[10:20]
        assert list(log.messages([t.CLOCK.name], last, first)) == []
        assert {item.topic for item in log.messages([t.CLOCK.name, t.ATTEMPT.name])} == {"/clock", "/attempt"}


def test_metadata_and_attachments_are_inside(sample: tuple[Path, int]) -> None:
    with open_log(sample[0]) as log:
        assert json.loads(log.metadata["palpate.session"]["settings"]) == log_samples.DOCUMENT
        assert log.attachments["sample.toml"] == b"component = 'igbt'"
        [(_, description)] = log.read(t.ROBOT_DESCRIPTION)
        assert log.attachments["robot_description.urdf"].decode() == description.data


def test_another_implementation_of_rosbag2_reads_it(sample: tuple[Path, int]) -> None:
    with Reader(sample[0]) as bag:
        assert bag.message_count == sample[1]
        connection = next(item for item in bag.connections if item.topic == t.ROBOT_DESCRIPTION.name)
        assert connection.msgtype == "std_msgs/msg/String"
        assert isinstance(connection.ext, ConnectionExtRosbag2)
        [qos] = connection.ext.offered_qos_profiles
        assert (qos.durability.name, qos.reliability.name, qos.depth) == ("TRANSIENT_LOCAL", "RELIABLE", 1)


def test_rerun_finds_nothing_to_complain_about(sample: tuple[Path, int]) -> None:
    said = log_samples.rerun(sample[0].parent, "mcap", "check", str(sample[0]))
    rows = [line.split() for line in said.splitlines() if " /" in line]
    assert {row[3] for row in rows} == {topic.name for _, topic, _, _ in log_samples.messages()} | {t.COUNTS.name}
    assert {row[0] for row in rows} == {"ok"}


def test_what_is_lost_is_counted(tmp_path: Path) -> None:
    exchange = LocalExchange()
    path = tmp_path / "gap.mcap"
    surroundings = log_samples.context(exchange, "recorder")
    recorder = threading.Thread(target=Recorder(path).run, args=(surroundings,))
    recorder.start()
    while exchange.wait_for({"recorder"}, 1.0):
        pass
    for number in (1, 2, 5, 6):
        exchange.deliver(envelope(number), latched=False)
    plugin = log_samples.context(exchange, "strategy")
    counts = m.PublisherCounts(m.header(0), "strategy", [m.PublisherCount(t.ROSOUT.name, 9)])
    plugin.bus.publisher(t.COUNTS).send(counts, 0)
    surroundings.stop()
    recorder.join()
    with open_log(path) as log:
        assert json.loads(log.metadata[SUMMARY]["lost_topics"]) == {"/rosout": 5}  # 3, 4 and 7, 8, 9
        assert log.metadata[SUMMARY]["messages"] == "5"


def test_a_publisher_that_never_said_its_last_word_is_named(tmp_path: Path) -> None:
    exchange = LocalExchange()
    path = tmp_path / "crash.mcap"
    surroundings = log_samples.context(exchange, "recorder")
    recorder = threading.Thread(target=Recorder(path).run, args=(surroundings,))
    recorder.start()
    while exchange.wait_for({"recorder"}, 1.0):
        pass
    exchange.deliver(envelope(1), latched=False)
    surroundings.stop()
    recorder.join()
    with open_log(path) as log:
        assert json.loads(log.metadata[SUMMARY]["unsigned_topics"]) == ["/rosout"]
        assert log.metadata[SUMMARY]["lost"] == "0"


def test_a_type_that_palpate_does_not_know_is_recorded_all_the_same(tmp_path: Path) -> None:
    path = tmp_path / "unknown.mcap"
    with LogWriter(path) as log:
        log.write(Envelope("/radar", "acme_msgs/msg/Radar", b"\x00\x01\x00\x00\x07", 5, 1, bytes(16)))
        log.write(envelope(1))
        assert log.undefined == {"acme_msgs/msg/Radar": 1}
    with open_log(path) as read:
        [message] = read.messages(["/radar"])
        assert (message.type, message.payload) == ("acme_msgs/msg/Radar", b"\x00\x01\x00\x00\x07")
        with pytest.raises(LogError, match="does not know the type acme_msgs/msg/Radar"):
            read.decode(message)
    assert "/radar" in log_samples.rerun(tmp_path, "mcap", "check", str(path))


def foreign(path: Path, encoding: str, definition: str, message_encoding: str = "cdr") -> Path:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        schema = writer.register_schema("acme_msgs/msg/Range", encoding, definition.encode())
        channel = writer.register_channel("/range", message_encoding, schema)
        writer.add_message(channel, 7, b"\x00\x01\x00\x00" + b"\x00\x00\x80\x3f", 7, 1)
        writer.finish()
    return path


def test_a_type_that_the_log_defines_can_be_decoded(tmp_path: Path) -> None:
    with open_log(foreign(tmp_path / "foreign.mcap", "ros2msg", "float32 metres\n")) as log:
        [message] = log.messages()
        assert log.decode(message).metres == 1.0


def test_another_encoding_is_named(tmp_path: Path) -> None:
    with open_log(foreign(tmp_path / "foreign.mcap", "protobuf", "", "protobuf")) as log:
        [message] = log.messages()
        with pytest.raises(LogError, match="'protobuf'"):
            log.decode(message)


def test_a_type_of_another_version_is_not_misread(tmp_path: Path) -> None:
    path = tmp_path / "old.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        schema = writer.register_schema("palpate_msgs/msg/Reset", "ros2msg", b"string source\n")
        channel = writer.register_channel(t.RESET.name, "cdr", schema, {"topic_type_hash": "RIHS01_" + "0" * 64})
        writer.add_message(channel, 7, b"\x00\x01\x00\x00\x01\x00\x00\x00\x00", 7, 1)
        writer.finish()
    with open_log(path) as log, pytest.raises(LogError, match="defined it differently"):
        list(log.read(t.RESET))


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of several chunks with an attachment between them."""
    path = tmp_path_factory.mktemp("log") / "small.mcap"
    with LogWriter(path) as log:
        for number in range(1, 201):
            log.write(envelope(number, topic=f"/topic_{number % 3}"))
            if number % 20 == 0:
                log.flush()
            if number == 90:
                log.attach("note.txt", "half way")
    return path


def contents(path: Path) -> tuple[bool, int, Counter[bytes]]:
    """Whether a log is complete, how many messages it says it has, and which it has; nothing if there are none."""
    try:
        with open_log(path) as log:
            found = Counter(item.payload for item in log.messages())
            return log.complete, sum(topic.count for topic in log.topics), found
    except LogError as error:
        if "\n" in str(error):
            raise AssertionError("an error is more than one line") from error
        return False, 0, Counter()


@given(cut=st.floats(0.0, 1.0))
@settings(max_examples=100, deadline=None)
def test_a_log_that_breaks_off_is_read_as_far_as_it_goes(small: Path, cut: float) -> None:
    whole = small.read_bytes()
    broken = small.with_name("broken.mcap")
    broken.write_bytes(whole[: 1 + int(cut * (len(whole) - 2))])
    complete, count, found = contents(broken)
    _, _, expected = contents(small)
    assert not complete
    assert count == found.total()
    assert found <= expected
    chunks_begun = broken.read_bytes().count(b"\x28\xb5\x2f\xfd")  # zstd's magic number; only the last can be cut
    assert count >= 20 * (chunks_begun - 1)


@given(place=st.floats(0.0, 1.0), value=st.integers(0, 255))
@settings(max_examples=100, deadline=None)
def test_a_damaged_byte_never_becomes_a_wrong_message(small: Path, place: float, value: int) -> None:
    data = bytearray(small.read_bytes())
    data[int(place * (len(data) - 1))] = value
    damaged = small.with_name("damaged.mcap")
    damaged.write_bytes(data)
    assert contents(damaged)[2] <= contents(small)[2]


@given(st.lists(st.integers(0, 2**40), max_size=60))
@settings(max_examples=30, deadline=None)
def test_any_stamps_come_back_sorted(tmp_path_factory: pytest.TempPathFactory, stamps: list[int]) -> None:
    path = tmp_path_factory.mktemp("stamps") / "a.mcap"
    with LogWriter(path) as log:
        for number, stamp in enumerate(stamps, 1):
            log.write(envelope(number, stamp))
            if number % 7 == 0:
                log.flush()
    with open_log(path) as read:
        found = [(item.stamp, item.sequence) for item in read.messages()]
    assert found == sorted((stamp, number) for number, stamp in enumerate(stamps, 1))


def record_until_killed(path: str, port: int) -> None:
    with ZenohBus("recorder", port) as bus:
        Recorder(Path(path)).run(Context("recorder", bus, log_samples.CELL, "s"))


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def test_a_killed_recorder_leaves_what_it_had_flushed(tmp_path: Path) -> None:
    path, port = tmp_path / "killed.mcap", free_port()
    with ZenohRouter(port) as router, ZenohBus("talker", port) as bus:
        process = multiprocessing.get_context("spawn").Process(target=record_until_killed, args=(str(path), port))
        process.start()
        assert not router.wait_for({"recorder"}, 60)
        publisher = bus.publisher(t.ROSOUT)
        while path.stat().st_size < 2000:
            publisher.send(m.Log(m.stamp_of(0), 20, "talker", "x" * 50, "", "", 0), 5)
        process.kill()
        process.join()
    with open_log(path) as log:
        assert not log.complete
        sequence = [item.sequence for item in log.messages([t.ROSOUT.name])]
        assert sequence
        assert sequence == list(range(1, len(sequence) + 1))


def write_forever(path: Path) -> None:
    with LogWriter(path) as log:
        for number in itertools.count(1):
            log.write(envelope(number, text=random.Random(number).randbytes(40).hex()))
            if number % 100 == 0:
                log.flush()


def test_a_full_disk_ends_in_one_line_and_a_readable_file(tmp_path: Path) -> None:
    path = tmp_path / "full.mcap"
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, hard))
        with pytest.raises(SessionError, match=r"cannot be written any further: .*; it holds \d+ messages"):
            write_forever(path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, before)
    with open_log(path) as read:
        count = sum(1 for _ in read.messages())
        assert count >= 100
        assert not read.complete


def test_a_recording_is_never_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_text("precious")
    with pytest.raises(SessionError, match="never overwritten"):
        log_samples.record(path)
    assert path.read_text() == "precious"


def test_a_place_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(SessionError, match="cannot be written"):
        log_samples.record(tmp_path / "file" / "a.mcap")


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("empty.mcap", b"", "is empty"),
        ("text.mcap", b"hello, world", "is no MCAP file"),
        ("start.mcap", b"\x89MCAP0\r\n", "in its first record"),
    ],
)
def test_what_is_no_log_is_refused_in_one_line(tmp_path: Path, name: str, content: bytes, said: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(LogError, match=said) as caught:
        open_log(tmp_path / name)
    assert "\n" not in str(caught.value)


def test_another_kind_of_file_is_refused(tmp_path: Path) -> None:
    with sqlite3.connect(tmp_path / "a.mcap") as database:
        database.execute("create table a (b)")
    database.close()
    with pytest.raises(LogError, match="no MCAP file"):
        open_log(tmp_path / "a.mcap")


def test_a_missing_log_names_its_neighbours(tmp_path: Path) -> None:
    for name in ("20260101-120000.mcap", "20260102-120000.mcap"):
        (tmp_path / name).touch()
    with pytest.raises(LogError, match=r"there is no log .*20260101-12000\.mcap.*holds 20260101-120000\.mcap"):
        open_log(tmp_path / "20260101-12000.mcap")
    with pytest.raises(LogError, match=r"is a directory.*20260102-120000\.mcap"):
        open_log(tmp_path)
    with pytest.raises(LogError, match="does not exist either"):
        open_log(tmp_path / "nowhere" / "a.mcap")
