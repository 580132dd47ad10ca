"""Which topics of a log are played, under which names, and from when to when."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import Any

from runtime.errors import InputError, LogError, alternatives
from runtime.log.file import LogFile, LogTopicHandle
from runtime.messages import NANOSECONDS
from runtime.topics import CLOCK, Topic

_TOPIC_NAME = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")
_ARROW = ":="


@dataclass(frozen=True)
class Selection:
    """What of a log is to be played, as a user says it."""

    include: Sequence[str] = ()  # patterns of topics; all if there are none
    exclude: Sequence[str] = ()  # patterns of topics
    remap: Mapping[str, str] = field(default_factory=dict)  # new name by recorded name
    start: float | None = None  # [s] after the beginning of the log; before its end if negative
    end: float | None = None  # [s] likewise; what is stamped so or later is not played
    listeners: Sequence[str] | None = None  # patterns of topics to wait for somebody on, all; on any, if it is empty


@dataclass(frozen=True)
class Playlist:
    """What of a log is played. Topics by their names in the log."""

    start: int  # [ns] session time of the first message that may be
    until: int  # [ns] session time of the first message that may not
    topics: dict[str, Topic[Any]]  # where to publish
    skipped: dict[str, str]  # topics that cannot be played, and why
    awaited: tuple[str, ...] = ()  # topics to wait for somebody on
    any_will_do: bool = False  # one of them is enough


def parse_remap(rules: Sequence[str]) -> dict[str, str]:
    """New names of topics by recorded name, from `/old:=/new`. Raises InputError for a rule that is none."""
    found: dict[str, str] = {}
    for rule in rules:
        old, arrow, new = rule.partition(_ARROW)
        if not arrow:
            raise InputError(f"--remap {rule!r} is no rule; write /old{_ARROW}/new")
        for name in (old, new):
            if not _TOPIC_NAME.fullmatch(name):
                raise InputError(
                    f"--remap {rule!r}: {name!r} is no topic; write names of letters, digits and _ as in /arm/status"
                )
        if old in found:
            raise InputError(f"--remap gives {old} two names, {found[old]} and {new}")
        found[old] = new
    return found


def chosen(log: LogFile, include: Sequence[str], exclude: Sequence[str] = ()) -> list[str]:
    """Topics of the log that match a pattern (`/search/*`) to include, all if there are none, and none to exclude.

    Raises InputError for a pattern that matches no topic of the log, and if no topic is left.
    """
    names = sorted({topic.name for topic in log.topics})
    for pattern in (*include, *exclude):
        if not any(fnmatchcase(name, pattern) for name in names):
            raise InputError(f"no topic of {log.path.name} matches {pattern!r}; {alternatives(pattern, names)}")
    wanted = [name for name in names if not include or any(fnmatchcase(name, pattern) for pattern in include)]
    left = [name for name in wanted if not any(fnmatchcase(name, pattern) for pattern in exclude)]
    if wanted and not left:
        raise InputError(f"nothing is left to play: {', '.join(exclude)} excludes every topic")
    return left


def playlist(log: LogFile, selection: Selection | None = None, clock: bool = False) -> Playlist:
    """What to play of a log; with a clock of the player's own the recorded one is left out.

    Raises InputError for what the log does not have, and for two topics that would get one name.
    """
    selection = selection or Selection()
    start, until = _window(log, selection)
    topics, skipped = _targets(log, _published_names(log, selection, clock))
    awaited = _awaited(topics, selection.listeners)
    return Playlist(start, until, topics, skipped, awaited, any_will_do=not selection.listeners)


def _published_names(log: LogFile, selection: Selection, clock: bool) -> dict[str, str]:
    names = chosen(log, selection.include, selection.exclude)
    if clock:
        names = [name for name in names if name != CLOCK.name]
    for old in selection.remap:
        if old not in names:
            raise InputError(f"--remap {old}: no such topic is played; {alternatives(old, names)}")
    taken = {CLOCK.name: "the player's clock"} if clock else {}
    renamed = {}
    for name in names:
        new = renamed[name] = selection.remap.get(name, name)
        if new in taken:
            raise InputError(f"{taken[new]} and {name} would both be published as {new}; rename one of them elsewhere")
        taken[new] = name
    return renamed


def _targets(log: LogFile, names: Mapping[str, str]) -> tuple[dict[str, Topic[Any]], dict[str, str]]:
    found: dict[str, Topic[Any]] = {}
    skipped: dict[str, str] = {}
    for name, new in names.items():
        types = sorted({topic.type for topic in log.topics if topic.name == name})
        try:
            handle = log.handle(name)
        except LogError as error:
            skipped[name] = str(error).removeprefix(f"{log.path}: {name}: ")
            continue
        if len(types) > 1:
            skipped[name] = f"it carries several types: {', '.join(types)}"
            continue
        found[name] = handle if new == name else _renamed(handle, new)
    return found, skipped


def _renamed(topic: Topic[Any], name: str) -> Topic[Any]:
    return LogTopicHandle(name, topic.type, topic.publisher, topic.rate, topic.meaning, topic.latched, topic.hidden)


def _awaited(topics: Mapping[str, Topic[Any]], patterns: Sequence[str] | None) -> tuple[str, ...]:
    if patterns is None:
        return ()
    names = {name: topic.name for name, topic in topics.items()}
    for pattern in patterns:
        if not any(fnmatchcase(new, pattern) for new in names.values()):
            raise InputError(f"--wait {pattern}: no such topic is played; {alternatives(pattern, names.values())}")
    return tuple(
        name for name, new in names.items() if not patterns or any(fnmatchcase(new, pattern) for pattern in patterns)
    )


def _window(log: LogFile, selection: Selection) -> tuple[int, int]:
    start = log.start if selection.start is None else _moment(log, selection.start)
    until = log.end + 1 if selection.end is None else _moment(log, selection.end)
    if selection.start is not None and not log.start <= start <= log.end:
        duration = (log.end - log.start) / NANOSECONDS
        raise InputError(f"--start {selection.start:g} is outside of {log.path.name}, which lasts {duration:.3f} s")
    if selection.end is not None and until <= start:
        raise InputError(
            f"--end {selection.end:g} leaves nothing: what is played begins at {(start - log.start) / NANOSECONDS:g} s"
        )
    return start, min(until, log.end + 1)


def _moment(log: LogFile, seconds: float) -> int:
    return round(seconds * NANOSECONDS) + (log.end if seconds < 0 else log.start)
