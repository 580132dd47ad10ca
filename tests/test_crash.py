"""Killed at any moment, flooded, or out of disk: what is on record is read, and what is missing is known."""

import contextlib
import json
import mmap
import multiprocessing
import os
import random
import resource
import signal
import struct
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from multiprocessing.process import BaseProcess
from multiprocessing.synchronize import Event
from pathlib import Path

import log_samples
import pytest
from cells import Palpate, cell_text, write_cell
from conftest import unused_port
from rosbags.rosbag2 import Reader

from runtime import messages as m
from runtime import topics as t
from runtime.bus import encode
from runtime.clock import Stopwatch
from runtime.context import Context
from runtime.errors import InputError, LogError, SessionError
from runtime.local_bus import LocalBus, LocalExchange
from runtime.log.file import open_log
from runtime.log.recovery import recover
from runtime.log.split import Split
from runtime.log.writer import SUMMARY, LogWriter
from runtime.network.zenoh_bus import ZenohBus, ZenohRouter
from runtime.recorder import Recorder

PACE = 0.002  # [s] between messages, at least
PROMISE = 0.2  # [s] of machine time that a kill may cost
FORK = multiprocessing.get_context("forkserver")
FORK.set_forkserver_preload(["test_crash"])


@pytest.fixture
def palpate(tmp_path: Path) -> Iterator[Palpate]:
    made = Palpate(tmp_path)
    yield made
    for pid in made.processes():
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)


