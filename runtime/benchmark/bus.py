"""Measures round trips and floods of every contender in turn, in small rounds, so that all meet the same machine."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice

from runtime.benchmark.bus_contenders import CONTENDERS, PALPATE, RAW, BusContender
from runtime.benchmark.ends import Ports
from runtime.benchmark.figures import percentile, processor_time, ratio, shares
from runtime.benchmark.station import Station, stations
from runtime.clock import Stopwatch, pause
from runtime.errors import SessionError
from runtime.network.meeting_point import free_port
from runtime.network.zenoh_bus import ZenohRouter

PAIRS = 3  # of processes that a contender has one after the other: each pair has luck of its own with the machine
ROUNDS = 4  # with each pair
SHORT = 10_000  # messages; a measurement with fewer has one pair
TRIPS = 20  # messages of a flood for each round trip
WARM_UP = 50  # round trips
_REPLY = 1.0  # [s] after which an answer counts as lost
_QUIET = 3.0  # [s] without an arrival after which nothing more is expected
_MEETING = 20.0  # [s] for two ends to find each other
_LOOK = 0.01  # [s] between looks whether they did


@dataclass(frozen=True)
class Flood:
    """What became of messages that were sent as fast as could be."""

    sent: int
    delivered: int
    seconds: float  # from the first that was sent to the last that arrived
    processor: float  # [s] computed by both ends and the router

    @property
    def rate(self) -> float:
        """Messages delivered per second."""
        return self.delivered / self.seconds if self.seconds > 0 else 0.0


@dataclass
class BusResult:
    """What was measured of one contender, by round."""

    contender: BusContender
    trips: list[list[float]] = field(default_factory=list)  # [s]
    unanswered: int = 0
    floods: list[Flood] = field(default_factory=list)

    @property
    def medians(self) -> list[float]:
        """Median round trip of each round [s]."""
        return [statistics.median(trips) for trips in self.trips]

    def trip(self, share: float) -> float:
        """The time [s] that this share of all round trips does not exceed."""
        return percentile([seconds for trips in self.trips for seconds in trips], share)

    @property
    def delivered_per_second(self) -> float:
        """Median over the rounds."""
        return statistics.median(flood.rate for flood in self.floods)

    @property
    def lost(self) -> int:
        """Messages of all floods that never arrived."""
        return sum(flood.sent - flood.delivered for flood in self.floods)

    @property
    def processor_per_10000(self) -> float:
        """Seconds computed by both ends and the router for 10 000 messages of a flood that arrived."""
        delivered = sum(flood.delivered for flood in self.floods)
        return 1e4 * sum(flood.processor for flood in self.floods) / max(delivered, 1)

    def figures(self) -> dict[str, float]:
        """By name, without the prefix that tells contenders apart."""
        return {
            "rtt_p50_us": 1e6 * self.trip(0.5),
            "rtt_p99_us": 1e6 * self.trip(0.99),
            "flood_delivered_per_s": self.delivered_per_second,
            "flood_lost": float(self.lost),
            "flood_cpu_s_per_10000": self.processor_per_10000,
        }


class RouterPart:
    """The cell's router, which palpate and raw Zenoh meet at."""

    def __init__(self, port: int) -> None:
        self._router = ZenohRouter(port)

    def processor_time(self) -> float:
        """What the router has computed so far [s]."""
        return processor_time()

    def close(self) -> None:
        """Stop routing."""
        self._router.close()


class EndPart:
    """One end of a contender in its process. Messages are numbered on from 1 over all rounds."""

    def __init__(self, key: str, near: bool, ports: Ports) -> None:
        self._end = CONTENDERS[key].make(near, ports)

    def meet(self) -> None:
        """Wait until the other end is known to listen."""
        watch = Stopwatch()
        while not self._end.heard:
            if watch.seconds > _MEETING:
                raise SessionError(f"the two ends did not find each other within {_MEETING:g} s")
            pause(_LOOK)

    def round_trips(self, first: int, count: int) -> tuple[list[float], int]:
        """Near: times [s] from before a message is encoded to after its echo is decoded, and how many never came."""
        times: list[float] = []
        for number in range(first, first + count):
            message = self._end.message(number)
            watch = Stopwatch()
            self._end.send(message)
            while (reply := self._end.receive(_REPLY)) is not None:
                if reply.header.stamp.nanosec == number:
                    times.append(watch.seconds)
                    break
        return times, count - len(times)

    def echo(self, first: int, count: int) -> None:
        """Far: send back what arrives, up to the last of these numbers."""
        while (message := self._end.receive(_QUIET)) is not None:
            self._end.send(message)
            if message.header.stamp.nanosec == first + count - 1:
                return

    def push(self, first: int, count: int) -> float:
        """Near: send these as fast as can be, and one more as the end. Returns when that began [s]."""
        messages = [self._end.message(number) for number in range(first, first + count + 1)]
        watch = Stopwatch()
        for message in messages:
            self._end.send(message)
        return watch.started

    def take(self, first: int, count: int) -> tuple[int, float]:
        """Far: how many of these arrived, and when the last one did [s]."""
        delivered, last = 0, Stopwatch()
        while (message := self._end.receive(_QUIET)) is not None:
            number = message.header.stamp.nanosec
            if first <= number < first + count:
                delivered += 1
                last = Stopwatch()
            elif number == first + count:
                break
        return delivered, last.started

    def processor_time(self) -> float:
        """What this end has computed so far [s]."""
        return processor_time()

    def close(self) -> None:
        """Leave."""
        self._end.close()


