"""Bayes search: a belief about the whole board, and the next position where it is most likely to pay."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from runtime.messages import SearchGoal
from runtime.plugin import Search
from runtime.quantity import Duration, Length, Positive, Speed
from strategies.learning import Reading
from strategies.pursuit import Pursuit


@dataclass(frozen=True)
class Bayes:
    """Learns how boards lie, holes stray and parts scatter, from failures too, and tries what pays most per second.

    The belief is hierarchical (`runtime.hierarchy`): the shift and rotation of the board are shared by its holes, each
    hole has a bias that lasts, each part scatters. Within a search every failure removes what it has ruled out, with
    the feasible area's true shape. The next position maximises the probability of insertion per second.

    The model may be wrong: after `patience` attempts every other one, and after three times as many every one, belongs
    to a sweep that finds any hole within the search radius. Where the search before found nothing either, so that the
    board may be the wrong one, the sweep begins sooner and is brief.
    """

    patience: Annotated[int, Field(ge=1, le=10_000)] = 60  # attempts
    size: Annotated[float, Field(ge=0.5, le=1.5)] = 0.97  # of the stated feasible area's half axes: parts are turned
    size_spread: Annotated[float, Field(ge=0.02, le=0.5)] = 0.15  # of them, from part to part
    slide_noise: Annotated[Length, Positive] = 0.09e-3  # [m] per axis, of a slid part's position as a hole's centre
    peck_time: Annotated[Duration, Positive] = 0.37  # [s] that a failure takes
    travel_speed: Annotated[Speed, Positive] = 0.05  # [m/s] between positions

    def search(self, goal: SearchGoal) -> Search:
        """Propose positions until the search radius is swept."""
        pursuit = Pursuit(goal, self.size, Reading(self.size_spread, self.slide_noise))
        number = 0
        while True:
            number += 1
            if pursuit.guard_is_due(number, self.patience):
                point = pursuit.guarded()
                if point is None:
                    return
            else:
                point = pursuit.worthiest(self.peck_time, self.travel_speed)
            yield pursuit.attempt([point])
            pursuit.failed([point])
