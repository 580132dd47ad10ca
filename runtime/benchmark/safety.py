"""How fast a cell stops: beams broken at random moments of real attempts, judged by what the log says of the arm.

As fast as the machine allows, the breaks are scripted in session time, so that each is known to the nanosecond. At rate
1.0 somebody in another process breaks them in machine time, and the time to the stop is measured there: from when the
curtain took note until the arm's word of its stop was back, which is a way over the bus longer than the stop itself.
"""

from __future__ import annotations

import random
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from runtime import config
from runtime.benchmark.beam import Beam, LiveBreak
from runtime.benchmark.figures import percentile
from runtime.benchmark.safe_distance import minimum_distance
from runtime.benchmark.station import Station, stations
from runtime.benchmark.stops import Permits, Stop, motion_of, permits_of
from runtime.config import CellFile
from runtime.errors import InputError, SessionError
from runtime.follower import FailedSessionError, Progress, Session
from runtime.launcher import Order, launch
from runtime.log.file import LogFile, open_log
from runtime.messages import NANOSECONDS

REAL_TIME, FULL_SPEED = "1.0", "max"
PER_SESSION = 500  # breaks at most in one session: then another seed is due
_FIRST = 1.0  # [s] session time before the first break
_LAST = 0.5  # [s] after the last reset
_CLEAR = (0.02, 0.15)  # [s] after the break: a hand that is quick is gone before the arm stands
_RESET = (0.25, 0.35)  # [s] after that
_PAUSE = (0.1, 0.6)  # [s] between a reset and the next break
_BOARDS = 10_000  # more than a session gets to
_NOTHING_ELSE: Mapping[str, Any] = {"curtain_faults": [], "emergency_stops": [], "mutings": [], "resets": []}

Advance = Callable[[int], None]


@dataclass(frozen=True)
class Break:
    """A scripted break. Session times [ns]."""

    at: int
    clear: int
    reset: int

    @property
    def scripted(self) -> dict[str, str]:
        """The same as a cell file has it."""
        spans = {"at": self.at, "clear_after": self.clear - self.at, "reset_after": self.reset - self.clear}
        return {name: f"{span / NANOSECONDS:.9f} s" for name, span in spans.items()}


@dataclass
class Trials:
    """What came of all breaks at one rate."""

    rate: str
    stops: list[Stop] = field(default_factory=list)
    failed_sessions: list[str] = field(default_factory=list)  # why they ended before their time

    @property
    def stopped(self) -> list[Stop]:
        """Those that did."""
        return [stop for stop in self.stops if not stop.failure]

    @property
    def moving(self) -> list[Stop]:
        """Those that stopped an arm in motion."""
        return [stop for stop in self.stopped if stop.moving]

    @property
    def worst(self) -> float:
        """[s] from the beam to standstill."""
        return max((stop.standstill for stop in self.stopped), default=0.0)


@dataclass(frozen=True)
class Subject:
    """The cell that is measured."""

    cell: str  # a cell file or a shipped name
    overrides: Mapping[str, Any]
    seed: int  # of the first session, and of the moments
    port: int

    def session(self, number: int, rate: str, breaks: list[Break]) -> CellFile:
        """The cell file of a session. Raises InputError for a robot that is not simulated."""
        safety = {**_NOTHING_ELSE, "interruptions": [one.scripted for one in breaks]}
        changed = {"rate": rate, "boards": _BOARDS, "seed": self.seed + number, "safety": safety}
        found = config.load(self.cell, {**self.overrides, **changed, "bus": {"port": self.port}})
        if not getattr(config.robot_of(found.cell, found.name), "simulated", False):
            raise InputError(f"{found.name}: {found.cell.robot} is not simulated; its stops are measured at the robot")
        return found


def planned(count: int, draw: random.Random) -> list[Break]:
    """Breaks at random moments, one after the other."""
    breaks: list[Break] = []
    now = _FIRST
    for _ in range(count):
        moments = [now := now + draw.uniform(*span) for span in (_PAUSE, _CLEAR, _RESET)]
        breaks.append(Break(*(round(moment * NANOSECONDS) for moment in moments)))
    return breaks


def full_speed_trials(subject: Subject, count: int, advance: Advance) -> Trials:
    """Scripted breaks in as many sessions as they need; `advance` hears how many were made."""
    trials, number = Trials(FULL_SPEED), 0
    draw = random.Random(subject.seed)
    while len(trials.stops) < count:
        breaks = planned(min(PER_SESSION, count - len(trials.stops)), draw)
        before = len(trials.stops)
        with tempfile.TemporaryDirectory() as folder:
            log = _recorded(trials, subject.session(number, FULL_SPEED, breaks), Path(folder), _Script(breaks, advance))
            with open_log(log) as file:
                trials.stops += judged(file, breaks)
        if len(trials.stops) == before:
            raise SessionError(f"no beam was broken: {(trials.failed_sessions or ['the session was too short'])[-1]}")
        number += 1
    return trials


def judged(log: LogFile, breaks: list[Break]) -> list[Stop]:
    """What a log says of its scripted breaks, as far as it goes."""
    motion, permits = motion_of(log), permits_of(log)
    found = [(one, motion.stop(one.at, one.reset)) for one in breaks]
    return [_ordered(one, stop, permits) for one, stop in found if stop is not None]


