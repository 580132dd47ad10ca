"""The limits of a world as a piece of work: computed in parallel with the trials, and kept."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from runtime.experiment.limit import Limits, limits_of
from runtime.experiment.worlds import NamedWorld


@dataclass(frozen=True)
class LimitWork:
    """How few attempts any strategy could do with in a world."""

    world: NamedWorld
    component: str
    boards: int

    @property
    def content(self) -> Mapping[str, Any]:
        """The world, without its name; limits hold for every seed."""
        return {"cell": self.world.cell(self.component, seed=0, boards=self.boards)}

    @property
    def code(self) -> tuple[str, ...]:
        """The module of the limits."""
        return (limits_of.__module__,)

    def run(self) -> Limits:
        """Mean attempts for each insertion: the oracle's, a rigorous lower bound, and the best that is known."""
        return limits_of(self.world, self.component, self.boards)