@pytest.fixture
def limited() -> Iterator[Callable[[int], None]]:
    """Lets no file of this process and of those that it starts grow beyond a size, as a full disk would."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    yield lambda size: resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    signal.signal(signal.SIGXFSZ, before)


def line(text: str = "x" * 50) -> m.Log:
    return m.Log(m.stamp_of(0), 20, "talker", text, "", "", 0)


PAYLOAD = encode(line())  # made here, so that processes that are forked have all they need for it


def record_and_count(path: str, counter: str, split: Split | None) -> None:
    """Record what a thread of this process sends, and keep the number that was handed over where a kill leaves it."""
    with Path(counter).open("r+b") as file:
        handed_over = mmap.mmap(file.fileno(), 8)
    exchange = LocalExchange()
    context = Context("recorder", LocalBus(exchange, "recorder"), log_samples.CELL, "s")
    threading.Thread(target=Recorder(Path(path), {"palpate.session": {}}, split=split).run, args=(context,)).start()
    exchange.wait_for({"recorder"}, 60.0)
    publisher = LocalBus(exchange, "talker").publisher(t.ROSOUT)
    number = 0
    while True:
        number += 1
        publisher.send_raw(PAYLOAD, number * 100_000_000)
        struct.pack_into("<q", handed_over, 0, number)
        time.sleep(PACE)


@pytest.mark.parametrize("moment", range(16))
def test_a_kill_at_any_moment_costs_no_more_than_the_last_moments(tmp_path: Path, moment: int) -> None:
    counter, path = tmp_path / "counter", tmp_path / "killed.mcap"
    counter.write_bytes(bytes(8))
    split = Split(seconds=1.0) if moment % 2 else None  # with files that follow each other several times a second
    process = FORK.Process(target=record_and_count, args=(str(path), str(counter), split))
    process.start()
    while struct.unpack("<q", counter.read_bytes())[0] == 0:
        time.sleep(0.001)
    time.sleep(random.Random(moment).uniform(0.0, 0.6))
    process.kill()
    process.join()
    [sent] = struct.unpack("<q", counter.read_bytes())
    with open_log(path) as log:
        assert not log.complete
        sequence = [item.sequence for item in log.messages()]
        assert "palpate.session" in log.metadata
    assert sequence == list(range(1, len(sequence) + 1)), "a prefix without gaps"
    # So many messages take longer than PROMISE, at the pace at which they were sent.
    assert sent - len(sequence) <= PROMISE / PACE
    recover(path)
    with open_log(path) as log:
        assert log.complete
        assert [item.sequence for item in log.messages()] == sequence
        assert log.metadata[SUMMARY]["messages"] == str(len(sequence))


def record(path: str, port: int, ready: Event, stop: Event) -> None:
    with ZenohBus("recorder", port) as bus:
        context = Context("recorder", bus, log_samples.CELL, "s")
        threading.Thread(target=lambda: (stop.wait(), context.stop()), daemon=True).start()
        ready.set()
        Recorder(Path(path)).run(context)


FLOOD = (t.JOINT_STATES, t.WRENCH, t.TCP_POSE, t.ROSOUT)
EACH = 15_000  # messages


def flood(port: int, go: Event) -> None:
    payload = encode(line("x" * 250))
    with ZenohBus("arm", port) as bus:
        publishers = [bus.publisher(topic) for topic in FLOOD]
        context = Context("arm", bus, log_samples.CELL, "s")
        context.ready()
        go.wait()
        for number in range(EACH):
            for publisher in publishers:
                publisher.send_raw(payload, number)
        context.close()
        bus.request(DONE, m.BeliefRequest("", 0, 0), 60.0)


DONE = t.Service("/test/done", m.BeliefRequest, m.BeliefRequest, "clerk", "an answer that comes after all before it")


def test_a_flood_waits_for_a_recorder_that_stands_still_and_nothing_is_lost(tmp_path: Path) -> None:
    path, port = tmp_path / "flood.mcap", unused_port()
    ready, stop, go = FORK.Event(), FORK.Event(), FORK.Event()
    with ZenohRouter(port) as router, ZenohBus("clerk", port) as clerk:
        clerk.serve(DONE)
        clerk.announce()
        recorder = FORK.Process(target=record, args=(str(path), port, ready, stop))
        talker = FORK.Process(target=flood, args=(port, go))
        recorder.start()
        talker.start()
        assert not router.wait_for({"recorder", "arm", "clerk"}, 60.0)
        go.set()
        while path.stat().st_size < 100_000:
            time.sleep(0.001)
        stopped(recorder, 1.0)
        request = clerk.inbox.receive(60.0)
        assert request is not None
        request.reply(m.BeliefRequest("", 0, 0))  # type: ignore[union-attr]
        talker.join()
        stop.set()
        recorder.join()
    with open_log(path) as log:
        assert log.metadata[SUMMARY]["lost_topics"] == "{}"
        assert log.metadata[SUMMARY]["unsigned_topics"] == "[]"
        found: dict[str, list[int]] = {topic.name: [] for topic in FLOOD}
        for item in log.messages(found):
            found[item.topic].append(item.sequence)
    assert found == {topic.name: list(range(1, EACH + 1)) for topic in FLOOD}


def stopped(process: BaseProcess, seconds: float) -> None:
    """Let a process stand still for a while."""
    assert process.pid is not None
    os.kill(process.pid, signal.SIGSTOP)
    time.sleep(seconds)
    os.kill(process.pid, signal.SIGCONT)


def until_recorded(palpate: Palpate, size: int) -> Path:
    """Wait until a session's log has grown to a size [byte]."""
    watch = Stopwatch()
    while not (found := [log for log in palpate.logs() if log.stat().st_size >= size]):
        assert watch.seconds < 100.0
        time.sleep(0.02)
    return found[0]


def test_a_cell_that_is_killed_as_a_whole_leaves_a_log_that_is_recovered(palpate: Palpate) -> None:
    cell = write_cell(palpate.folder, cell_text(holes=2))
    process = palpate.start("launch", cell, "--port", str(palpate.port), "--boards", "50", "--rerun", "off")
    path = until_recorded(palpate, 200_000)
    victims = palpate.processes()
    assert len(victims) >= 8
    for pid in victims:
        os.kill(pid, signal.SIGKILL)
    process.communicate()
    with open_log(path) as log:
        assert not log.complete
        before = [(item.topic, item.stamp, item.sequence, item.payload) for item in log.messages()]
        assert list(log.read(t.SEARCH_GOAL))
        described = log.attachments["robot_description.urdf"]
    done = palpate.run("recover", path)
    assert (done.returncode, done.stderr) == (0, "")
    assert f"recovered {len(before)} messages until " in done.stdout
    with open_log(path) as log:
        assert log.complete
        assert [(item.topic, item.stamp, item.sequence, item.payload) for item in log.messages()] == before
        assert log.attachments["robot_description.urdf"] == described
        assert log.metadata[SUMMARY]["lost"] == "0"
        assert log.metadata[SUMMARY]["recovered"] == str(len(before))
    again = palpate.run("recover", path)
    assert (again.returncode, again.stdout) == (0, f"{path} is complete: there is nothing to recover\n")