def _ordered(one: Break, stop: Stop, permits: Permits) -> Stop:
    if permits.refused(one.at, one.reset):
        return stop
    return Stop(stop.moving, failure="the interlock did not refuse motion from the break to the reset")


@dataclass
class _Script:
    """Ends a session once its last break is over."""

    breaks: list[Break]
    advance: Advance
    done: int = 0

    def show(self, progress: Progress) -> bool:
        """Whether more is to come."""
        now = progress.session_time * NANOSECONDS
        over = sum(1 for one in self.breaks[self.done :] if one.reset < now)
        self.done += over
        self.advance(over)
        return self.done < len(self.breaks) or now < self.breaks[-1].reset + _LAST * NANOSECONDS


def real_time_trials(subject: Subject, count: int, advance: Advance) -> Trials:
    """Live breaks in one session at rate 1.0, or in more where one fails."""
    trials, number = Trials(REAL_TIME), 0
    while len(trials.stops) < count:
        cell_file, before = subject.session(number, REAL_TIME, []), len(trials.stops)
        with tempfile.TemporaryDirectory() as folder, stations() as begun:
            hand = _Hand(begun, cell_file, subject.seed + number, count - before, advance)
            log = _recorded(trials, cell_file, Path(folder), hand)
            with open_log(log) as file:
                trials.stops += witnessed(file, hand.breaks)
        if len(trials.stops) == before:
            raise SessionError(f"no beam was broken: {(trials.failed_sessions or ['the session was too short'])[-1]}")
        number += 1
    return trials


def witnessed(log: LogFile, breaks: list[LiveBreak]) -> list[Stop]:
    """What a log says of live breaks, as far as it goes, with the time that was measured before the stop."""
    motion, stops = motion_of(log), list[Stop]()
    for one in breaks:
        if one.failure:
            stops.append(Stop(moving=True, failure=one.failure))
        elif (stop := motion.stop(one.told - motion.period, one.reset)) is not None:
            stops.append(stop if stop.failure else stop.later(one.delay))
    return stops


@dataclass
class _Hand:
    """Breaks the beam again and again, one break for each look at the session."""

    begun: list[Station]
    cell_file: CellFile
    seed: int
    count: int
    advance: Advance
    breaks: list[LiveBreak] = field(default_factory=list)

    def show(self, progress: Progress) -> bool:
        """Whether more is to come."""
        if progress.session_time < _FIRST:
            return True
        if not self.begun:
            self.begun.append(Station("the hand in the curtain", Beam, self.cell_file.meeting_point, self.seed))
            self.begun[0].answer()
        if len(self.breaks) == self.count:
            return progress.session_time * NANOSECONDS < self.breaks[-1].reset + _LAST * NANOSECONDS
        self.breaks.append(self.begun[0].ask("reach_in"))
        self.advance(1)
        return True


def _recorded(trials: Trials, cell_file: CellFile, folder: Path, course: _Script | _Hand) -> Path:
    """Run a session until its course is over; where its log is. Raises KeyboardInterrupt if the user ends it."""
    over = False

    def show(progress: Progress) -> None:
        nonlocal over
        over = over or not course.show(progress)
        if over:
            raise KeyboardInterrupt  # as an operator ends a session: every plugin closes in order

    session: Session
    try:
        session = launch(Order(cell_file, folder, fresh=True), show)
    except FailedSessionError as failed:
        session = failed.session
        trials.failed_sessions.append(str(failed))
    if session.interrupted and not over:
        raise KeyboardInterrupt
    return session.log


def figures_of(measured: list[Trials], resolution: float, response: float) -> dict[str, float]:
    """All figures by name: those without a prefix are at rate 1.0 where that was measured, `trials` and `stopped` of
    all. `resolution` [m] and `response` [s] are the curtain's.
    """
    total = Trials("all", [stop for trials in measured for stop in trials.stops])
    figures = {"trials": float(len(total.stops)), "stopped": float(len(total.stopped))}
    plain = next((trials for trials in measured if trials.rate == REAL_TIME), measured[0])
    for trials in measured:
        prefix = "real_time_" if trials.rate == REAL_TIME else "full_speed_"
        figures |= {
            f"{prefix}trials": float(len(trials.stops)),
            f"{prefix}stopped": float(len(trials.stopped)),
            f"{prefix}moving": float(len(trials.moving)),
            f"{prefix}standing": float(len(trials.stopped) - len(trials.moving)),
        }
        figures |= _times(trials, prefix)
    figures |= _times(plain, "")
    stop_time = total.worst + response
    return figures | {
        "response_ms": 1e3 * response,
        "resolution_mm": 1e3 * resolution,
        "stop_time_ms": 1e3 * stop_time,
        "safe_distance_mm": 1e3 * minimum_distance(stop_time, resolution),
    }


def _times(trials: Trials, prefix: str) -> dict[str, float]:
    """Percentiles over the arms that were in motion; none if there were none."""
    moving = trials.moving
    if not moving:
        return {}
    figures: dict[str, float] = {}
    for name in ("command", "standstill"):
        times = [1e3 * getattr(stop, name) for stop in moving]
        for key, share in (("p50", 0.5), ("p99", 0.99), ("worst", 1.0)):
            figures[f"{prefix}{name}_{key}_ms"] = percentile(times, share)
    return figures
