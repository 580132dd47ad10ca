"""How a command asks something of what runs already: a cell, or a player."""

from __future__ import annotations

from runtime.errors import BusError
from runtime.network.access import OPERATOR
from runtime.network.meeting_point import MeetingPoint
from runtime.network.zenoh_bus import ZenohBus
from runtime.topics import ReplyT, RequestT, Service

PATIENCE = 3.0  # [s] for a router to answer
ANSWER = 10.0  # [s] for a plugin to


def joined(point: MeetingPoint, absent: str) -> ZenohBus:
    """A bus for an operator. Raises BusError with the words `absent` if nothing runs there."""
    try:
        return ZenohBus(OPERATOR, point, patience=PATIENCE)
    except BusError:
        raise BusError(absent) from None


def asked(
    point: MeetingPoint, service: Service[RequestT, ReplyT], question: RequestT, absent: str, timeout: float = ANSWER
) -> ReplyT:
    """The answer of a service. Raises BusError with the words `absent` if nobody gives one within `timeout` seconds."""
    with joined(point, absent) as bus:
        try:
            return bus.request(service, question, timeout)
        except BusError:
            raise BusError(absent) from None
