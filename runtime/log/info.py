"""What a log says of itself: of which session it is, what it holds, what was lost, how the searches ended."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

from runtime.declaration import type_name
from runtime.errors import LogError
from runtime.log.file import LogFile, MessageT
from runtime.log.sizes import payload_bytes
from runtime.log.tables import word
from runtime.log.writer import SESSION_RECORD, SUMMARY, VERSIONS_RECORD
from runtime.messages import ArmStatus, Ending, Phase, SearchResult, nanoseconds_of
from runtime.topics import ARM_STATUS, PERMIT, ROSOUT, SEARCH_RESULT, SESSION, Topic, topics

WARNING = 30  # level of rcl_interfaces/msg/Log
STOPPED = {  # safety modes (RTDE guide) in which the arm stands
    3: "protective stop",
    5: "safeguard stop",
    6: "emergency stop of the cell",
    7: "emergency stop of the robot",
    8: "violation",
    9: "fault",
}
EXTERNAL = {5, 6}  # for which the interlock has the reason
_SESSION_KEYS = ("session", "cell", "robot", "strategy", "component", "board_type", "boards", "seed", "rate")
_LEVELS = {10: "debug", 20: "info", 30: "warning", 40: "error", 50: "fatal"}
_ABOUT = 1_000_000_000  # [ns] around the beginning of a stop in which the interlock says why
_SINCE_EPOCH = 10**18  # [ns] a stamp above this is a date, not session time


@dataclass(frozen=True)
class TopicInfo:
    """One topic of a log."""

    name: str
    type: str
    count: int
    rate: float  # [1/s] per second of the log
    bytes: int  # of its messages, unpacked, with latched ones that later files of the log repeat
    lost: int | None  # messages that never arrived; None: not known
    end_known: bool  # whether all its publishers said at their end how much they had sent


@dataclass(frozen=True)
class Stop:
    """A time during which the arm was not allowed to move."""

    start: float  # [s] session time
    duration: float  # [s]
    kind: str
    reason: str  # in the interlock's words, empty if it said nothing


@dataclass(frozen=True)
class Said:
    """A warning or an error that a plugin logged."""

    time: float  # [s] session time
    level: str
    plugin: str
    text: str


@dataclass(frozen=True)
class LogInfo:
    """All that `palpate info` tells."""

    path: str
    files: int  # that the log is made of
    size: int  # [byte] on disk
    complete: bool
    start: int  # [ns] stamp of the first message
    end: int  # [ns]
    recorded: str  # when, ISO 8601 in local time; empty if the log does not say
    session: dict[str, str]  # what was run; empty for a log of another program
    versions: dict[str, str]
    drivers: list[str]  # plugins the cell file has settings for, the robot first
    attachments: dict[str, int]  # [byte] by name
    topics: list[TopicInfo]
    lost: int | None  # None: the recording does not say
    results: list[SearchResult]
    stops: list[Stop]
    said: list[Said]
    notes: list[str] = field(default_factory=list)  # what could not be told, and why

    @property
    def duration(self) -> float:
        """From the first message to the last [s]."""
        return (self.end - self.start) / 1e9

    def as_json(self) -> dict[str, Any]:
        """Everything, under keys that stay."""
        return {
            "log": self.path,
            "files": self.files,
            "size_bytes": self.size,
            "complete": self.complete,
            "recorded": self.recorded,
            "start_s": self.start / 1e9,
            "end_s": self.end / 1e9,
            "duration_s": self.duration,
            "messages": sum(topic.count for topic in self.topics),
            "lost": self.lost,
            **{key: self.session.get(key, "") for key in _SESSION_KEYS},
            **{key: int(self.session[key]) for key in ("boards", "seed") if self.session.get(key, "").isdecimal()},
            "drivers": self.drivers,
            "versions": self.versions,
            "attachments": self.attachments,
            "topics": [
                {
                    "name": topic.name,
                    "type": topic.type,
                    "count": topic.count,
                    "rate_hz": topic.rate,
                    "bytes": topic.bytes,
                    "lost": topic.lost,
                    "end_known": topic.end_known,
                }
                for topic in self.topics
            ],
            "searches": [
                {
                    "search": result.search,
                    "board": result.board,
                    "hole": result.hole,
                    "component": result.component,
                    "attempts": result.attempts,
                    "duration_s": result.duration,
                    "outcome": word(Ending, result.ending),
                    "reason": result.reason,
                }
                for result in self.results
            ],
            "stops": [
                {"start_s": stop.start, "duration_s": stop.duration, "kind": stop.kind, "reason": stop.reason}
                for stop in self.stops
            ],
            "warnings": [
                {"time_s": said.time, "level": said.level, "plugin": said.plugin, "text": said.text}
                for said in self.said
            ],
            "notes": self.notes,
        }


def info_of(log: LogFile) -> LogInfo:
    """Read what a log says of itself. Decodes only topics with few messages."""
    notes: list[str] = []
    try:
        log.check_complete("what it does hold is told")
    except LogError as error:
        notes.append(str(error))
    session = log.metadata.get(SESSION_RECORD, {})
    recording = log.metadata.get(SUMMARY, {})
    results = [result for _, result in _readable(log, SEARCH_RESULT, notes)]
    statuses = [status for _, status in _readable(log, ARM_STATUS, notes)]
    closing = [stamp for stamp, state in _readable(log, SESSION, notes) if state.phase == Phase.CLOSING]
    said = [
        Said(stamp / 1e9, _LEVELS.get(line.level, str(line.level)), line.name, line.msg)
        for stamp, line in _readable(log, ROSOUT, notes)
        if line.level >= WARNING
    ]
    return LogInfo(
        path=str(log.path),
        files=len(log.files),
        size=sum(file.stat().st_size for file in log.files),
        complete=log.complete,
        start=log.start,
        end=log.end,
        recorded=_recorded(session.get("session", ""), log.start),
        session={key: session[key] for key in _SESSION_KEYS if key in session},
        versions=log.metadata.get(VERSIONS_RECORD, {}),
        drivers=_drivers(session),
        attachments={name: len(data) for name, data in sorted(log.attachments.items())},
        topics=_topics(log, recording),
        lost=_loaded(recording.get("lost", ""), None),
        results=results,
        stops=_stops(log, statuses, min(closing, default=log.end)),
        said=said,
        notes=notes,
    )


def _readable(log: LogFile, topic: Topic[MessageT], notes: list[str]) -> Iterator[tuple[int, MessageT]]:
    """Messages of a topic, as far as they can be read; what hinders that goes to the notes."""
    try:
        yield from log.read(topic)
    except LogError as error:
        notes.append(str(error))


def _recorded(session: str, start: int) -> str:
    """When a session began: it is named by the wall clock; logs of other programs are stamped by it."""
    try:
        return datetime.strptime(session[:15], "%Y%m%d-%H%M%S").isoformat()
    except ValueError:
        if start > _SINCE_EPOCH:
            return datetime.fromtimestamp(start / 1e9, UTC).astimezone().isoformat(timespec="seconds")
        return ""


def _drivers(session: dict[str, str]) -> list[str]:
    settings = _loaded(session.get("settings", ""), {})
    robot = [session["robot"]] if "robot" in session else []
    return robot + [name for name in settings.get("drivers", {}) if name not in robot]


def _loaded(text: str, otherwise: Any) -> Any:
    """A value written as JSON; `otherwise` for a text that is none."""
    try:
        return json.loads(text)
    except ValueError:
        return otherwise


def _topics(log: LogFile, recording: dict[str, str]) -> list[TopicInfo]:
    sizes = _sizes(log)
    lost: dict[str, int] | None = _loaded(recording.get("lost_topics", ""), None)
    unsigned = _loaded(recording.get("unsigned_topics", ""), [])
    seconds = (log.end - log.start) / 1e9
    found = [
        TopicInfo(
            topic.name,
            topic.type,
            topic.count,
            topic.count / seconds if seconds > 0 else 0.0,
            sizes[topic.name, topic.type],
            None if lost is None else lost.get(topic.name, 0),
            lost is not None and topic.name not in unsigned,
        )
        for topic in log.topics
    ]
    present = {topic.name for topic in log.topics}
    for name, number in (lost or {}).items():
        if name not in present:  # nothing of it ever arrived
            known = topics().get(name)
            kind = type_name(known.type) if known else ""
            found.append(TopicInfo(name, kind, 0, 0.0, 0, number, name not in unsigned))
    return sorted(found, key=lambda topic: topic.name)


def _sizes(log: LogFile) -> Counter[tuple[str, str]]:
    """Bytes by topic and type."""
    found: Counter[tuple[str, str]] = Counter()
    for file in log.files:
        told = payload_bytes(file)
        if told is None:
            found.clear()
            break
        found.update(told)
    else:
        return found
    for envelope in log.messages():
        found[envelope.topic, envelope.type] += len(envelope.payload)
    return found


def _stops(log: LogFile, statuses: list[ArmStatus], closing: int) -> list[Stop]:
    """Stops that began before the session was closed [ns], which halts the arm too."""
    found: list[Stop] = []
    since: tuple[int, int] | None = None  # stamp and safety mode
    for status in statuses:
        stamp = nanoseconds_of(status.header.stamp)
        mode = status.safety_mode if status.safety_mode in STOPPED else None
        if since is not None and mode != since[1]:
            found.append(_stop(log, since, stamp))
            since = None
        if since is None and mode is not None:
            since = (stamp, mode)
    if since is not None and since[0] < closing:
        found.append(_stop(log, since, log.end))
    return found


def _stop(log: LogFile, since: tuple[int, int], until: int) -> Stop:
    start, mode = since
    return Stop(start / 1e9, (until - start) / 1e9, STOPPED[mode], _reason(log, start) if mode in EXTERNAL else "")


def _reason(log: LogFile, start: int) -> str:
    """Why the interlock refused its permit when the arm stopped."""
    try:
        for _, permit in log.read(PERMIT, max(start - _ABOUT, 0), start + _ABOUT):
            if not permit.granted and permit.reason and nanoseconds_of(permit.valid_until) >= start:
                return permit.reason
    except LogError:  # a topic of another type
        pass
    return ""
