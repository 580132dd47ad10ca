"""A log that is played back arrives whole, in order and with its timing, over the real transport."""

import socket
import threading
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import log_samples
import pytest

from runtime import topics as t
from runtime.bus import Envelope, Inbox
from runtime.clock import Stopwatch
from runtime.errors import InputError
from runtime.local_bus import LocalBus, LocalExchange
from runtime.log_file import LogFile, open_log
from runtime.player import play
from runtime.recorder import LogWriter
from runtime.zenoh_bus import ZenohBus, ZenohRouter


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("log") / "sample.mcap"
    log_samples.record(path)
    return path


@pytest.fixture
def log(path: Path) -> Iterator[LogFile]:
    with open_log(path) as log:
        yield log


@pytest.fixture(scope="module")
def port() -> Iterator[int]:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = int(probe.getsockname()[1])
    with ZenohRouter(port):
        yield port


def take(inbox: Inbox, count: int) -> list[Envelope]:
    items = [inbox.receive(30.0) for _ in range(count)]
    return [item for item in items if isinstance(item, Envelope)]


def content(envelopes: list[Envelope]) -> list[tuple[str, str, int, bytes]]:
    return [(item.topic, item.type, item.stamp, item.payload) for item in envelopes]


@pytest.mark.parametrize("attempt", range(3))
def test_every_message_arrives_in_order_over_zenoh(log: LogFile, port: int, attempt: int) -> None:
    expected = list(log.messages())
    with ZenohBus("recorder", port) as listener:
        listener.subscribe_all()
        listener.announce()
        with ZenohBus("player", port) as bus:
            summary = play(log, bus, rate=None)
            arrived = take(listener.inbox, len(expected))
        assert not listener.inbox.lost
    assert not summary.skipped
    assert summary.sent == Counter(item.topic for item in expected)
    for name in summary.sent:
        before = [item for item in expected if item.topic == name]
        after = [item for item in arrived if item.topic == name]
        assert content(after) == content(before)
        assert [item.sequence for item in after] == list(range(1, len(before) + 1))


def test_a_late_subscriber_gets_what_is_latched(log: LogFile, port: int) -> None:
    with ZenohBus("player", port) as bus:
        play(log, bus, rate=None, include=[t.ROBOT_DESCRIPTION.name, t.TF_STATIC.name])
        with ZenohBus("viewer", port) as late:
            late.subscribe(t.ROBOT_DESCRIPTION, t.TF_STATIC)
            assert {item.topic for item in take(late.inbox, 2)} == {t.ROBOT_DESCRIPTION.name, t.TF_STATIC.name}


def test_only_the_topics_asked_for_are_played(log: LogFile) -> None:
    exchange = LocalExchange()
    listener = LocalBus(exchange, "recorder")
    listener.subscribe_all()
    summary = play(log, LocalBus(exchange, "player"), None, ["/search/*", "/attempt"])
    assert set(summary.sent) == {t.SEARCH_GOAL.name, t.CANDIDATE.name, t.SEARCH_RESULT.name, t.ATTEMPT.name}
    assert len(listener.inbox) == summary.sent.total()


def test_a_pattern_without_a_match_names_the_topics(log: LogFile) -> None:
    with pytest.raises(InputError, match=r"no topic .* matches '/atempt'; did you mean '/attempt'\?"):
        play(log, LocalBus(LocalExchange(), "player"), None, ["/atempt"])


def test_a_start_in_the_middle_restores_what_is_latched(log: LogFile) -> None:
    exchange = LocalExchange()
    listener = LocalBus(exchange, "recorder")
    listener.subscribe_all()
    middle = (log.start + log.end) // 2
    play(log, LocalBus(exchange, "player"), None, start=middle)
    arrived = take(listener.inbox, len(listener.inbox))
    early = [item for item in arrived if item.stamp < middle]
    assert arrived[: len(early)] == early
    last = {item.topic: item for item in log.messages(None, None, middle) if t.topics()[item.topic].latched}
    assert {item.topic: item.payload for item in early} == {name: item.payload for name, item in last.items()}
    assert t.ARM_STATUS.name in last
    assert content(arrived[len(early) :]) == content(list(log.messages(start=middle)))


def test_it_takes_the_time_that_was_recorded(log: LogFile) -> None:
    exchange = LocalExchange()
    rate = 20.0
    watch = Stopwatch()
    summary = play(log, LocalBus(exchange, "player"), rate)
    assert watch.seconds > (log.end - log.start) / 1e9 / rate - 1e-3  # never early, however busy the machine is
    assert summary.until == log.end


def test_it_stops_at_once_when_asked(log: LogFile) -> None:
    stop = threading.Event()
    exchange = LocalExchange()
    listener = LocalBus(exchange, "recorder")
    listener.subscribe(t.CLOCK)
    bus = LocalBus(exchange, "player")
    player = threading.Thread(target=play, args=(log, bus, 0.05), kwargs={"stop": stop})
    player.start()
    assert take(listener.inbox, 2)
    stop.set()
    player.join(30.0)
    assert not player.is_alive()
    assert sum(count.sent for count in bus.counts()) < 100


def test_a_type_nobody_knows_is_left_out_and_named(tmp_path: Path) -> None:
    path = tmp_path / "unknown.mcap"
    with LogWriter(path) as writer:
        writer.write(Envelope("/radar", "acme_msgs/msg/Radar", b"\x00\x01\x00\x00\x07", 5, 1, bytes(16)))
        writer.write(Envelope("/note", "std_msgs/msg/String", b"\x00\x01\x00\x00\x01\x00\x00\x00\x00", 6, 1, bytes(16)))
    with open_log(path) as log:
        summary = play(log, LocalBus(LocalExchange(), "player"), None)
    assert summary.sent == {"/note": 1}
    assert "acme_msgs/msg/Radar" in summary.skipped["/radar"]
    assert "/note" not in t.topics()
