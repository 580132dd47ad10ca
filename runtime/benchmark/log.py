"""Measures how fast every contender writes a log, in turn, in small rounds, so that all meet the same machine."""

from __future__ import annotations

import statistics
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from runtime.benchmark.bus import RouterPart
from runtime.benchmark.figures import ratio, shares
from runtime.benchmark.log_contenders import (
    LOG_WRITER,
    RAW_MCAP,
    RECORDER,
    FloodPart,
    LogContender,
    RecorderPart,
    WriterPart,
    Written,
    lost_in,
)
from runtime.benchmark.station import Station, stations
from runtime.clock import Stopwatch
from runtime.log.file import open_log
from runtime.network.meeting_point import free_port

ROUNDS = 5


@dataclass
class LogResult:
    """What was measured of one contender, by round."""

    contender: LogContender
    files: list[Written] = field(default_factory=list)

    @property
    def rates(self) -> list[float]:
        """Messages per second of each round."""
        return [(file.messages - file.lost) / file.seconds for file in self.files]

    @property
    def rate(self) -> float:
        """Messages per second, the median over the rounds."""
        return statistics.median(self.rates)

    @property
    def messages(self) -> int:
        """Messages of all rounds."""
        return sum(file.messages for file in self.files)

    @property
    def lost(self) -> int:
        """Messages that are in no file."""
        return sum(file.lost for file in self.files)

    @property
    def processor_per_10000(self) -> float:
        """Seconds that the writing process computes for 10 000 messages."""
        return 1e4 * sum(file.processor for file in self.files) / self.messages

    @property
    def bytes_per_message(self) -> float:
        """On disk, with all indexes."""
        return sum(file.size for file in self.files) / self.messages

    def figures(self) -> dict[str, float]:
        """By name, the contender's first."""
        key = self.contender.key
        return {
            f"{key}_msgs_per_s": self.rate,
            f"{key}_lost": float(self.lost),
            f"{key}_cpu_s_per_10000": self.processor_per_10000,
            f"{key}_msgs_per_cpu_s": 1e4 / self.processor_per_10000,
            f"{key}_bytes_per_message": self.bytes_per_message,
        }


@dataclass
class ReadResult:
    """Messages per second read in time order, by round, from a file that palpate wrote."""

    ours: list[float] = field(default_factory=list)
    theirs: list[float] = field(default_factory=list)


@dataclass
class _Bench:
    """The processes at work, and the folder they write into."""

    folder: Path
    writer: Station
    crew: list[Station]
    _recording: tuple[Station, Station] | None = None

    def write(self, key: str, count: int) -> tuple[Path, Written]:
        path = self.folder / f"{key}.mcap"
        path.unlink(missing_ok=True)
        return path, self._record(path, count) if key == RECORDER else self.writer.ask("write", key, path, count)

    def _record(self, path: Path, count: int) -> Written:
        recorder, flood = self._recording or self._start()
        recorder.ask("begin", path)
        began = flood.ask("flood", count)
        ended, processor = recorder.ask("finish")
        return Written(count, lost_in(path), ended - began, processor, path.stat().st_size)

    def _start(self) -> tuple[Station, Station]:
        port = free_port()
        router = Station("the router", RouterPart, port)
        recorder, flood = Station("recorder", RecorderPart, port), Station("flood", FloodPart, port)
        self.crew += [router, recorder, flood]
        for station in (router, recorder, flood):
            station.answer()
        self._recording = (recorder, flood)
        return self._recording


def measure_log(
    contenders: Sequence[LogContender], messages: int, advance: Callable[[str], None]
) -> tuple[list[LogResult], ReadResult]:
    """Let each contender write `messages` in all. `advance` is told after each step.

    Raises SessionError if a contender fails.
    """
    results, reading = [LogResult(contender) for contender in contenders], ReadResult()
    with tempfile.TemporaryDirectory(prefix="palpate-") as folder, stations() as crew:
        writer = Station("the writer", WriterPart)
        crew.append(writer)
        writer.answer()
        bench = _Bench(Path(folder), writer, crew)
        for contender in contenders:  # what is loaded or compiled at the first message is no part of the figures
            bench.write(contender.key, max(100, messages // 100))
            advance(contender.label)
        for count in shares(messages, ROUNDS):
            for result in results:
                path, written = bench.write(result.contender.key, count)
                result.files.append(written)
                if result.contender.key == LOG_WRITER:
                    ours, theirs = writer.ask("read", path)
                    reading.ours.append(ours)
                    reading.theirs.append(theirs)
                advance(result.contender.label)
    return results, reading


def steps(contenders: int) -> int:
    """How many times `measure_log` advances."""
    return contenders * (1 + ROUNDS)


def log_figures(results: Sequence[LogResult], reading: ReadResult) -> dict[str, float]:
    """All figures by name."""
    found: dict[str, float] = {}
    for result in results:
        found |= result.figures()
    by_key = {result.contender.key: result for result in results}
    if RECORDER in by_key and RAW_MCAP in by_key:
        found["recorder_ratio"] = ratio(by_key[RECORDER].rates, by_key[RAW_MCAP].rates)
    if reading.ours:
        found["read_msgs_per_s"] = statistics.median(reading.ours)
        found["raw_read_msgs_per_s"] = statistics.median(reading.theirs)
        found["read_ratio"] = ratio(reading.ours, reading.theirs)
    return found


def time_to_open(path: Path) -> dict[str, float]:
    """Seconds until a finished log is indexed, and until it stands as a file that Rerun opens at once.

    Raises LogError for a log that cannot be read.
    """
    from runtime.view.log import convert

    with tempfile.TemporaryDirectory(prefix="palpate-") as folder:
        watch = Stopwatch()
        with open_log(path) as log:
            indexed = watch.seconds
            from runtime.view.log import convert  # to load Rerun belongs to the wait

            convert(log, Path(folder) / "view.rrd")
            opened = watch.seconds
            messages = sum(topic.count for topic in log.topics)
    return {"view_index_s": indexed, "view_open_s": opened, "view_messages": float(messages)}
