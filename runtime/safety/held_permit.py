"""What an arm holds of the interlock's permits: whether it may move, until when, and how it stops."""

from __future__ import annotations

import logging
from collections import Counter
from dataclasses import dataclass, field

from runtime.bus import Envelope
from runtime.clock import Stopwatch
from runtime.context import Context
from runtime.messages import NANOSECONDS, nanoseconds_of
from runtime.safety.permit_check import Objection, PermitCheck

_PAUSE = 1.0  # [s] of machine time between lines about permits that were not believed
_POWERED = 2  # stop category that leaves the drives under power


@dataclass
class HeldPermit:
    """The last word that was believed; what was not believed is counted, and told at a limited rate."""

    context: Context
    granted: bool = False
    until: int = -1  # [ns] session time at which the word ends
    emergency: bool = False  # it refuses motion, and asks that the drives lose their power once the arm stands
    reason: str = ""  # its own
    refused: Counter[Objection] = field(default_factory=Counter)  # words that were not believed
    _check: PermitCheck = field(init=False)
    _told: Stopwatch | None = None  # since the last line about them

    def __post_init__(self) -> None:
        deadline = round(self.context.cell.safety.deadline * NANOSECONDS)
        self._check = PermitCheck(self.context.session, deadline, self.context.seal_key)

    def hear(self, item: Envelope, told: int) -> bool:
        """Take an arrival on the topic of permits; `told` [ns] is the latest session time on /clock.

        Whether it is believed.
        """
        self._check, judgement = self._check.judge(item, told)
        permit = judgement.permit
        if judgement.objection is not None or permit is None:
            self.granted = self.granted and not judgement.stops
            self._object(judgement.objection or Objection.SENSELESS)
            return False
        self.granted, self.until, self.reason = permit.granted, nanoseconds_of(permit.valid_until), permit.reason
        self.emergency = not permit.granted and permit.stop_category < _POWERED
        return True

    def permits(self, now: int) -> bool:
        """Whether the arm may move at session time `now` [ns]."""
        return self.granted and now < self.until and not self.context.stopping

    def _object(self, objection: Objection) -> None:
        first = not self.refused[objection]
        self.refused[objection] += 1
        if first or self._told is None or self._told.seconds > _PAUSE:
            self._told = Stopwatch()
            count = self.refused[objection]
            times = "" if count == 1 else f", {count} times by now"
            self.context.log(f"a permit is not believed: {objection.value}{times}", logging.WARNING)
