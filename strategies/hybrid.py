"""Hybrid search: a line and a spiral together."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain, islice, repeat, zip_longest
from typing import Annotated, Literal

from pydantic import Field

from runtime.messages import SearchGoal
from runtime.plugin import Search
from runtime.quantity import Angle, Length, Positive
from strategies.patterns import Offset, line, line_as_printed, spiral_as_printed, spiral_by_angle, spiral_by_arc
from strategies.start import Start, Variant, check, follow, reach_of, start_of


@dataclass(frozen=True)
class Hybrid:
    """Line and spiral from one start: by turns, or the line first and then the spiral.

    The paper describes three methods by this name, `description` chooses one:

    experiments (the list of strategies): one step of the line, one step of the spiral, by turns.
        literal: line of Eqs. 10-11 and spiral of Eqs. 12-17 as printed.
        corrected: stride at most 1.6 feasible radii; spiral in constant steps along it. See linear and spiral.
    algorithm (Algorithm 1): the whole line, then the whole spiral.
        literal: as printed, and while the part is not in, the loop begins again, until the attempts are spent.
        corrected: as in experiments; not again, since what was tried once without success will not do better.
    equations (Eqs. 18-22): the line, then the spiral, both defined anew.
        literal: Eq. 18 oscillates between the start and one stride from it, `cycles` times; Eqs. 19-22 add up their
        radii, so that strides grow and the spiral drifts away.
        corrected: Eq. 18 becomes Eqs. 10-11, which sweep a line, with the stride at most 1.6 feasible radii; Eqs. 21-22
        add their radius to P_0. The angle step stays constant, so gaps grow outwards: `experiments` covers the disc.

    The start is tried once, or once for each time that the loop of Algorithm 1 begins. Starts move as in linear.
    """

    description: Literal["experiments", "algorithm", "equations"] = "experiments"
    stride: Annotated[Length, Positive] = 0.3e-3  # [m] s of the line
    angle: Angle = math.pi / 4  # [rad] of the line to the x axis of base_link
    cycles: Annotated[int, Field(ge=0, le=10_000)] = 60  # m of the line
    radius: Annotated[Length, Positive] | None = None  # [m] of the spiral; none: until the search radius is covered
    pitch: Annotated[float, Positive] = 1.2  # [feasible radii] between turns; Delta r = pitch * step / turn
    arc: Annotated[float, Field(ge=0.05)] = 1.5  # [feasible radii] between attempts along a spiral in constant steps
    step: Annotated[Angle, Field(gt=0.01)] = math.pi / 6  # [rad] between attempts of a spiral in constant angles
    start: Start = "hole"
    variant: Variant = "corrected"

    def search(self, goal: SearchGoal) -> Search:
        """Propose the points of line and spiral within reach. Line points beyond reach cost no turn."""
        check(goal)
        centre = start_of(goal, self.start, self.variant)
        reach = reach_of(goal, centre)

        def within_reach(offsets: Iterator[Offset]) -> Iterator[Offset]:
            return (p for p in offsets if math.hypot(centre[0] + p[0], centre[1] + p[1]) <= reach)

        offsets: Iterator[Offset]

        def one_after_the_other() -> Iterator[Offset]:
            around = within_reach(self._spiral(goal, math.hypot(*centre)))
            return chain(within_reach(self._line(goal)), islice(around, 1, None))  # the line has tried the start

        if self.description == "experiments":
            along, around = within_reach(self._line(goal)), within_reach(self._spiral(goal, math.hypot(*centre)))
            turns = zip_longest(islice(along, 1, None), islice(around, 1, None))
            offsets = chain([(0.0, 0.0)], (point for turn in turns for point in turn if point is not None))
        elif self.description == "algorithm" and self.variant == "literal":
            loop = (point for _ in repeat(None) for point in one_after_the_other())
            offsets = islice(loop, goal.max_attempts)
        else:
            offsets = one_after_the_other()
        yield from follow(goal, centre, offsets)

    def _line(self, goal: SearchGoal) -> Iterator[Offset]:
        if self.variant == "corrected":
            return line(min(self.stride, 1.6 * goal.feasible_radius), self.angle, self.cycles)
        pattern = line_as_printed if self.description == "equations" else line
        return pattern(self.stride, self.angle, self.cycles)

    def _spiral(self, goal: SearchGoal, off_nominal: float) -> Iterator[Offset]:
        radius = self.radius if self.radius is not None else goal.search_radius + off_nominal
        pitch = self.pitch * goal.feasible_radius
        if self.description == "equations":
            pattern = spiral_as_printed if self.variant == "literal" else spiral_by_angle
            return pattern(self.step, pitch, radius)
        if self.variant == "literal":
            return spiral_by_angle(self.step, pitch, radius)
        return spiral_by_arc(self.arc * goal.feasible_radius, pitch, radius)
