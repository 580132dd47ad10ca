"""A log as tables: attempts, searches, permits, stops, and signals, with units in the names of columns.

Times are seconds of the session. What a log cannot give is None: an empty field.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from enum import IntEnum
from itertools import chain
from typing import Any

import numpy as np

from runtime.declaration import type_name
from runtime.errors import LogError
from runtime.log.file import LogFile
from runtime.messages import (
    Attempt,
    Candidate,
    Ending,
    Gaussian,
    JointState,
    Outcome,
    Permit,
    Pose,
    SafetyState,
    SearchGoal,
    SearchResult,
    Truth,
    Wrench,
    nanoseconds_of,
)
from runtime.topics import (
    ATTEMPT,
    CANDIDATE,
    JOINT_STATES,
    PERMIT,
    SEARCH_GOAL,
    SEARCH_RESULT,
    TCP_POSE,
    TRACE,
    TRUTH,
    WRENCH,
    Topic,
)

Row = dict[str, Any]  # by name of column
Read = Callable[[Topic[Any]], Iterator[tuple[int, Any]]]  # stamps [ns] and messages, none of a topic the log lacks


@dataclass(frozen=True)
class Table:
    """One table and where it comes from."""

    name: str
    topic: Topic[Any]  # without it there is no table
    more: tuple[Topic[Any], ...]  # read too where the log has them
    rows: Callable[[Read], Iterator[Row]]


def tables(signals: Iterable[str]) -> list[Table]:
    """The tables of a log, with the signals that are asked for."""
    wanted = set(signals)
    return [*EVENTS, *(table for name, table in SIGNALS.items() if name in wanted)]


def hindrance(log: LogFile, topic: Topic[Any]) -> str:
    """Why a topic cannot be read from a log; empty if it can. Raises LogError where the file is damaged."""
    first = next(log.messages([topic.name]), None) if topic.name in {item.name for item in log.topics} else None
    if first is None:
        return f"the log has no {topic.name}"
    if first.type != type_name(topic.type):
        return f"{topic.name} carries {first.type} in this log, not {type_name(topic.type)}"
    try:
        log.decode(first)
    except LogError as error:
        return str(error)
    return ""


def reader(log: LogFile, advance: Callable[[], None]) -> Read:
    """Read topics of a log, telling of each message that was read. Raises LogError where the file is damaged."""

    def read(topic: Topic[Any]) -> Iterator[tuple[int, Any]]:
        if not hindrance(log, topic):
            for item in log.read(topic):
                yield item
                advance()

    return read


def _pose(pose: Pose, prefix: str = "") -> Row:
    place, turn = pose.position, pose.orientation
    return {
        f"{prefix}x_m": place.x,
        f"{prefix}y_m": place.y,
        f"{prefix}z_m": place.z,
        f"{prefix}qx": turn.x,
        f"{prefix}qy": turn.y,
        f"{prefix}qz": turn.z,
        f"{prefix}qw": turn.w,
    }


def _wrench(wrench: Wrench) -> Row:
    force, torque = wrench.force, wrench.torque
    return _wrench_row([force.x, force.y, force.z, torque.x, torque.y, torque.z])


def _wrench_row(values: Iterable[float]) -> Row:
    names = (f"{kind}_{axis}_{unit}" for kind, unit in (("force", "N"), ("torque", "Nm")) for axis in "xyz")
    return dict(zip(names, values, strict=True))


def _gaussian(belief: Gaussian, prefix: str) -> Row:
    known = belief.known
    return {
        f"{prefix}x_m": belief.x if known else None,
        f"{prefix}y_m": belief.y if known else None,
        f"{prefix}xx_m2": belief.xx if known else None,
        f"{prefix}xy_m2": belief.xy if known else None,
        f"{prefix}yy_m2": belief.yy if known else None,
    }


def word(names: type[IntEnum], value: int) -> str:
    """Name of an enumeration's value; the number itself where it has no name."""
    return names(value).name.lower() if value in set(names) else str(value)


