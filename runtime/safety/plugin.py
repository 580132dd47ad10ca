"""The interlock as a plugin: the curtain, the buttons and the muting sensors in, permits out."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Any

from runtime.bus import Envelope
from runtime.cell import Safety
from runtime.context import Context
from runtime.messages import (
    NANOSECONDS,
    EmergencyStop,
    Muting,
    Ossd,
    Permit,
    Reset,
    ResetEdge,
    Time,
    header,
    nanoseconds_of,
    stamp_of,
)
from runtime.safety.interlock import Interlock, Reading, Times
from runtime.safety.permit_seal import sealed
from runtime.topics import EMERGENCY_STOP, MUTING, OSSD, PERMIT, RESET, Topic

INPUTS: dict[str, Topic[Any]] = {topic.name: topic for topic in (OSSD, RESET, EMERGENCY_STOP, MUTING)}

Heard = Ossd | Reset | EmergencyStop | Muting


@dataclass(frozen=True)
class InterlockPlugin:
    """Grants and withdraws the permit to move."""

    def run(self, context: Context) -> None:
        """Answer everything that is heard with a permit or its refusal."""
        permits = context.bus.publisher(PERMIT)
        context.bus.subscribe(*INPUTS.values())
        context.ready()
        desk = InterlockDesk.of(context.cell.safety, context.session)
        for item in context.arrivals():
            if not isinstance(item, Envelope):
                continue
            before = desk.interlock
            message = item.read(INPUTS[item.topic])
            permit = desk.hear(message)
            unchanged = desk.interlock.state is before.state
            if unchanged and isinstance(message, Reset) and message.edge != ResetEdge.PRESSED:
                context.log(f"reset did nothing: {before.reason}", logging.WARNING)
            if permit is None:
                continue
            if not unchanged:
                level = logging.INFO if permit.granted else logging.WARNING
                context.log(f"interlock {desk.interlock.state.name.lower()}: {permit.reason}", level)
            permits.send(sealed(permit, context.seal_key), context.clock.now)


@dataclass
class InterlockDesk:
    """What the interlock decides, without bus or clock: a permit for each thing heard, once the curtain has spoken."""

    interlock: Interlock
    deadline: int  # [ns] a permit holds no longer than this
    session: str = ""
    ossd: int = 0  # messages heard
    resets: int = 0
    emergency_stops: int = 0
    mutings: int = 0
    _last: Ossd | None = None

    @classmethod
    def of(cls, safety: Safety, session: str = "") -> InterlockDesk:
        """A desk that has heard nothing yet."""
        return cls(Interlock(times_of(safety)), round(safety.deadline * NANOSECONDS), session)

    def hear(self, message: Heard) -> Permit | None:
        """Anything that the interlock listens to."""
        match message:
            case Ossd():
                return self.hear_ossd(message)
            case Reset():
                return self.hear_reset(message)
            case EmergencyStop():
                return self.hear_emergency_stop(message)
            case Muting():
                return self.hear_muting(message)

    def hear_ossd(self, ossd: Ossd) -> Permit | None:
        """The curtain's outputs."""
        self.ossd += 1
        now = nanoseconds_of(ossd.header.stamp)
        reading_1 = Reading(ossd.channel_1, ossd.channel_1_off_time, nanoseconds_of(ossd.channel_1_tested))
        reading_2 = Reading(ossd.channel_2, ossd.channel_2_off_time, nanoseconds_of(ossd.channel_2_tested))
        self.interlock = self.interlock.on_ossd(reading_1, reading_2, now)
        if now == self.interlock.heard:  # not an old one
            self._last = ossd
        return self._permit()

    def hear_reset(self, reset: Reset) -> Permit | None:
        """The reset button; no permit before the curtain has been heard."""
        self.resets += 1
        now = self._moment(reset.header.stamp)
        if reset.edge == ResetEdge.PRESSED:
            self.interlock = self.interlock.on_reset_pressed(now)
        elif reset.edge == ResetEdge.RELEASED:
            self.interlock = self.interlock.on_reset_released(now)
        elif reset.edge == ResetEdge.PRESSED_AND_RELEASED:
            self.interlock = self.interlock.on_reset(now)
        return self._permit()

    def hear_emergency_stop(self, stop: EmergencyStop) -> Permit | None:
        """An emergency stop device; no permit before the curtain has been heard."""
        self.emergency_stops += 1
        now = self._moment(stop.header.stamp)
        self.interlock = self.interlock.on_emergency_stop(stop.device, stop.pressed, now)
        return self._permit()

    def hear_muting(self, muting: Muting) -> Permit | None:
        """The muting sensors; no permit before the curtain has been heard."""
        self.mutings += 1
        now = self._moment(muting.header.stamp)
        self.interlock = self.interlock.on_muting(muting.sensor_1, muting.sensor_2, now)
        return self._permit()

    def _moment(self, stamp: Time) -> int:
        """Session time [ns] of a message that the curtain did not send.

        One that runs ahead of the curtain by more than the watch time is wrong, and must not carry the interlock along.
        """
        return min(nanoseconds_of(stamp), (self.interlock.heard or 0) + self.interlock.times.watch)

    def _permit(self) -> Permit | None:
        if self._last is None:
            return None
        interlock, since = self.interlock, nanoseconds_of(self._last.header.stamp)
        until = min(nanoseconds_of(self._last.valid_until), since + self.deadline)
        if interlock.changes_at is not None:
            until = min(until, interlock.changes_at)
        return Permit(
            header=header(since),
            granted=interlock.permits,
            state=interlock.state,
            reason=interlock.reason,
            valid_until=stamp_of(until),
            ossd=self.ossd,
            resets=self.resets,
            emergency_stops=self.emergency_stops,
            mutings=self.mutings,
            stop_category=interlock.stop_category,
            session=self.session,
        )


def times_of(safety: Safety) -> Times:
    """The limits of a cell's interlock."""
    return Times(
        filter_time=round(safety.filter_time * NANOSECONDS),
        discrepancy=round(safety.discrepancy * NANOSECONDS),
        test_interval=round(safety.test_interval * NANOSECONDS),
        watch=round(safety.watch * NANOSECONDS),
        shortest_reset=round(safety.shortest_reset * NANOSECONDS),
        longest_reset=round(safety.longest_reset * NANOSECONDS),
        muting_concurrency=round(safety.muting_concurrency * NANOSECONDS),
        muting_limit=round(safety.muting_limit * NANOSECONDS),
    )
