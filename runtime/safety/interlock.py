"""The safety state machine, pure: which states there are and what leads from one to another.

Names after IEC 61496-1 (OSSD, restart interlock, muting) and IEC 60204-1 (stop categories, emergency stop). It begins
TRIPPED: nothing is known of the field yet. Motion is permitted in PERMITTED and MUTED alone. This is the whole of it; a
column is a state before the input, a cell the state after it:

    T TRIPPED    the light field is interrupted, or nothing is heard of it
    L LOCKED     restart interlock: all is well, a reset is awaited
    P PERMITTED  motion is permitted
    M MUTED      motion is permitted and the light curtain set aside, the field is clear;  m: the field is interrupted
    F FAULT      the curtain or its wiring cannot be trusted, and still looks so;  f: looks well again
    E EMERGENCY_STOP  pressed, the field is clear;  e: the field is interrupted;  x: a fault is latched as well

    input                                              |  T  L  P  M  m  F  f  E  e  x
    ---------------------------------------------------+------------------------------
    both channels on                                   |  L  L  P  M  M  f  f  E  E  x
    off pulse up to the filter time, on again          |  L  L  P  M  M  f  f  E  E  x
    off pulse beyond the filter time, on again         |  L  L  L  M  M  f  f  E  E  x
    off pulse that may yet stay in the filter time     |  T  L  P  M  m  F  f  E  e  x
    off pulse outlasts the filter time                 |  T  T  T  m  m  F  F  e  e  x
    both channels off                                  |  T  T  T  m  m  F  F  e  e  x
    one channel off                                    |  T  T  T  m  m  F  F  e  e  x
    one channel off beyond the discrepancy time        |  F  F  F  F  F  F  F  x  x  x
    one channel's off pulse beyond discrepancy time    |  f  f  f  f  f  f  f  x  x  x
    on without a test pulse beyond the test interval   |  F  F  F  F  F  F  F  x  x  x
    nothing heard beyond the watch time                |  T  T  T  T  T  F  F  e  e  x
    reset                                              |  T  P  P  M  m  F  L  E  e  x
    reset button pressed                               |  T  L  P  M  m  F  f  E  e  x
    reset button released after too short a time       |  T  L  P  M  m  F  f  E  e  x
    reset button released after too long a time        |  T  L  P  M  m  F  f  E  e  x
    reset button pressed too early, released now       |  T  L  P  M  m  F  f  E  e  x
    emergency stop pressed                             |  e  E  E  E  e  x  x  E  e  x
    emergency stop released                            |  T  L  P  M  m  F  f  L  T  f
    muting sensors actuated within concurrency         |  T  L  M  M  m  F  f  E  e  x
    muting sensors actuated too far apart              |  T  L  P  P  T  F  f  E  e  x
    a muting sensor released                           |  T  L  P  P  T  F  f  E  e  x
    muting limit passes                                |  T  L  P  P  T  F  f  E  e  x

A reset counts when the button is released, if it was pressed while the field was clear, the channels were tested and no
emergency stop was pressed, and all of that lasted until the release. From FAULT it leads to LOCKED, from where a second
one is needed. A stop is of category 2 (standstill under power, path kept), and of category 1 once an emergency stop was
pressed, until motion is permitted again.

What was heard last holds until something else is heard; `changes_at` says when it can hold no longer, by time alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

from runtime.messages import SafetyState
from runtime.safety.muting import NOT_MUTED, Muting

EMERGENCY_CATEGORY = 1  # stop category of IEC 60204-1 for an emergency stop: braked on the path, then without power
PROTECTIVE_CATEGORY = 2  # for the light curtain: standstill under power


@dataclass(frozen=True)
class Times:
    """Limits of the interlock [ns]."""

    filter_time: int = 1_000_000  # an off pulse up to this long is a test; curtains send at most 0.35 ms
    discrepancy: int = 50_000_000  # the channels may disagree this long while they switch
    test_interval: int = 1_000_000_000  # a channel that stays on is seen off in a test pulse at least this often
    watch: int = 2_000_000_000  # a curtain that says nothing for longer counts as interrupted
    shortest_reset: int = 30_000_000  # a press below this is contact bounce (assumed, as safety controllers have it)
    longest_reset: int = 3_000_000_000  # a press beyond this is a button that is stuck or tied down (assumed, as above)
    muting_concurrency: int = (
        4_000_000_000  # the second muting sensor follows the first within it; see runtime.safety.muting
    )
    muting_limit: int = 30_000_000_000  # muting lasts no longer


class Fault(Enum):
    """Why the curtain cannot be trusted."""

    DISCREPANCY = "the two channels disagree"
    CHANNEL_1_STUCK = "channel 1 shows no test pulses: it may be stuck on"
    CHANNEL_2_STUCK = "channel 2 shows no test pulses: it may be stuck on"


@dataclass(frozen=True)
class Reading:
    """What an input shows of one channel at a moment."""

    on: bool
    off_for: int = 0  # [ns] length so far of the off pulse it is in, or the longest since the last reading; 0: none
    tested: int = 0  # [ns] session time at which it was last seen off


@dataclass(frozen=True)
class Channel:
    """One of the two output signal switching devices, as far as it is known. Times are session time [ns]."""

    on: bool = False  # after the filter
    pulse_since: int | None = None  # in an off pulse that may yet be a test
    tested: int = 0  # last seen off

    def read(self, reading: Reading, now: int, filter_time: int) -> Channel:
        """The channel after a reading. Only one that is on can be in a test pulse."""
        tested = max(self.tested, min(reading.tested, now) if reading.on else now)
        pulse = not reading.on and self.on and 0 < reading.off_for <= filter_time
        return Channel(reading.on or pulse, now - reading.off_for if pulse else None, tested)

    def dip(self, reading: Reading, filter_time: int) -> Channel:
        """The channel before a reading that tells of an off pulse since the last one."""
        return self.off() if reading.off_for > filter_time else self

    def at(self, now: int, filter_time: int) -> Channel:
        """The same at session time `now`, when a pulse may have outlasted the filter."""
        if self.pulse_since is None or now - self.pulse_since <= filter_time:
            return self
        return self.off()

    def off(self) -> Channel:
        """The same, switched off."""
        return Channel(False, None, self.tested)


@dataclass(frozen=True)
class Interlock:
    """State of the interlock. Every input gives the state that follows it; all times are session time [ns]."""

    times: Times = Times()
    now: int = 0  # the latest moment that anything was heard of
    heard: int | None = None  # when the curtain last spoke
    channel_1: Channel = Channel()
    channel_2: Channel = Channel()
    disagree_since: int | None = None
    fault: Fault | None = None  # latched
    emergency_stops: frozenset[str] = frozenset()  # devices that are pressed
    restarted: bool = False  # a reset was given and nothing has stopped motion since
    emergency_latched: bool = False  # an emergency stop was pressed since motion was last permitted
    held: bool = False  # the reset button is down
    pressed_at: int | None = None  # since when, if this press can still become a reset
    muting: Muting = NOT_MUTED

    @property
    def state(self) -> SafetyState:
        """Where it stands."""
        if self.emergency_stops:
            return SafetyState.EMERGENCY_STOP
        if self.fault is not None:
            return SafetyState.FAULT
        if self.muting.active:
            return SafetyState.MUTED
        if not self.clear:
            return SafetyState.TRIPPED
        return SafetyState.PERMITTED if self.restarted else SafetyState.LOCKED

    @property
    def permits(self) -> bool:
        """Whether motion is allowed."""
        return self.state in (SafetyState.PERMITTED, SafetyState.MUTED)

    @property
    def stop_category(self) -> int:
        """Category after IEC 60204-1 of the stop in force, or of the one that would follow if the permit ended."""
        return EMERGENCY_CATEGORY if self.emergency_latched else PROTECTIVE_CATEGORY

    @property
    def reason(self) -> str:
        """The state in words."""
        match self.state:
            case SafetyState.EMERGENCY_STOP:
                return f"emergency stop pressed: {', '.join(sorted(self.emergency_stops))}"
            case SafetyState.FAULT:
                assert self.fault is not None
                return f"{self.fault.value}; " + ("reset" if self.resettable else "reset once both are on and tested")
            case SafetyState.MUTED:
                return "field clear, muting" if self.clear else "light field interrupted, muted"
            case SafetyState.PERMITTED:
                return "field clear"
            case SafetyState.LOCKED:
                released = "emergency stop released, " if self.emergency_latched else ""
                return f"{released}field clear, waiting for reset"
        return "light field interrupted" if self._spoken_for(self.now) else "no word from the light curtain"

    @property
    def clear(self) -> bool:
        """Whether the light field is known to be clear."""
        return self.channel_1.on and self.channel_2.on

    @property
    def resettable(self) -> bool:
        """Whether a reset given now would count."""
        return self.clear and not self.emergency_stops and self._untested() is None

    @property
    def changes_at(self) -> int | None:
        """First moment at which what was heard no longer tells the state; None before anything was heard."""
        times, moments = self.times, list[int]()
        if self.muting.since is not None:
            moments.append(self.muting.since + times.muting_limit + 1)
        if self.heard is not None:
            moments.append(self.heard + times.watch + 1)
        if self.fault is None and self.disagree_since is not None:
            moments.append(self.disagree_since + times.discrepancy + 1)
        for channel in (self.channel_1, self.channel_2):
            if channel.on:
                moments.append(channel.tested + times.test_interval + 1)
            if channel.pulse_since is not None:
                moments.append(channel.pulse_since + times.filter_time + 1)
        return min((moment for moment in moments if moment > self.now), default=None)

    def advance(self, now: int) -> Interlock:
        """The same at session time `now`, when nothing more was heard until then."""
        passed, filter_time = self._passed(now), self.times.filter_time
        return passed._switched(
            passed.channel_1.at(passed.now, filter_time), passed.channel_2.at(passed.now, filter_time)
        )

    def on_ossd(self, reading_1: Reading, reading_2: Reading, at: int) -> Interlock:
        """The curtain's two channels at session time `at`. A word that is older than the last is not heard."""
        if self.heard is not None and at < self.heard:
            return self
        known, filter_time = self._passed(at), self.times.filter_time
        if abs(reading_1.off_for - reading_2.off_for) > self.times.discrepancy:
            known = replace(known, fault=known.fault or Fault.DISCREPANCY)
        dipped = known._switched(
            known.channel_1.dip(reading_1, filter_time), known.channel_2.dip(reading_2, filter_time)
        )
        return replace(dipped, heard=at, disagree_since=known.disagree_since)._switched(
            dipped.channel_1.read(reading_1, at, filter_time), dipped.channel_2.read(reading_2, at, filter_time)
        )

    def on_reset(self, now: int) -> Interlock:
        """A reset button that reports no more than that it was pressed and released in proper time."""
        return self.advance(now)._reset()

    def on_reset_pressed(self, now: int) -> Interlock:
        """The reset button went down at session time `now`. Too early, the press is void."""
        known = self.advance(now)
        if known.held:
            return known
        return replace(known, held=True, pressed_at=now if known.resettable else None)

    def on_reset_released(self, now: int) -> Interlock:
        """The reset button came up at session time `now`: a reset, if it was down for a proper time."""
        known = self.advance(now)
        released = replace(known, held=False, pressed_at=None)
        if known.pressed_at is None:
            return released
        if not self.times.shortest_reset <= now - known.pressed_at <= self.times.longest_reset:
            return released
        return released._reset()

    def on_emergency_stop(self, device: str, pressed: bool, now: int) -> Interlock:
        """An emergency stop device is pressed or released; released, each still asks for a reset."""
        known = self.advance(now)
        others = known.emergency_stops - {device}
        return replace(known, emergency_stops=others | {device} if pressed else others)._latched()

    def on_muting(self, sensor_1: bool, sensor_2: bool, now: int) -> Interlock:
        """The two muting sensors: whether each is actuated."""
        known = self.advance(now)
        may_begin = known.state is SafetyState.PERMITTED
        concurrency = self.times.muting_concurrency
        muting = known.muting.on_sensors(sensor_1, sensor_2, known.now, concurrency, may_begin=may_begin)
        return replace(known, muting=muting)._latched()

    def _passed(self, now: int) -> Interlock:
        """Session time has come to `now`. What the curtain's next word tells of the time between is left to it."""
        later, fault = max(self.now, now), self.fault
        if self.disagree_since is not None and later - self.disagree_since > self.times.discrepancy:
            fault = fault or Fault.DISCREPANCY
        passed = replace(self, now=later, fault=fault, muting=self.muting.at(later, self.times.muting_limit))
        if not self._spoken_for(later):
            channel_1, channel_2 = self.channel_1.off(), self.channel_2.off()
            passed = replace(passed, channel_1=channel_1, channel_2=channel_2, muting=passed.muting.ended())
        return passed._latched()

    def _switched(self, channel_1: Channel, channel_2: Channel) -> Interlock:
        """With the channels as they are at `now`."""
        agree = channel_1.on == channel_2.on
        since = None if agree else (self.now if self.disagree_since is None else self.disagree_since)
        switched = replace(self, channel_1=channel_1, channel_2=channel_2, disagree_since=since)
        return replace(switched, fault=switched.fault or switched._untested())._latched()

    def _latched(self) -> Interlock:
        """With the consequences of what is now known: what ends motion ends the restart, and voids a press of reset."""
        stopped = self.fault is not None or bool(self.emergency_stops)
        muting = self.muting.ended() if stopped else self.muting
        return replace(
            self,
            muting=muting,
            restarted=self.restarted and not stopped and (self.clear or muting.active),
            emergency_latched=self.emergency_latched or bool(self.emergency_stops),
            pressed_at=self.pressed_at if self.resettable else None,
        )

    def _reset(self) -> Interlock:
        if not self.resettable:
            return self
        if self.fault is not None:
            return replace(self, fault=None, pressed_at=None)
        if self.restarted:
            return self
        return replace(self, restarted=True, emergency_latched=False, pressed_at=None)

    def _untested(self) -> Fault | None:
        """The fault of a channel that the curtain's last word shows on for too long without a test pulse."""
        for channel, fault in ((self.channel_1, Fault.CHANNEL_1_STUCK), (self.channel_2, Fault.CHANNEL_2_STUCK)):
            if channel.on and self.heard is not None and self.heard - channel.tested > self.times.test_interval:
                return fault
        return None

    def _spoken_for(self, now: int) -> bool:
        """Whether the curtain's last word is young enough."""
        return self.heard is not None and now - self.heard <= self.times.watch