def _number(value: float) -> float | None:
    """A number; None for not-a-number, by which messages say that there is none."""
    return None if np.isnan(value) else value


def _attempts(read: Read) -> Iterator[Row]:
    """One row an attempt, with what the strategy thought of it."""
    proposed: dict[tuple[int, int], Candidate] = {}
    for _, candidate in read(CANDIDATE):
        proposed[candidate.search, candidate.number] = candidate
    for stamp, attempt in read(ATTEMPT):
        yield _attempt_row(stamp, attempt, proposed.get((attempt.search, attempt.number)))


def _attempt_row(stamp: int, attempt: Attempt, candidate: Candidate | None) -> Row:
    proposal = candidate.proposal if candidate else None
    return {
        "time_s": stamp / 1e9,
        "search": attempt.search,
        "attempt": attempt.number,
        "board": attempt.board,
        "hole": attempt.hole,
        "kind": "slide" if attempt.path else "peck",
        "outcome": word(Outcome, attempt.outcome),
        "reason": attempt.reason,
        "x_m": attempt.x,
        "y_m": attempt.y,
        "depth_m": attempt.depth,
        "peak_force_N": attempt.peak_force,
        "duration_s": attempt.duration,
        **_pose(attempt.pose, "tcp_"),
        **_wrench(attempt.wrench),
        "path_m": "; ".join(f"{point.x!r} {point.y!r}" for point in attempt.path),
        "candidate_x_m": proposal.x if proposal else None,
        "candidate_y_m": proposal.y if proposal else None,
        "probability": _number(proposal.probability) if proposal else None,
        **_gaussian(proposal.belief if proposal else Gaussian(), "belief_"),
    }


def _searches(read: Read) -> Iterator[Row]:
    """One row a search, unfinished ones too, with the truth where it was recorded."""
    truths: dict[int, Truth] = {truth.search: truth for _, truth in read(TRUTH)}
    results: dict[int, tuple[int, SearchResult]] = {item.search: (stamp, item) for stamp, item in read(SEARCH_RESULT)}
    for stamp, goal in read(SEARCH_GOAL):
        row = _search_row(stamp, goal, results.get(goal.search))
        if truths:
            truth = truths.get(goal.search)
            row |= {f"{name}_{unit}": getattr(truth, name, None) for name, unit in _TRUTH}
        yield row


def _search_row(start: int, goal: SearchGoal, ended: tuple[int, SearchResult] | None) -> Row:
    end, result = ended or (None, None)
    return {
        "start_s": start / 1e9,
        "end_s": None if end is None else end / 1e9,
        "search": goal.search,
        "board": goal.board,
        "hole": goal.hole,
        "component": goal.component,
        "outcome": word(Ending, result.ending) if result else "unfinished",
        "reason": result.reason if result else "",
        "attempts": result.attempts if result else None,
        "duration_s": result.duration if result else None,
        "x_m": _number(result.x) if result else None,
        "y_m": _number(result.y) if result else None,
        "seated_x_m": _number(result.seated_x) if result else None,
        "seated_y_m": _number(result.seated_y) if result else None,
        **_pose(goal.nominal, "nominal_"),
        "feasible_radius_m": goal.feasible_radius,
        "search_radius_m": goal.search_radius,
        "max_attempts": goal.max_attempts,
        "earlier_seats": len(goal.seats),
        "earlier_misses": len(goal.misses),
        **_gaussian(goal.prior, "prior_"),
    }


_TRUTH = (
    ("hole_x", "m"),
    ("hole_y", "m"),
    ("hole_yaw", "rad"),
    ("pin_x", "m"),
    ("pin_y", "m"),
    ("pin_yaw", "rad"),
    ("offset_x", "m"),
    ("offset_y", "m"),
)


