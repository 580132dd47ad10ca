"""What was sent against what arrived: the account of a recording."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from runtime.bus import Inbox
from runtime.messages import PublisherCount
from runtime.network.access import CLIENTS
from runtime.topics import COUNTS


@dataclass
class Ledger:
    """What was sent, as far as the publishers said so, against what arrived."""

    inbox: Inbox
    _said: dict[str, Counter[str]] = field(default_factory=dict)  # by plugin

    def note(self, plugin: str, counts: list[PublisherCount]) -> None:
        """Take note of a closing plugin's last word. What a stranger says it has sent is not believed."""
        if plugin in CLIENTS:
            self._said[plugin] = Counter({count.topic: count.sent for count in counts})

    @property
    def sent(self) -> Counter[str]:
        """Messages by topic that plugins say they have sent."""
        return sum(self._said.values(), Counter())

    def accounted(self) -> Counter[str]:
        """Messages by topic that arrived or are known to be lost. /session/counts is left out: it counts itself not."""
        total = self._gaps()
        for (topic, _), number in list(self.inbox.received.items()):
            total[topic] += number
        del total[COUNTS.name]
        return total

    def _gaps(self) -> Counter[str]:
        """Messages that are missing between others. Before a publisher's first, only its last word tells of any: a
        stranger may have spoken long before there was anybody to record it."""
        inbox = self.inbox
        return Counter(dict(list(inbox.lost.items()))) - Counter(dict(list(inbox.before.items())))

    def complete(self) -> bool:
        """Whether every publisher that was heard of has said its last word and all it sent has arrived."""
        sent = self.sent.copy()
        del sent[COUNTS.name]
        return +sent == +self.accounted()

    def lost(self) -> dict[str, int]:
        """Messages that never arrived, by topic: gaps in the sequence and what is missing at the end."""
        lost = self._gaps()
        lost.update(self.sent - self.accounted())
        return {topic: number for topic, number in sorted(lost.items()) if number and topic != COUNTS.name}

    def unsigned(self) -> list[str]:
        """Topics of which some publisher never said how much it sent, so that their end may be missing."""
        return sorted(self.accounted() - self.sent)
