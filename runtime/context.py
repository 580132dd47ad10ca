"""What a running plugin has at hand: its bus, session time, the cell as far as it may know it, and a voice."""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field

from runtime.bus import Bus, Envelope, Publisher, Request
from runtime.clock import SessionClock
from runtime.config import Cell
from runtime.messages import Log, PublisherCounts, header, stamp_of
from runtime.network.access import RECORDER
from runtime.network.admission import Admission
from runtime.topics import COUNTS, PERMIT, ROSOUT

_JUDGED = {"arm": frozenset({PERMIT.name})}  # a permit that is not believed may stop the arm all the same


@dataclass
class Context:
    """One plugin's surroundings."""

    role: str
    bus: Bus
    cell: Cell  # without the tolerances, unless the plugin simulates the world
    session: str
    seal_key: bytes = field(default=b"", repr=False)  # for interlock and arm: of the permits' seals
    clock: SessionClock = field(default_factory=SessionClock)
    admission: Admission = field(init=False)  # what is not let in never reaches the plugin
    _stop: threading.Event = field(default_factory=threading.Event)
    _rosout: Publisher[Log] | None = None
    _counts: Publisher[PublisherCounts] | None = None

    def __post_init__(self) -> None:
        self.admission = Admission(
            lambda text: self.log(text, logging.WARNING),
            self.clock,
            self.session,
            judged=_JUDGED.get(self.role, frozenset()),
            everything=self.role == RECORDER,
        )
        self.bus.inbox.admit_by(self.admission, self.admission.refuse)

    @property
    def stopping(self) -> bool:
        """Whether the plugin shall end."""
        return self._stop.is_set()

    def stop(self) -> None:
        """Ask the plugin to end; from any thread."""
        self._stop.set()
        self.bus.inbox.wake()

    def ready(self) -> None:
        """Called by a plugin once its publishers and subscriptions are declared."""
        self._rosout = self.bus.publisher(ROSOUT)
        self._counts = self.bus.publisher(COUNTS)
        self.bus.announce()

    def arrivals(self) -> Iterator[Envelope | Request]:
        """What arrives, until the plugin shall end. Session time follows the stamps."""
        while not self.stopping:
            item = self.bus.inbox.receive()
            if isinstance(item, Envelope):
                self.clock.advance(item.stamp)
            if item is not None:
                yield item

    def log(self, text: str, level: int = logging.INFO) -> None:
        """Say something: it is recorded and shown."""
        assert self._rosout is not None, "a plugin logs after it is ready"
        now = self.clock.now
        self._rosout.send(
            Log(stamp=stamp_of(now), level=level, name=self.role, msg=text, file="", function="", line=0), now
        )

    def close(self) -> None:
        """Say how much was published, so that the recorder can tell whether all of it arrived."""
        if self._counts is not None:
            self.admission.close()
            now = self.clock.now
            self._counts.send(PublisherCounts(header(now), self.role, self.bus.counts()), now)