@dataclass
class _Line:
    """Both ends of a contender, and the number of its next message."""

    result: BusResult
    near: Station
    far: Station
    router: Station
    next: int = 1

    def connect(self) -> None:
        """Wait until both ends are there and have found each other, and warm up."""
        for end in (self.near, self.far):
            end.answer()
            end.ask("meet")
        numbers = self._numbers(WARM_UP)
        self.far.start("echo", *numbers)
        self.near.ask("round_trips", *numbers)
        self.far.answer()

    def _numbers(self, count: int) -> tuple[int, int]:
        first, self.next = self.next, self.next + count
        return first, count

    def measure_trips(self, count: int) -> None:
        numbers = self._numbers(count)
        self.far.start("echo", *numbers)
        times, unanswered = self.near.ask("round_trips", *numbers)
        self.far.answer()
        if not times:
            raise SessionError(f"{self.result.contender.label}: none of {count} messages was answered")
        self.result.trips.append(times)
        self.result.unanswered += unanswered

    def measure_flood(self, count: int) -> None:
        numbers = self._numbers(count)
        self.next += 1  # the one that ends the flood
        before = self._processor_time()
        self.far.start("take", *numbers)
        began = self.near.ask("push", *numbers)
        delivered, ended = self.far.answer()
        self.result.floods.append(Flood(count, delivered, ended - began, self._processor_time() - before))

    def _processor_time(self) -> float:
        return float(sum(part.ask("processor_time") for part in (self.near, self.far, self.router)))


def measure_bus(
    contenders: Sequence[BusContender], messages: int, trips: int, port: int | None, advance: Callable[[str], None]
) -> list[BusResult]:
    """Flood each contender with `messages` in all and send `trips` to and fro. `advance` is told after each step.

    Raises SessionError if a contender fails.
    """
    results = [BusResult(contender) for contender in contenders]
    count = pairs(messages)
    rounds = zip(shares(trips, count * ROUNDS), shares(messages, count * ROUNDS), strict=True)
    for _ in range(count):
        with stations() as crew:
            lines = _connected(crew, results, port, advance)
            for trip_count, flood_count in islice(rounds, ROUNDS):
                for line in lines:
                    line.measure_trips(trip_count)
                    advance(line.result.contender.label)
                for line in lines:
                    line.measure_flood(flood_count)
                    advance(line.result.contender.label)
    return results


def _connected(
    crew: list[Station], results: Sequence[BusResult], port: int | None, advance: Callable[[str], None]
) -> list[_Line]:
    """Start the processes of all contenders."""
    ports = Ports(*(free_port() for _ in range(4)))
    if port is not None:
        ports = replace(ports, router=port)
    router = Station("the router", RouterPart, ports.router)
    crew.append(router)
    router.answer()
    lines: list[_Line] = []
    for result in results:
        contender = result.contender
        far, near = (
            Station(f"{contender.label}, {'near' if near else 'far'} end", EndPart, contender.key, near, ports)
            for near in (False, True)
        )
        crew += [far, near]
        lines.append(_Line(result, near, far, router))
    for line in lines:
        line.connect()
        advance(line.result.contender.label)
    return lines


def pairs(messages: int) -> int:
    """How many pairs of processes a contender has, one after the other."""
    return PAIRS if messages >= SHORT else 1


def steps(contenders: int, messages: int) -> int:
    """How many times `measure_bus` advances."""
    return pairs(messages) * contenders * (1 + 2 * ROUNDS)


def bus_figures(results: Sequence[BusResult]) -> dict[str, float]:
    """All figures by name: palpate's own without a prefix, and the ratio to raw Zenoh."""
    by_key = {result.contender.key: result for result in results}
    found: dict[str, float] = {}
    for key, result in by_key.items():
        prefix = "" if key == PALPATE else f"{key}_"
        found |= {f"{prefix}{name}": value for name, value in result.figures().items()}
    ours = by_key.get(PALPATE)
    for key, result in by_key.items():
        if ours is not None and result is not ours:
            name = "rtt_ratio" if key == RAW else f"rtt_ratio_{key}"
            found[name] = ratio(ours.medians, result.medians)
    return found
