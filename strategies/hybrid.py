"""Hybrid search: a line and a spiral together."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain, islice, zip_longest
from typing import Annotated, Literal

from pydantic import Field

from runtime.messages import SearchGoal
from runtime.plugin import Search
from runtime.quantity import Angle, Length, Positive
from strategies.patterns import Offset, line, line_as_printed, spiral_as_printed, spiral_by_arc
from strategies.start import Start, Variant, check, follow, reach_of, start_of


@dataclass(frozen=True)
class Hybrid:
    """Line and spiral from one start: by turns, one step each, or the line first (Algorithm 1).

    The paper describes three methods by this name: its experiments take one step of each in turn (`alternate`, the
    default), Algorithm 1 sends the line first and the spiral after it (`sequence`), and Eqs. 18-22 define both parts
    anew. literal: those equations as printed, where the line oscillates between two points and the spiral adds up its
    radii and drifts away. corrected: the line of Eqs. 10-11 with at most 1.6 feasible radii between points, and the
    spiral of Eqs. 12-17 in constant steps along it. Line points beyond reach cost no turn.
    """

    order: Literal["alternate", "sequence"] = "alternate"
    stride: Annotated[Length, Positive] = 0.3e-3  # [m] s of the line
    angle: Angle = math.pi / 4  # [rad] of the line to the x axis of base_link
    cycles: Annotated[int, Field(ge=0, le=10_000)] = 60  # m of the line
    radius: Annotated[Length, Positive] | None = None  # [m] of the spiral; none: until the search radius is covered
    pitch: Annotated[float, Positive] = 1.2  # [feasible radii] between turns of the spiral
    arc: Annotated[float, Field(ge=0.05)] = 1.5  # [feasible radii] between attempts along the spiral (corrected)
    step: Annotated[Angle, Field(gt=0.01)] = math.pi / 6  # [rad] between attempts of the spiral (literal)
    start: Start = "hole"
    variant: Variant = "corrected"

    def search(self, goal: SearchGoal) -> Search:
        """Propose the start once, then the other points of line and spiral within reach."""
        check(goal)
        centre = start_of(goal, self.start, self.variant)
        reach = reach_of(goal, centre)

        def within_reach(offsets: Iterator[Offset]) -> Iterator[Offset]:
            return (p for p in offsets if math.hypot(centre[0] + p[0], centre[1] + p[1]) <= reach)

        along, around = within_reach(self._line(goal)), within_reach(self._spiral(goal, math.hypot(*centre)))
        around = islice(around, 1, None)  # the line has tried the start
        if self.order == "sequence":
            offsets = chain(along, around)
        else:
            turns = zip_longest(islice(along, 1, None), around)
            offsets = chain([(0.0, 0.0)], (point for turn in turns for point in turn if point is not None))
        yield from follow(goal, centre, offsets)

    def _line(self, goal: SearchGoal) -> Iterator[Offset]:
        if self.variant == "literal":
            return line_as_printed(self.stride, self.angle, self.cycles)
        return line(min(self.stride, 1.6 * goal.feasible_radius), self.angle, self.cycles)

    def _spiral(self, goal: SearchGoal, off_nominal: float) -> Iterator[Offset]:
        radius = self.radius if self.radius is not None else goal.search_radius + off_nominal
        pitch = self.pitch * goal.feasible_radius
        if self.variant == "literal":
            return spiral_as_printed(self.step, pitch, radius)
        return spiral_by_arc(self.arc * goal.feasible_radius, pitch, radius)
