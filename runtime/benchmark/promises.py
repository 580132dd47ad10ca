"""What a cell owes whatever goes wrong, judged from outside once it has ended.

The arm stops where its permits end. The log can be read, or is mended by `palpate recover`, and says what it lacks. All
that the posterior said was on record is in the store. The cell did its job, or ended with one clear line; no process is
left.
"""

from __future__ import annotations

import json
import math
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.benchmark.small_cell import Ending, Heard, SmallCell
from runtime.bus import Envelope, decode
from runtime.errors import BusError, PalpateError
from runtime.evidence.file import Access
from runtime.evidence.store import PosteriorStore
from runtime.log.file import LogFile, open_log
from runtime.log.recovery import recover
from runtime.log.writer import SESSION_RECORD, SUMMARY
from runtime.messages import NANOSECONDS, nanoseconds_of
from runtime.topics import BELIEF, PERMIT, SEARCH_GOAL, SEARCH_RESULT, TRACE, Topic

STOP_LIMIT = 0.1  # [s] of session time from the end of the last permit until every joint is commanded to stand
_TOLERANCE = 0.2  # [s] of machine time by which a permit may be heard after what was done by it
_JOINTS = 6


@dataclass(frozen=True)
class Verdict:
    """What became of a cell."""

    recovered: bool  # it did its whole job
    line: str = ""  # what it said at its end, if it failed
    stop: float | None = None  # [s] worst, after the end of a permit in motion; None: none ended in motion
    lost: int = 0  # searches on record that the store lacks or has in part
    unreadable: int = 0  # logs
    left: int = 0  # processes
    broken: tuple[str, ...] = ()  # promises

    def and_of(self, other: Verdict) -> Verdict:
        """Of this cell and of another together."""
        stops = [stop for stop in (self.stop, other.stop) if stop is not None]
        return Verdict(
            self.recovered and other.recovered,
            "; ".join(filter(None, (self.line, other.line))),
            max(stops, default=None),
            self.lost + other.lost,
            self.unreadable + other.unreadable,
            self.left + other.left,
            self.broken + other.broken,
        )


@dataclass
class _Record:
    """All that is known of a session, from its log and from who listened."""

    strangers: frozenset[bytes]  # publishers that are none of its plugins
    session: str = ""  # under which its evidence is kept
    heard: dict[str, list[Heard]] = field(default_factory=lambda: defaultdict(list))
    recorded: dict[str, list[Envelope]] = field(default_factory=lambda: defaultdict(list))

    def dated(self, topic: Topic[Any]) -> Iterator[tuple[float, Any]]:
        """What the cell's own plugins said on a topic, and when it came.

        In machine time [s]; minus infinity for what the log alone has. A log does not tell who said something: beside
        strangers, what the log alone has is left out.
        """
        heard = self.heard[topic.name]
        known = {(one.item.sequence, one.item.payload) for one in heard}
        for one in heard:
            if one.item.publisher not in self.strangers:
                yield one.at, decode(one.item.payload, topic.type)
        for item in self.recorded[topic.name]:
            if not self.strangers and (item.sequence, item.payload) not in known:
                yield -math.inf, decode(item.payload, topic.type)

    def of(self, topic: Topic[Any]) -> Iterator[Any]:
        """The same without their times."""
        return (message for _, message in self.dated(topic))


_JUDGED: tuple[Topic[Any], ...] = (TRACE, PERMIT, BELIEF, SEARCH_GOAL, SEARCH_RESULT)


def judge(cell: SmallCell, ending: Ending, limit: float, *, killed: bool = False) -> Verdict:
    """The verdict on a cell that had `limit` seconds to end, and whose launcher was `killed` or not."""
    broken: list[str] = []
    record = _Record(frozenset(cell.strangers))
    unreadable = 0
    for topic in _JUDGED:
        record.heard[topic.name] = cell.ear.heard(topic)
    try:
        _read_log(cell, record)
    except PalpateError as error:
        unreadable = 1
        broken.append(f"the log: {error}")
    done = sum(1 for _ in record.of(SEARCH_RESULT))
    recovered = ending.code == 0 and done >= cell.searches
    if ending.code == 0 and not recovered:
        broken.append(f"it ended as if all was well, after {done} of {cell.searches} searches")
    elif ending.code is None:
        broken.append(f"it had not ended after {limit:g} s")
    elif not (recovered or killed) and not (ending.line and ending.code == 1):
        broken.append(f"it ended with code {ending.code} and said: {' / '.join(ending.errors) or 'nothing'}")
    elif recovered and ending.errors:
        broken.append(f"it said though nothing failed: {' / '.join(ending.errors)}")
    if ending.left:
        broken.append(f"{ending.left} processes were left")
    stop, unstopped = stops_of(list(record.dated(TRACE)), list(record.dated(PERMIT)))
    broken += unstopped
    lost = _lost(cell.store, record)
    if lost:
        broken.append(f"searches on record are not in the store: {', '.join(map(str, lost))}")
    return Verdict(
        recovered,
        "" if recovered else ending.line or ("killed" if killed else "no end"),
        stop,
        len(lost),
        unreadable,
        ending.left,
        tuple(broken),
    )


def _read_log(cell: SmallCell, record: _Record) -> None:
    """Read what the log says, mended first if it has to be. Raises PalpateError where it cannot be."""
    path = cell.log
    if path is None or path.stat().st_size == 0:  # the recorder never came to it
        return
    with open_log(path) as log:
        complete = log.complete
        _take(log, record)
    if not complete:
        recover(path)
    with open_log(path) as log:
        log.check_complete("though it was recovered")
        log.check_sound()
        _check_losses(log)


