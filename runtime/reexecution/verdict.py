"""How recorded decisions compare with today's."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from runtime import topics
from runtime.reexecution.differences import FieldDifference, differences
from runtime.reexecution.session import Recorded, RecordedSession
from runtime.topics import Topic

DECISIONS: tuple[Topic[Any], ...] = (
    topics.SEARCH_GOAL,
    topics.CANDIDATE,
    topics.SEARCH_RESULT,
    topics.BELIEF,
    topics.PERMIT,
)


@dataclass
class Tally:
    """How the decisions of one topic compare."""

    compared: int = 0
    rounding: int = 0  # of them equal within rounding, not bit for bit
    differing: int = 0
    missing: int = 0  # that today's code makes and the log, which ends before, does not have
    beyond: int = 0  # recorded, but not to be compared because the recorder lost what they rest on


@dataclass(frozen=True)
class Difference:
    """A decision that is not what it was."""

    topic: str
    stamp: int  # session time [ns]
    decision: str  # which one, in words
    what: str  # in words, where it is not a matter of fields
    fields: tuple[FieldDifference, ...] = ()


@dataclass
class Verdict:
    """What came of a re-execution."""

    session: RecordedSession
    tallies: dict[str, Tally] = field(default_factory=lambda: {topic.name: Tally() for topic in DECISIONS})
    first: Difference | None = None  # the earliest in session time
    losses: list[str] = field(default_factory=list)  # why some decisions could not be compared
    seconds: float = 0.0  # of machine time to read the log and to decide again, once the strategy is loaded

    def tally(self, topic: Topic[Any]) -> Tally:
        """How the decisions of a topic compare; of one that not every session has, once it is asked for."""
        return self.tallies.setdefault(topic.name, Tally())

    @property
    def compared(self) -> int:
        """Decisions that were compared."""
        return sum(tally.compared for tally in self.tallies.values())

    @property
    def differing(self) -> int:
        """Decisions that differ."""
        return sum(tally.differing for tally in self.tallies.values())

    def compare(self, topic: Topic[Any], decision: str, recorded: Recorded[Any], now: Any, stamp: int) -> None:
        """A decision that both the log and today's code have; `stamp` [ns] is when it would be sent today."""
        found = list(differences(recorded.message, now, self.session.fields))
        sent = max(stamp, 0)  # a log has no time before zero
        if sent != recorded.stamp:
            found.append(FieldDifference("(sent at)", "ns", recorded.stamp, sent, rounding=False))
        tally = self.tally(topic)
        tally.compared += 1
        if not found:
            return
        if all(item.rounding for item in found):
            tally.rounding += 1
            return
        self._differs(Difference(topic.name, recorded.stamp, decision, "", tuple(found)))

    def only_one(self, topic: Topic[Any], decision: str, stamp: int, what: str) -> None:
        """A decision that only one of both has, where it is a difference."""
        self.tally(topic).compared += 1
        self._differs(Difference(topic.name, stamp, decision, what))

    def _differs(self, difference: Difference) -> None:
        self.tallies[difference.topic].differing += 1
        if self.first is None or _order(difference) < _order(self.first):
            self.first = difference

    def lose(self, reason: str) -> None:
        """Something the decisions rest on was not recorded."""
        if reason not in self.losses:
            self.losses.append(reason)


def _order(difference: Difference) -> tuple[int, int]:
    """In session time; at one moment, goals come before what follows from them."""
    return difference.stamp, [topic.name for topic in (*DECISIONS, topics.INTERVENTION)].index(difference.topic)
