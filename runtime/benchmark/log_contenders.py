"""The contenders of `palpate bench log`: how each writes joint states of ten topics into one MCAP file.

All write chunks of the same size, compressed alike, with index and check sums, and close the file.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from runtime.benchmark.figures import processor_time
from runtime.benchmark.installed import missing
from runtime.benchmark.sample import LOGGED, payloads
from runtime.bus import Bus, Envelope, encode
from runtime.cell import Board
from runtime.clock import Stopwatch, pause
from runtime.config import Cell
from runtime.context import Context
from runtime.declaration import type_name
from runtime.errors import SessionError
from runtime.local_bus import LocalBus, LocalExchange
from runtime.log.file import open_log
from runtime.log.writer import CHUNK_SIZE, PROFILE, SUMMARY, LogWriter
from runtime.messages import JointState, PublisherCount, PublisherCounts, header, typestore
from runtime.network.zenoh_bus import ZenohBus
from runtime.recorder import Recorder
from runtime.topics import COUNTS

PERIOD = 100_000  # [ns] between two messages
_PUBLISHER = bytes(range(16))
FLOODS = "arm"  # the role whose part the flood plays: a recorder believes the last word of a cell's own plugins
_MEETING = 20.0  # [s] for the flood to hear of the recorder
_LOOK = 0.01  # [s] between looks whether it did


@dataclass(frozen=True)
class Written:
    """One file that a contender wrote."""

    messages: int
    lost: int
    seconds: float  # from the first message to the closed file
    processor: float  # [s] computed by the process that wrote
    size: int  # [byte]


def envelopes(count: int) -> list[Envelope]:
    """Messages as a bus delivers them."""
    ros_type = type_name(JointState)
    return [
        Envelope(
            LOGGED[number % len(LOGGED)].name,
            ros_type,
            payload,
            number * PERIOD,
            number // len(LOGGED) + 1,
            _PUBLISHER,
        )
        for number, payload in enumerate(payloads(count))
    ]


def _surroundings(role: str, bus: Bus) -> Context:
    return Context(role, bus, Cell(board=Board("none", ())), "bench")


class WriterPart:
    """Writes and reads files in its process."""

    def write(self, key: str, path: Path, count: int) -> Written:
        """Let a contender write a file of `count` messages."""
        return WRITERS[key](path, envelopes(count))

    def read(self, path: Path) -> tuple[float, float]:
        """Messages per second that palpate and the bare mcap reader read in time order."""
        from mcap.reader import make_reader

        watch = Stopwatch()
        with open_log(path) as log:
            ours = sum(1 for _ in log.messages()) / watch.seconds
        watch = Stopwatch()
        with path.open("rb") as file:
            theirs = sum(1 for _ in make_reader(file).iter_messages()) / watch.seconds
        return ours, theirs

    def close(self) -> None:
        """Nothing is held."""


def _measured(path: Path, messages: int, work: Callable[[], int]) -> Written:
    """Time `work`, which tells how many messages it lost."""
    before, watch = processor_time(), Stopwatch()
    lost = work()
    return Written(messages, lost, watch.seconds, processor_time() - before, path.stat().st_size)


def _by_log_writer(path: Path, messages: list[Envelope]) -> Written:
    def work() -> int:
        with LogWriter(path) as log:
            for envelope in messages:
                log.write(envelope)
        return len(messages) - log.messages

    return _measured(path, len(messages), work)


def _by_recorder(path: Path, messages: list[Envelope]) -> Written:
    """The whole recorder, whose inbox is full already."""
    bus = LocalBus(LocalExchange(), "recorder")
    context = _surroundings("recorder", bus)
    for envelope in messages:
        bus.inbox.put(envelope)
    counts = [
        PublisherCount(topic.name, sum(envelope.topic == topic.name for envelope in messages)) for topic in LOGGED
    ]
    last_word = encode(PublisherCounts(header(messages[-1].stamp), FLOODS, counts))
    bus.inbox.put(Envelope(COUNTS.name, type_name(COUNTS.type), last_word, messages[-1].stamp, 1, _PUBLISHER))
    context.stop()

    def work() -> int:
        Recorder(path).run(context)
        return lost_in(path)

    return _measured(path, len(messages), work)


def lost_in(path: Path) -> int:
    """Messages that a finished recording says it never got."""
    with open_log(path) as log:
        return int(log.metadata[SUMMARY]["lost"])


def _definition() -> bytes:
    text, _ = typestore().generate_msgdef(type_name(JointState), ros_version=2)
    return text.encode()


def _by_mcap(path: Path, messages: list[Envelope]) -> Written:
    from mcap.writer import Writer

    def work() -> int:
        with path.open("xb") as file:
            writer: Any = Writer(file, chunk_size=CHUNK_SIZE)
            writer.start(PROFILE)
            schema = writer.register_schema(type_name(JointState), "ros2msg", _definition())
            channels = {topic.name: writer.register_channel(topic.name, "cdr", schema) for topic in LOGGED}
            for item in messages:
                writer.add_message(channels[item.topic], item.stamp, item.payload, item.stamp, item.sequence)
            writer.finish()
        return 0

    return _measured(path, len(messages), work)


def _by_foxglove(path: Path, messages: list[Envelope]) -> Written:
    import foxglove
    from foxglove.mcap import MCAPCompression, MCAPWriteOptions

    def work() -> int:
        context = foxglove.Context()
        options = MCAPWriteOptions(compression=MCAPCompression.Zstd, profile=PROFILE, chunk_size=CHUNK_SIZE)
        with foxglove.open_mcap(path, context=context, writer_options=options):
            schema = foxglove.Schema(name=type_name(JointState), encoding="ros2msg", data=_definition())
            channels = {
                topic.name: foxglove.Channel(topic.name, schema=schema, message_encoding="cdr", context=context)
                for topic in LOGGED
            }
            for item in messages:
                channels[item.topic].log(item.payload, log_time=item.stamp)
        return 0

    return _measured(path, len(messages), work)


class RecorderPart:
    """A cell's recorder on Zenoh in its process."""

    def __init__(self, port: int) -> None:
        self._port = port
        self._work: threading.Thread | None = None
        self._stop: Callable[[], None] = lambda: None
        self._failure: Exception | None = None
        self._ended = 0.0
        self._before = 0.0

    def begin(self, path: Path) -> None:
        """Record until told to finish."""
        bus = ZenohBus("recorder", self._port)
        context = _surroundings("recorder", bus)

        def work() -> None:
            try:
                with bus:
                    Recorder(path).run(context)
            except Exception as error:
                self._failure = error
            self._ended = Stopwatch().started

        self._failure, self._stop, self._before = None, context.stop, processor_time()
        self._work = threading.Thread(target=work, daemon=True)
        self._work.start()

    def finish(self) -> tuple[float, float]:
        """When the file was closed [s], and what has been computed for it [s]."""
        assert self._work is not None, "it was begun"
        self._stop()
        self._work.join()
        if self._failure is not None:
            raise SessionError(f"the recorder failed: {self._failure}")
        return self._ended, processor_time() - self._before

    def close(self) -> None:
        """End without finishing."""
        self._stop()


