"""Muting: the light curtain is set aside for a while because two sensors see material, and nobody, pass through it.

Names after IEC 61496-1 (annex A) and IEC 62046, which ask for two independent signals and for an end of muting that
does not hang on these signals alone, and leave the numbers to the risk assessment. Assumed here:

- concurrency: both sensors are actuated within 4 s of each other, as safety controllers commonly have it. A sensor
  that is stuck thus never mutes.
- limit: muting ends after 30 s at the latest. A board on a conveyor passes in less; controllers commonly allow 10 min.

What muting may not do is decided by who asks: `runtime.safety.interlock` lets it begin in PERMITTED alone, and
ends it with any other stop.
"""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Muting:
    """The two muting sensors, and whether they mute. Times are session time [ns]."""

    sensor_1_since: int | None = None  # [ns] actuated since; None: not actuated
    sensor_2_since: int | None = None
    since: int | None = None  # [ns] muted since

    @property
    def active(self) -> bool:
        """Whether an interrupted light field is to be passed over."""
        return self.since is not None

    def on_sensors(self, sensor_1: bool, sensor_2: bool, now: int, concurrency: int, *, may_begin: bool) -> Muting:
        """The sensors at session time `now`: muting begins as the second is actuated, and ends as one is released."""
        first, second = _since(self.sensor_1_since, sensor_1, now), _since(self.sensor_2_since, sensor_2, now)
        heard = replace(self, sensor_1_since=first, sensor_2_since=second)
        if first is None or second is None:
            return heard.ended()
        seen_before = self.sensor_1_since is not None and self.sensor_2_since is not None
        if seen_before or not may_begin or abs(first - second) > concurrency:
            return heard
        return replace(heard, since=now)

    def at(self, now: int, limit: int) -> Muting:
        """The same at session time `now`, when `limit` [ns] may have passed."""
        return self if self.since is None or now - self.since <= limit else self.ended()

    def ended(self) -> Muting:
        """Muted no more; both sensors must be actuated anew."""
        return replace(self, since=None)


NOT_MUTED = Muting()


def _since(before: int | None, actuated: bool, now: int) -> int | None:
    if not actuated:
        return None
    return now if before is None else before
