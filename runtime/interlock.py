"""The safety state machine, pure: which states there are and what leads from one to another. Names after IEC 61496-1.

    state      both channels on    a channel off    disagree too long    reset, both on    reset otherwise
    LOCKED     LOCKED              TRIPPED          FAULT                PERMITTED         LOCKED
    PERMITTED  PERMITTED           TRIPPED          FAULT                PERMITTED         -
    TRIPPED    LOCKED              TRIPPED          FAULT                -                 TRIPPED
    FAULT      FAULT               FAULT            FAULT                LOCKED            FAULT

It begins TRIPPED: nothing is known of the field yet. Motion is permitted in PERMITTED alone, and only a reset given
while the field is clear leads there (restart interlock).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from runtime.messages import SafetyState

REASONS = {
    SafetyState.LOCKED: "field clear, waiting for reset",
    SafetyState.PERMITTED: "field clear",
    SafetyState.TRIPPED: "light field interrupted",
    SafetyState.FAULT: "the two channels disagree; reset once both are on",
}


@dataclass(frozen=True)
class Interlock:
    """State of the interlock."""

    discrepancy: int  # [ns] the channels may disagree this long while they switch
    state: SafetyState = SafetyState.TRIPPED
    clear: bool = False  # both channels were on when last heard
    disagree_since: int | None = None  # [ns] session time

    @property
    def permits(self) -> bool:
        """Whether motion is allowed."""
        return self.state is SafetyState.PERMITTED

    @property
    def reason(self) -> str:
        """The state in words."""
        return REASONS[self.state]

    def on_ossd(self, channel_1: bool, channel_2: bool, now: int) -> Interlock:
        """The curtain's outputs at session time `now` [ns]."""
        since = None if channel_1 == channel_2 else (now if self.disagree_since is None else self.disagree_since)
        heard = replace(self, clear=channel_1 and channel_2, disagree_since=since)
        if self.state is SafetyState.FAULT or (since is not None and now - since > self.discrepancy):
            return replace(heard, state=SafetyState.FAULT)
        if not heard.clear:
            return replace(heard, state=SafetyState.TRIPPED)
        if self.state is SafetyState.TRIPPED:
            return replace(heard, state=SafetyState.LOCKED)
        return heard

    def on_reset(self) -> Interlock:
        """The restart button was pressed and released."""
        if not self.clear:
            return self
        if self.state is SafetyState.LOCKED:
            return replace(self, state=SafetyState.PERMITTED)
        if self.state is SafetyState.FAULT:
            return replace(self, state=SafetyState.LOCKED)
        return self
