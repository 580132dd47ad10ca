"""Linear search: along one line, to both sides in turn."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from runtime.messages import SearchGoal
from runtime.plugin import Search
from runtime.quantity import Angle, Length, Positive
from strategies.patterns import line
from strategies.start import Start, Variant, check, follow, start_of


@dataclass(frozen=True)
class Linear:
    """Sweeps one line to both sides of its start (Eqs. 10-11); finds only holes that lie near it.

    literal: the equations with the stride as set, about the mean of the candidates that succeeded.
    corrected: the stride is at most 1.6 feasible radii, because wider ones step over holes on the line; the start is
    the mean of the seated positions. The text calls the stride "the distance between two successive points"; by the
    equations that distance is stride * i, and the equations are what sweeps a line: with the text's distance it would
    be Eq. 18, which hybrid offers. `cycles` is the paper's m: the search ends after m + 1 attempts at most.

    The list of strategies in the experiments gives no moving start to the line (`start = "nominal"`), a later
    paragraph gives all three the mean of earlier positions (`hole`, the default, or `pooled`).
    """

    stride: Annotated[Length, Positive] = 0.3e-3  # [m] s
    angle: Angle = math.pi / 4  # [rad] theta, of the line to the x axis of base_link
    cycles: Annotated[int, Field(ge=0, le=10_000)] = 60  # m
    start: Start = "hole"
    variant: Variant = "corrected"

    def search(self, goal: SearchGoal) -> Search:
        """Propose the points of the line within reach."""
        check(goal)
        stride = self.stride if self.variant == "literal" else min(self.stride, 1.6 * goal.feasible_radius)
        yield from follow(goal, start_of(goal, self.start, self.variant), line(stride, self.angle, self.cycles))
