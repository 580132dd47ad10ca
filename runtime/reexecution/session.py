"""What a log knows of the decisions of its session: settings, what the deciders heard, and what they decided."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

from runtime import topics
from runtime.config import Cell, cell_of, redacted
from runtime.declaration import type_name
from runtime.errors import LogError
from runtime.log.file import LogFile
from runtime.log.writer import SESSION_RECORD, SUMMARY
from runtime.messages import (
    AnswerGiven,
    Attempt,
    Belief,
    Candidate,
    EmergencyStop,
    Intervention,
    Merged,
    Muting,
    Ossd,
    Permit,
    Reset,
    SearchGoal,
    SearchResult,
    SessionState,
)
from runtime.topics import Topic

MessageT = TypeVar("MessageT")

DECIDED_FROM: tuple[Topic[Any], ...] = (
    topics.SESSION,
    topics.OSSD,
    topics.RESET,
    topics.EMERGENCY_STOP,
    topics.MUTING,
    topics.PERMIT,
    topics.SEARCH_GOAL,
    topics.CANDIDATE,
    topics.ATTEMPT,
    topics.SEARCH_RESULT,
    topics.BELIEF,
    topics.MERGED,
    topics.INTERVENTION,
    topics.ANSWER_GIVEN,
)

_OF_MANY = {topics.RESET.name, topics.EMERGENCY_STOP.name, topics.SESSION.name}  # each publisher counts for itself


@dataclass(frozen=True)
class Recorded(Generic[MessageT]):
    """A message as it was recorded."""

    message: MessageT
    stamp: int  # session time at which it was sent [ns]
    sequence: int  # of its publisher on its topic, from 1


@dataclass(frozen=True)
class RecordedSession:
    """One session. What one publisher sent on one topic stands in the order in which it was sent."""

    name: str
    identity: str  # under which its evidence is kept: the name, in logs that do not say
    where: str  # the cell file's name, for errors
    document: dict[str, Any]
    complete: bool
    lost: Mapping[str, int]  # messages that the recorder says it never got, by topic
    duration: int  # session time [ns]
    fields: Mapping[type[Any], frozenset[str]]  # what the log has of classes that it defines differently from today
    messages: Mapping[str, list[Recorded[Any]]] = field(repr=False)

    def cell(self, role: str) -> Cell:
        """The cell as a role knew it. Raises CellError if its settings are none today."""
        return cell_of(redacted(self.document, role), self.where)

    def lacks(self, topic: Topic[Any]) -> bool:
        """Whether messages of a topic with one publisher were lost, by its sequence numbers or the recorder's word."""
        sequences = [item.sequence for item in self.messages[topic.name]]
        return sequences != list(range(1, len(sequences) + 1)) or topic.name in self.lost

    @property
    def states(self) -> list[Recorded[SessionState]]:
        """Phases of the session."""
        return self.messages[topics.SESSION.name]

    @property
    def ossd(self) -> list[Recorded[Ossd]]:
        """The curtain's words."""
        return self.messages[topics.OSSD.name]

    @property
    def resets(self) -> list[Recorded[Reset]]:
        """Presses of the reset button, by whomever, earliest first."""
        return self.messages[topics.RESET.name]

    @property
    def emergency_stops(self) -> list[Recorded[EmergencyStop]]:
        """Emergency stop devices pressed and released, earliest first."""
        return self.messages[topics.EMERGENCY_STOP.name]

    @property
    def mutings(self) -> list[Recorded[Muting]]:
        """The muting sensors."""
        return self.messages[topics.MUTING.name]

    @property
    def permits(self) -> list[Recorded[Permit]]:
        """The interlock's words."""
        return self.messages[topics.PERMIT.name]

    @property
    def goals(self) -> list[Recorded[SearchGoal]]:
        """What was searched for."""
        return self.messages[topics.SEARCH_GOAL.name]

    @property
    def candidates(self) -> dict[int, list[Recorded[Candidate]]]:
        """The strategy's words by search."""
        return _by_search(self.messages[topics.CANDIDATE.name])

    @property
    def attempts(self) -> dict[int, list[Recorded[Attempt]]]:
        """What the arm felt, by search."""
        return _by_search(self.messages[topics.ATTEMPT.name])

    @property
    def results(self) -> dict[int, Recorded[SearchResult]]:
        """How searches ended, by search."""
        return {item.message.search: item for item in self.messages[topics.SEARCH_RESULT.name]}

    @property
    def beliefs(self) -> list[Recorded[Belief]]:
        """What was believed after each search."""
        return self.messages[topics.BELIEF.name]

    @property
    def merged(self) -> list[Recorded[Merged]]:
        """What others changed in the evidence."""
        return self.messages[topics.MERGED.name]

    @property
    def interventions(self) -> list[Recorded[Intervention]]:
        """What was needed of a person."""
        return self.messages[topics.INTERVENTION.name]

    @property
    def answers(self) -> dict[int, Recorded[AnswerGiven]]:
        """What people answered, by search."""
        return {item.message.search: item for item in self.messages[topics.ANSWER_GIVEN.name]}


def _by_search(items: list[Recorded[Any]]) -> dict[int, list[Recorded[Any]]]:
    found: dict[int, list[Recorded[Any]]] = defaultdict(list)
    for item in items:
        found[item.message.search].append(item)
    return found


def recorded_session(log: LogFile) -> RecordedSession:
    """Read what a log knows of its decisions. Raises LogError if it has no settings or cannot be decoded."""
    about = log.metadata.get(SESSION_RECORD, {})
    if "settings" not in about:
        raise LogError(
            f"{log.path}: the log does not say with which settings its session ran (metadata palpate.session)"
        )
    try:
        document = json.loads(about["settings"])
    except ValueError as error:
        raise LogError(f"{log.path}: the settings in metadata palpate.session are no JSON: {error}") from None
    if not isinstance(document, dict):
        raise LogError(f"{log.path}: the settings in metadata palpate.session are no cell")
    types = {topic.name: type_name(topic.type) for topic in DECIDED_FROM}
    messages: dict[str, list[Recorded[Any]]] = {name: [] for name in types}
    known: dict[type[Any], frozenset[str]] = {}
    for envelope in log.messages(types):
        if envelope.type != types[envelope.topic]:
            raise LogError(
                f"{log.path}: {envelope.topic} carries {envelope.type} in this log, not {types[envelope.topic]}"
            )
        if not messages[envelope.topic]:
            known.update(log.recorded_fields(envelope))
        messages[envelope.topic].append(Recorded(log.decode(envelope), envelope.stamp, envelope.sequence))
    for name, items in messages.items():
        if name not in _OF_MANY:
            items.sort(key=lambda item: item.sequence)
    return RecordedSession(
        name=about.get("session", ""),
        identity=about.get("evidence_session", about.get("session", "")),
        where=about.get("cell", log.path.name),
        document=document,
        complete=log.complete,
        lost=_lost(log),
        duration=log.end - log.start,
        fields=known,
        messages=messages,
    )


def _lost(log: LogFile) -> dict[str, int]:
    try:
        lost = json.loads(log.metadata.get(SUMMARY, {}).get("lost_topics", "{}"))
        return {str(name): int(count) for name, count in lost.items()}
    except (ValueError, AttributeError, TypeError):
        raise LogError(f"{log.path}: what was lost stands in metadata palpate.recording in no known form") from None