def _permits(read: Read) -> Iterator[Row]:
    for stamp, permit in read(PERMIT):
        yield {
            "time_s": stamp / 1e9,
            "granted": permit.granted,
            "state": word(SafetyState, permit.state),
            "reason": permit.reason,
            "valid_until_s": nanoseconds_of(permit.valid_until) / 1e9,
        }


def _stops(read: Read) -> Iterator[Row]:
    """One row for each time without a permit, from the first refusal to the next permit."""
    since: tuple[int, Permit] | None = None
    last = 0
    for stamp, permit in read(PERMIT):
        last = stamp
        if permit.granted and since is not None:
            yield _stop_row(since, stamp)
            since = None
        elif not permit.granted and since is None:
            since = (stamp, permit)
    if since is not None:
        yield _stop_row(since, last)


def _stop_row(since: tuple[int, Permit], end: int) -> Row:
    start, permit = since
    return {
        "start_s": start / 1e9,
        "end_s": end / 1e9,
        "duration_s": (end - start) / 1e9,
        "state": word(SafetyState, permit.state),
        "reason": permit.reason,
    }


def _joints(read: Read) -> Iterator[Row]:
    for stamp, state in read(JOINT_STATES):
        row: Row = {"time_s": stamp / 1e9}
        for values, unit in ((state.position, "rad"), (state.velocity, "rad_per_s"), (state.effort, "Nm")):
            row.update(zip((f"{name}_{unit}" for name in state.name), values.tolist(), strict=False))
        yield row


def _tcp(read: Read) -> Iterator[Row]:
    for stamp, posed in read(TCP_POSE):
        yield {"time_s": stamp / 1e9, **_pose(posed.pose)}


def _forces(read: Read) -> Iterator[Row]:
    for stamp, felt in read(WRENCH):
        yield {"time_s": stamp / 1e9, **_wrench(felt.wrench)}


def _trace(read: Read) -> Iterator[Row]:
    """One row a control cycle."""
    joints = _joint_names(read)
    names = [f"{name}_rad" for name in joints] + [f"{name}_target_rad" for name in joints]
    for _, trace in read(TRACE):
        first, count = nanoseconds_of(trace.header.stamp), len(trace.position) // 6
        times = (first + round(trace.period * 1e9) * np.arange(count)) / 1e9
        angles = np.hstack([trace.position.reshape(count, 6), trace.target.reshape(count, 6)]).tolist()
        for time, row, felt in zip(times.tolist(), angles, trace.wrench.reshape(count, 6).tolist(), strict=True):
            yield {"time_s": time, **dict(zip(names, row, strict=True)), **_wrench_row(felt)}


def _joint_names(read: Read) -> list[str]:
    first: tuple[int, JointState] | None = next(iter(read(JOINT_STATES)), None)
    return list(first[1].name) if first and len(first[1].name) == 6 else [f"joint_{number}" for number in range(1, 7)]


EVENTS = (
    Table("attempts", ATTEMPT, (CANDIDATE,), _attempts),
    Table("searches", SEARCH_GOAL, (SEARCH_RESULT, TRUTH), _searches),
    Table("permits", PERMIT, (), _permits),
    Table("stops", PERMIT, (), _stops),
)
SIGNALS = {
    "joints": Table("joints", JOINT_STATES, (), _joints),
    "wrench": Table("wrench", WRENCH, (), _forces),
    "tcp": Table("tcp", TCP_POSE, (), _tcp),
    "trace": Table("trace", TRACE, (), _trace),
}


def columns(first: Row, rows: Iterator[Row], size: int) -> Iterator[dict[str, list[Any]]]:
    """Rows gathered into columns, at most `size` rows at a time; columns are those of the first row."""
    gathered: dict[str, list[Any]] = {name: [] for name in first}
    count = 0
    for row in chain([first], rows):
        for name, values in gathered.items():
            values.append(row.get(name))
        count += 1
        if count == size:
            yield gathered
            gathered, count = {name: [] for name in first}, 0
    if count:
        yield gathered
