"""Where a search begins, how far it may go, and how a pattern of offsets becomes proposals."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Literal

from runtime.belief import disc_mass, seat_points
from runtime.errors import InputError
from runtime.messages import Gaussian, Proposal, SearchGoal
from runtime.plugin import Search
from strategies.patterns import Offset

Variant = Literal["corrected", "literal"]
Start = Literal["hole", "pooled", "nominal", "posterior"]
"""The paper starts "at the mean of all preceding positions" without saying whose:

hole: mean of this hole's earlier insertions; pooled: of all holes' insertions; nominal: never moves;
posterior: mean of the posterior store's belief, `goal.prior`. Without evidence of its kind each is nominal.
"""


def start_of(goal: SearchGoal, start: Start, variant: Variant) -> Offset:
    """Offset of the first attempt from nominal [m].

    The literal variant averages the candidates that succeeded, as the paper does; the corrected one averages where
    the seated parts came to rest, because a candidate may succeed from anywhere within the feasible radius.
    """
    if start == "posterior":
        mean = (goal.prior.x, goal.prior.y)
        return mean if goal.prior.known and all(map(math.isfinite, mean)) else (0.0, 0.0)
    if start == "nominal":
        return (0.0, 0.0)
    seats = [seat for seat in goal.seats if start == "pooled" or seat.hole == goal.hole]
    points = seat_points(seats, seated=variant == "corrected")
    if not len(points):
        return (0.0, 0.0)
    x, y = points.mean(axis=0)
    return (float(x), float(y))


def reach_of(goal: SearchGoal, centre: Offset) -> float:
    """How far from nominal a proposal may lie [m].

    The goal's search radius; but if what was learnt lies outside it, two feasible radii beyond that, so that the
    search can still circle its own centre.
    """
    distance = math.hypot(*centre)
    return goal.search_radius if distance <= goal.search_radius else distance + 2 * goal.feasible_radius


def check(goal: SearchGoal) -> None:
    """InputError unless the goal's radii are positive lengths: patterns are scaled by them."""
    for name in ("feasible_radius", "search_radius"):
        value = getattr(goal, name)
        if not (math.isfinite(value) and value > 0):
            raise InputError(f"search {goal.search}: {name} must be a positive length, not {value} m")


def follow(goal: SearchGoal, centre: Offset, offsets: Iterable[Offset]) -> Search:
    """Propose `centre` plus each offset [m] in turn, leaving out those beyond reach."""
    reach = reach_of(goal, centre)
    for dx, dy in offsets:
        x, y = centre[0] + dx, centre[1] + dy
        if math.hypot(x, y) <= reach:
            yield propose(goal, x, y, goal.prior)


def propose(goal: SearchGoal, x: float, y: float, belief: Gaussian) -> Proposal:
    """A proposal at (x, y) [m] with its probability under `belief`, if that claims a distribution."""
    if not belief.known:
        return Proposal(x, y)
    return Proposal(x, y, probability=float(disc_mass(belief, (x, y), goal.feasible_radius)[0]), belief=belief)
