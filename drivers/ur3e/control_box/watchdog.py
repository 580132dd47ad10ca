"""RTDE watchdog: a program ends or pauses when a client no longer feeds it (URScript manual, rtde_set_watchdog)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

Action = Literal["ignore", "pause", "stop"]
ACTIONS: tuple[Action, ...] = get_args(Action)


@dataclass
class Watchdog:
    """One watched input field."""

    variable: str
    period: float  # [s] within which the field has to come again
    action: Action
    _count: int  # packages seen with the field
    _since: float  # [s] controller time of the last one

    @staticmethod
    def on(variable: str, frequency: float, action: Action, count: int, now: float) -> Watchdog:
        """Watch from now on; `frequency` [Hz] is the lowest that will do."""
        return Watchdog(variable, 1.0 / frequency, action, count, now)

    def bites(self, count: int, now: float) -> bool:
        """Whether the field has been missing for too long."""
        if count != self._count:
            self._count, self._since = count, now
        return now - self._since > self.period
