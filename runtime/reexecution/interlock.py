"""The interlock of a recorded session, decided again."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from runtime import roles, topics
from runtime.clock import SessionClock
from runtime.config import Cell
from runtime.messages import (
    Ossd,
    Permit,
    nanoseconds_of,
)
from runtime.reexecution.session import Recorded
from runtime.reexecution.verdict import Verdict
from runtime.safety.plugin import InterlockDesk
from runtime.topics import Topic


def check_interlock(verdict: Verdict) -> None:
    """Compare every permit with today's."""
    session = verdict.session
    if not session.permits:
        return
    reason = _Interlock(verdict, session.cell(roles.INTERLOCK)).run()
    if reason:
        verdict.lose(reason)
        tally = verdict.tallies[topics.PERMIT.name]
        tally.beyond += len(session.permits) - tally.compared


class _Interlock:
    """Lets today's interlock hear what the recorded one heard, in the order that its permits tell."""

    def __init__(self, verdict: Verdict, cell: Cell) -> None:
        session = verdict.session
        self.verdict, self.session = verdict, session
        self.desk, self.clock = InterlockDesk.of(cell.safety, session.name), SessionClock()
        self.waiting: dict[Topic[Any], list[Recorded[Any]]] = {
            topics.RESET: list(session.resets),
            topics.EMERGENCY_STOP: list(session.emergency_stops),
            topics.MUTING: list(session.mutings),
        }
        self.ossd = {item.sequence: item for item in session.ossd}
        known, words = session.fields.get(Permit), session.fields.get(Ossd)
        self.counted = known is None or {"ossd", "resets"} <= known
        self.tested = words is None or "channel_1_tested" in words

    def run(self) -> str:
        """Compare all permits; why it had to end before their last, empty if it had not."""
        for number, recorded in enumerate(self.session.permits, 1):
            if recorded.sequence != number:
                return f"permit {number} was not recorded, nor therefore what the interlock had heard by then"
            permit: Permit | None = None
            for topic, count in self._heard(recorded.message):
                heard = self.ossd.get(count) if topic is topics.OSSD else self._next(topic, recorded.stamp)
                if heard is None:
                    return f"message {count} of {topic.name} was not recorded"
                self.clock.advance(heard.stamp)
                permit = self.desk.hear(self._as_told(heard.message))
            if permit is None:
                return f"what permit {number} answers was not recorded"
            permit = replace(permit, seal=recorded.message.seal)  # whose key was the session's own, and is gone
            self.verdict.compare(topics.PERMIT, f"permit {number}", recorded, permit, self.clock.now)
        return ""

    def _heard(self, permit: Permit) -> list[tuple[Topic[Any], int]]:
        """What the interlock heard since the permit before, in order: topic, and number of the message on it."""
        desk = self.desk
        if not self.counted:
            following = self.ossd.get(desk.ossd + 1)
            answered = nanoseconds_of(permit.header.stamp)
            if following is None or nanoseconds_of(following.message.header.stamp) != answered:
                return [(topics.RESET, desk.resets + 1)]
            return [(topics.OSSD, desk.ossd + 1)]
        counts = (
            (topics.RESET, desk.resets, permit.resets),
            (topics.EMERGENCY_STOP, desk.emergency_stops, permit.emergency_stops),
            (topics.MUTING, desk.mutings, permit.mutings),
            (topics.OSSD, desk.ossd, permit.ossd),
        )
        return [(topic, number) for topic, before, now in counts for number in range(before + 1, now + 1)]

    def _next(self, topic: Topic[Any], sent: int) -> Recorded[Any] | None:
        """What was heard of buttons and sensors. Two may press one, and then the permit's stamp tells whose it was."""
        waiting = self.waiting[topic]
        if not waiting:
            return None
        chosen = next((item for item in waiting if max(self.clock.now, item.stamp) == sent), waiting[0])
        waiting.remove(chosen)
        return chosen

    def _as_told(self, message: Any) -> Any:
        """The curtain's word; where logs are too old to tell of test pulses, nobody asked for them either."""
        if self.tested or not isinstance(message, Ossd):
            return message
        stamp = message.header.stamp
        return replace(message, channel_1_tested=stamp, channel_2_tested=stamp)