class FloodPart:
    """A plugin that publishes as fast as the bus takes it."""

    def __init__(self, port: int) -> None:
        self._port = port

    def flood(self, count: int) -> float:
        """Publish so many messages. Returns when that began [s]."""
        messages = payloads(count)
        with ZenohBus(FLOODS, self._port) as bus:
            context = _surroundings(FLOODS, bus)
            publishers = [bus.publisher(topic) for topic in LOGGED]
            context.ready()
            watch = Stopwatch()
            while not all(publisher.matched for publisher in publishers):
                if watch.seconds > _MEETING:
                    raise SessionError(f"nobody listened within {_MEETING:g} s")
                pause(_LOOK)
            watch = Stopwatch()
            for number, payload in enumerate(messages):
                context.clock.advance(number * PERIOD)
                publishers[number % len(publishers)].send_raw(payload, number * PERIOD)
            context.close()
        return watch.started

    def close(self) -> None:
        """Nothing is held."""


@dataclass(frozen=True)
class LogContender:
    """One way to write a log."""

    key: str  # in the figures
    label: str
    needs: tuple[str, ...] = ()  # modules
    install: str = ""  # what pip installs them from

    @property
    def missing(self) -> str:
        """What to do to have it; empty if it is there."""
        return missing(self.needs, self.install)


RECORDER = "recorder"  # writes what comes over Zenoh
RAW_MCAP = "raw_mcap"
LOG_WRITER = "log_writer"
WRITERS: dict[str, Callable[[Path, list[Envelope]], Written]] = {
    LOG_WRITER: _by_log_writer,
    "recorder_inbox": _by_recorder,
    RAW_MCAP: _by_mcap,
    "foxglove": _by_foxglove,
}
LOG_CONTENDERS = {
    contender.key: contender
    for contender in (
        LogContender(RECORDER, "palpate recorder, from Zenoh"),
        LogContender("recorder_inbox", "palpate recorder, from inbox"),
        LogContender(LOG_WRITER, "palpate log writer"),
        LogContender(RAW_MCAP, "mcap writer"),
        LogContender("foxglove", "foxglove-sdk writer", ("foxglove",), "foxglove-sdk"),
    )
}