def test_a_full_disk_ends_the_cell_in_good_order(palpate: Palpate, limited: Callable[[int], None]) -> None:
    cell = write_cell(palpate.folder, cell_text(holes=2))
    limited(400_000)
    done = palpate.launch(cell, "--boards", "50", "--rerun", "off")
    [path] = palpate.logs()
    assert done.returncode == 1
    [said] = done.stderr.splitlines()
    name = path.relative_to(palpate.folder)
    assert said.startswith(f"palpate: recorder: {name} cannot be written any further: File too large; it holds ")
    assert not palpate.processes()
    with open_log(path) as log:
        assert not log.complete
        count = sum(1 for _ in log.messages())
        assert said.endswith(f"it holds {count} messages")
        assert list(log.read(t.SEARCH_GOAL))


def test_a_plugin_that_dies_is_told_in_the_snapshot(palpate: Palpate) -> None:
    cell = write_cell(palpate.folder, cell_text(holes=2))
    options = ("--port", str(palpate.port), "--boards", "50", "--rate", "10", "--snapshot", "60", "--rerun", "off")
    process = palpate.start("launch", cell, *options)
    watch = Stopwatch()
    while not (asked := palpate.run("snapshot", "--port", str(palpate.port), "--reason", "just so")).stdout:
        assert watch.seconds < 100.0
        assert asked.returncode == 1
    assert Path(asked.stdout.strip()) == palpate.logs()[0]
    [victim] = [pid for pid, command in palpate.processes().items() if command.endswith("runtime.host strategy ")]
    os.kill(victim, signal.SIGKILL)
    out, err = process.communicate(timeout=100)
    assert process.returncode == 1
    [said] = err.splitlines()
    assert said.startswith("palpate: strategy: ")
    *_, path = palpate.logs()
    assert str(path.relative_to(palpate.folder)) in out
    with open_log(path) as log:
        [reason] = [state.text for _, state in log.read(t.SESSION) if state.phase == m.Phase.FAILED]
        assert f"palpate: {reason}" == said
        assert reason in log.metadata["palpate.snapshot"]["reason"]
    assert not palpate.processes()


def test_a_disk_that_is_full_at_the_end_leaves_every_message(tmp_path: Path, limited: Callable[[int], None]) -> None:
    path = tmp_path / "full.mcap"
    log = LogWriter(path)
    exchange = LocalExchange()
    surroundings = log_samples.context(exchange, "probe")
    surroundings.bus.subscribe_all()
    publisher = log_samples.context(exchange, "talker").bus.publisher(t.ROSOUT)
    for number in range(100):
        publisher.send(line(), number)
        item = surroundings.bus.inbox.poll()
        assert item is not None
        log.write(item)  # type: ignore[arg-type]
    log.flush()
    limited(path.stat().st_size + 50)
    with pytest.raises(SessionError, match=r"full\.mcap cannot be written any further: .*; it holds 100 messages"):
        log.close()
    with open_log(path) as read:
        assert sum(1 for _ in read.messages()) == 100
        assert not read.complete


