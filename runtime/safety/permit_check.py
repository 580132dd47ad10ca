"""Which permits an arm believes, pure: of its session, from its interlock, new, bounded, and sealed if it has a key.

A word that is not believed never grants motion and never extends a grant. If it refuses motion, and names this session,
the arm stops all the same until the next word that is believed, whoever sent it. Whoever can put such a word on the bus
could stop the cell in other ways as well, and a stop for nothing costs a tick of session time; to pass over a refusal
because something about it is odd could cost more. A word from another session, as a log that is
played back onto a cell's bus is full of, does nothing.

What tells old from new is in the message, under the seal: every permit has heard one message more than the one before
it. Sequence number and publisher's identity stand in the attachment, which anybody can write; they are checked as well,
because two interlocks on one bus are a fault even if both mean well.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

from runtime.bus import Envelope
from runtime.errors import BusError
from runtime.messages import Permit, nanoseconds_of
from runtime.safety.permit_seal import is_genuine
from runtime.topics import PERMIT
from runtime.validity import fault


class Objection(Enum):
    """Why a permit is not believed."""

    SENSELESS = "it makes no sense"
    SESSION = "it is of another session"
    SEAL = "its seal is not that of this session's interlock"
    PUBLISHER = "another than the interlock sent it"
    REPLAYED = "it has been heard before, or a later one has"
    FUTURE = "it is stamped later than session time"
    TOO_LONG = "it would hold for longer than safety.deadline allows"


@dataclass(frozen=True)
class Judgement:
    """What an arm makes of a permit."""

    permit: Permit | None  # None: it cannot be read
    objection: Objection | None = None  # None: it is believed
    stops: bool = False  # not believed, but it refuses motion in this session


@dataclass(frozen=True)
class PermitCheck:
    """What an arm believed last, and by that what it may believe next."""

    session: str
    deadline: int  # [ns] longest time that a permit may hold
    key: bytes = b""  # of the session's seals; empty: none is asked for
    last: Permit | None = None
    publisher: bytes = b""  # identity (16,) of the interlock's publisher, once it was believed
    sequence: int = 0  # of the last one believed

    def judge(self, item: Envelope, told: int) -> tuple[PermitCheck, Judgement]:
        """The check after an arrival, and what it makes of it. `told` [ns]: the latest session time on /clock."""
        try:
            permit = item.read(PERMIT)
        except BusError:
            return self, Judgement(None, Objection.SENSELESS)
        objection = self._objection(permit, item, told)
        if objection is not None:
            stops = not permit.granted and permit.session == self.session
            return self, Judgement(permit, objection, stops)
        after = replace(self, last=permit, publisher=item.publisher, sequence=item.sequence)
        return after, Judgement(permit)

    def _objection(self, permit: Permit, item: Envelope, told: int) -> Objection | None:
        if fault(permit):
            return Objection.SENSELESS
        if permit.session != self.session:
            return Objection.SESSION
        if self.key and not is_genuine(permit, self.key):
            return Objection.SEAL
        if self.last is not None and item.publisher != self.publisher:
            return Objection.PUBLISHER
        if self.last is not None and (item.sequence <= self.sequence or not _follows(permit, self.last)):
            return Objection.REPLAYED
        since = nanoseconds_of(permit.header.stamp)
        if since > told:
            return Objection.FUTURE
        if nanoseconds_of(permit.valid_until) - since > self.deadline:
            return Objection.TOO_LONG
        return None


def _counts(permit: Permit) -> tuple[int, ...]:
    return permit.ossd, permit.resets, permit.emergency_stops, permit.mutings


def _follows(permit: Permit, last: Permit) -> bool:
    """Whether one permit can be later than another: no count and no stamp goes back, and something new was heard."""
    now, before = _counts(permit), _counts(last)
    no_earlier = nanoseconds_of(permit.header.stamp) >= nanoseconds_of(last.header.stamp)
    return no_earlier and now != before and all(new >= old for new, old in zip(now, before, strict=True))
