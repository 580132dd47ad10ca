"""Spiral search: outwards along an Archimedean spiral."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from runtime.messages import SearchGoal
from runtime.plugin import Search
from runtime.quantity import Angle, Length, Positive
from strategies.patterns import spiral_by_angle, spiral_by_arc
from strategies.start import Start, Variant, check, follow, start_of


@dataclass(frozen=True)
class Spiral:
    """Walks outwards on an Archimedean spiral (Eqs. 12-17) until its radius is searched.

    literal: constant angle between attempts (Eq. 14), about the mean of the candidates that succeeded; attempts crowd
    at the centre and leave gaps that grow outwards. corrected: constant distance along the spiral, so that the disc is
    covered without gaps, about the mean of the seated positions. The text mixes numbered cycles with a push that never
    ends; both variants try point by point.

    The paper's r is `radius`, its t is `turns`, its theta_d is `step`; r_d of Eq. 13 is r / (t * 360 deg).
    """

    radius: Annotated[Length, Positive] | None = None  # [m] r; none: until the goal's search radius is covered
    turns: Annotated[float, Positive] | None = None  # t of Eq. 12, which makes the pitch r / t; none: `pitch` says it
    pitch: Annotated[float, Positive] = 1.2  # [feasible radii] between turns
    arc: Annotated[float, Field(ge=0.05)] = 1.5  # [feasible radii] between attempts along the spiral (corrected)
    step: Annotated[Angle, Field(gt=0.01)] = math.pi / 6  # [rad] theta_d between attempts (literal)
    start: Start = "hole"
    variant: Variant = "corrected"

    def search(self, goal: SearchGoal) -> Search:
        """Propose the points of the spiral within reach."""
        check(goal)
        centre = start_of(goal, self.start, self.variant)
        radius = self.radius if self.radius is not None else goal.search_radius + math.hypot(*centre)
        pitch = radius / self.turns if self.turns is not None else self.pitch * goal.feasible_radius
        if self.variant == "literal":
            offsets = spiral_by_angle(self.step, pitch, radius)
        else:
            offsets = spiral_by_arc(self.arc * goal.feasible_radius, pitch, radius)
        yield from follow(goal, centre, offsets)
