"""Where a search begins, how far it may go, and how a pattern of offsets becomes proposals."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from itertools import islice
from typing import Literal

from runtime.belief import disc_mass, seat_points
from runtime.errors import InputError
from runtime.messages import Gaussian, Proposal, SearchGoal
from runtime.plugin import Search
from strategies.patterns import Offset

Variant = Literal["corrected", "literal"]
Start = Literal["hole", "pooled", "nominal", "posterior"]
"""The paper starts line, spiral and hybrid "at the mean of all preceding positions" without saying whose.

hole: mean of this hole's earlier insertions; pooled: of all holes' insertions; nominal: never moves;
posterior: mean of the posterior store's belief, `goal.prior`. Without evidence of its kind each is nominal.

Its list of strategies gives a moving start to the spiral alone, so a line from `nominal` is as much the paper's as one
from `hole`. A remark that they start from "an average or median" is not followed: the mean is what it defines.
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
    points = ((centre[0] + dx, centre[1] + dy) for dx, dy in offsets)
    yield from propose(goal, (point for point in points if math.hypot(*point) <= reach), goal.prior)


def propose(goal: SearchGoal, points: Iterator[Offset], belief: Gaussian) -> Search:
    """Propose each point [m] in turn with its probability under `belief`, if that claims a distribution."""
    if not belief.known:
        for x, y in points:
            yield Proposal(x, y)
        return
    ahead = 4  # points whose masses are computed at once: eight cost little more than one, but most searches are short
    while batch := list(islice(points, ahead)):
        for (x, y), mass in zip(batch, disc_mass(belief, batch, goal.feasible_radius), strict=True):
            yield Proposal(x, y, probability=float(mass), belief=belief)
        ahead = min(2 * ahead, 64)