@pytest.fixture
def cut(tmp_path: Path) -> Path:
    """The first two thirds of the sample session."""
    path = tmp_path / "whole.mcap"
    log_samples.record(path)
    cut = tmp_path / "cut.mcap"
    data = path.read_bytes()
    cut.write_bytes(data[: len(data) * 2 // 3])
    return cut


def test_other_tools_read_what_was_recovered(cut: Path) -> None:
    with open_log(cut) as log:
        expected = Counter({topic.name: topic.count for topic in log.topics})
    original = cut.read_bytes()
    [done] = recover(cut)
    assert (done.path, done.original) == (cut, cut.with_name("cut.mcap.unfinished"))
    assert done.original.read_bytes() == original
    with Reader(cut) as bag:
        assert bag.message_count == expected.total() == done.messages
        assert {connection.topic: connection.msgcount for connection in bag.connections} == expected
        assert bag.end_time - 1 == round(done.until * 1e9)
    said = log_samples.rerun(cut.parent, "mcap", "check", str(cut))
    assert {row.split()[0] for row in said.splitlines() if " /" in row} == {"ok"}
    with open_log(cut) as log:
        assert set(log.attachments) == {"sample.toml", "robot_description.urdf"}
        assert json.loads(log.metadata[SUMMARY]["unsigned_topics"]) == sorted(expected)


def test_a_recovery_elsewhere_leaves_the_log_alone(cut: Path) -> None:
    original, output = cut.read_bytes(), cut.with_name("out.mcap")
    [done] = recover(cut, output)
    assert (done.path, done.original, cut.read_bytes()) == (output, cut, original)
    with pytest.raises(InputError, match=r"out\.mcap exists already"):
        recover(cut, output)
    assert sorted(path.name for path in cut.parent.glob("*")) == ["cut.mcap", "out.mcap", "whole.mcap"]


def test_a_recovery_that_finds_the_disk_full_leaves_the_log_alone(cut: Path, limited: Callable[[int], None]) -> None:
    original = cut.read_bytes()
    limited(50_000)
    with pytest.raises(SessionError, match="cannot be written: File too large"):
        recover(cut)
    assert cut.read_bytes() == original
    assert sorted(path.name for path in cut.parent.glob("*")) == ["cut.mcap", "whole.mcap"]


def test_a_log_that_is_still_being_recorded_is_not_touched(tmp_path: Path) -> None:
    path = tmp_path / "alive.mcap"
    with LogWriter(path) as log:
        log.add_metadata("palpate.session", {})
        with pytest.raises(InputError, match=r"alive\.mcap is still being recorded"):
            recover(path)
    assert recover(path) == []


def test_a_recorder_that_was_killed_before_its_first_message_leaves_an_empty_log(tmp_path: Path) -> None:
    path = tmp_path / "early.mcap"
    log = LogWriter(path)
    log.add_metadata("palpate.session", {"session": "s"})
    data = path.read_bytes()
    log.close()
    path.write_bytes(data)
    with open_log(path) as read:
        assert not read.complete
        assert (list(read.messages()), read.topics, read.metadata) == ([], (), {"palpate.session": {"session": "s"}})
    recover(path)
    with open_log(path) as read:
        assert read.complete
        assert read.metadata[SUMMARY]["messages"] == "0"


def test_what_is_no_log_is_not_recovered(palpate: Palpate) -> None:
    (palpate.folder / "a.mcap").write_text("hello, world")
    done = palpate.run("recover", "a.mcap")
    assert (done.returncode, done.stderr) == (2, "palpate: a.mcap is no MCAP file\n")
    with pytest.raises(LogError, match="there is no log"):
        recover(palpate.folder / "b.mcap")


def test_losses_are_known_after_a_recovery(tmp_path: Path) -> None:
    path = tmp_path / "lossy.mcap"
    exchange = LocalExchange()
    with LogWriter(path) as log:
        surroundings = log_samples.context(exchange, "probe")
        surroundings.bus.subscribe_all()
        publisher = log_samples.context(exchange, "arm").bus.publisher(t.CLOCK)
        for number in range(1, 21):
            publisher.send(m.Clock(m.stamp_of(number)), number)
            item = surroundings.bus.inbox.poll()
            if number not in (5, 6, 11):
                log.write(item)  # type: ignore[arg-type]
        log.flush()
        data = path.read_bytes()
    path.write_bytes(data)
    recover(path)
    with open_log(path) as read:
        assert json.loads(read.metadata[SUMMARY]["lost_topics"]) == {"/clock": 3}