def _take(log: LogFile, record: _Record) -> None:
    record.session = log.metadata.get(SESSION_RECORD, {}).get("evidence_session", "")
    for item in log.messages([topic.name for topic in _JUDGED]):
        record.recorded[item.topic].append(item)


def _check_losses(log: LogFile) -> None:
    """Raise PalpateError if messages are missing of which the log does not tell."""
    last: dict[tuple[str, bytes], int] = {}
    missing: dict[str, int] = defaultdict(int)
    for item in sorted(log.messages(), key=lambda item: item.sequence):
        key = (item.topic, item.publisher)
        missing[item.topic] += max(0, item.sequence - last.get(key, 0) - 1)
        last[key] = item.sequence
    told = json.loads(log.metadata.get(SUMMARY, {}).get("lost_topics", "{}"))
    for topic, count in missing.items():
        if count > told.get(topic, 0):
            raise BusError(f"{count} messages of {topic} are missing, and it tells of {told.get(topic, 0)}")


def stops_of(
    traces: Sequence[tuple[float, Any]], permits: Sequence[tuple[float, Any]]
) -> tuple[float | None, list[str]]:
    """Worst time [s] from the end of a permit to standstill, None if none ended in motion; and stops that were none.

    Both come with the machine time [s] at which they were heard: an interlock that stood still speaks later of the time
    that has passed meanwhile, and nobody can have moved by that.
    """
    begins, speeds, heard = _commanded(traces)
    if not len(begins):
        return None, []
    covered = np.zeros(len(begins), dtype=bool)
    for at, permit in permits:
        if permit.granted:
            since, until = nanoseconds_of(permit.header.stamp), nanoseconds_of(permit.valid_until)
            meant = slice(np.searchsorted(begins, since), np.searchsorted(begins, until))
            covered[meant] |= heard[meant] >= at - _TOLERANCE
    worst, broken = None, []
    edges = np.flatnonzero(np.diff(np.concatenate(([1], covered.astype(int), [1]))))
    for first, end in zip(edges[::2], edges[1::2], strict=True):
        before = speeds[first - 1] if first else 0.0
        run = speeds[first:end]
        moving = np.flatnonzero(run > 0)
        if not len(moving):
            worst = max(worst or 0.0, 0.0) if before > 0 else worst
            continue
        took = float(begins[first + moving[-1]] - begins[first]) / NANOSECONDS + _cycle(begins)
        worst = max(worst or 0.0, took)
        when = begins[first] / NANOSECONDS
        if before == 0:
            broken.append(f"the arm began to move without a permit after {when:.3f} s")
        elif took > STOP_LIMIT:
            broken.append(f"the arm moved for {1e3 * took:.0f} ms without a permit from {when:.3f} s on")
    return worst, broken


def _commanded(
    traces: Sequence[tuple[float, Any]],
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Of every control cycle: its begin [ns], the speed of its fastest joint [rad/s], and when it was told of [s]."""
    pieces = {nanoseconds_of(trace.header.stamp): (at, trace) for at, trace in traces}
    begins, targets, heard, period = [], [], [], 0
    for first, (at, trace) in sorted(pieces.items()):
        period = round(trace.period * NANOSECONDS)
        rows = np.asarray(trace.target).reshape(-1, _JOINTS)
        begins.append(first + period * np.arange(-1, len(rows) - 1))
        targets.append(rows)
        heard.append(np.full(len(rows), at if math.isfinite(at) else math.inf))
    if not begins:
        return np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0)
    moments, angles = np.concatenate(begins), np.vstack(targets)
    speeds = np.abs(np.diff(angles, axis=0)).max(axis=1) / (period / NANOSECONDS)
    follows = np.diff(moments) == period  # across a gap nothing can be said
    return moments[1:][follows], speeds[follows], np.concatenate(heard)[1:][follows]


def _cycle(begins: NDArray[np.int64]) -> float:
    return float(np.diff(begins).min()) / NANOSECONDS if len(begins) > 1 else 0.0


def _lost(store: Path, record: _Record) -> list[int]:
    """Searches that somebody went by as being on record, and that the store lacks or has without an attempt."""
    begun = sorted({goal.search for goal in record.of(SEARCH_GOAL)})
    # None begins before the one before is on record. A belief follows each that is, and whatever a stranger repeats.
    told = 0 if record.strangers else sum(1 for _ in record.of(BELIEF))
    acknowledged = begun[: max(told, len(begun) - 1)]
    if not acknowledged:
        return []
    attempts = {result.search: result.attempts for result in record.of(SEARCH_RESULT)}
    with PosteriorStore(store, Access.READ) as opened:
        kept = {piece.search: len(piece.tried) for piece in opened.evidence() if piece.session == record.session}
    return [
        search for search in acknowledged if search not in kept or kept[search] != attempts.get(search, kept[search])
    ]


def verdict_on(cell: SmallCell, ending: Ending, limit: float, *, killed: bool = False) -> Verdict:
    """The verdict on a cell and on those that ran beside it."""
    verdict = judge(cell, ending, limit, killed=killed)
    for companion in cell.companions:
        verdict = verdict.and_of(judge(companion, companion.wait(limit), limit))
    return replace(verdict, broken=tuple(dict.fromkeys(verdict.broken)))
