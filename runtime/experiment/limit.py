"""How few attempts any strategy could do with in a world: a bound that none can beat, and the best that is known.

Nothing else than pecks is meant: one slide tries many places. Two figures for each search, and their means:

- `bound` holds for every strategy that inserts every part and learns of it, at most, where exactly the part sat.
  Before a search the place is then normal with a covariance that does not depend on what was found (`predicted`), and
  n attempts hold at most the mass of the best set of n times the feasible area. Errors of fixed length, which are not
  normal, are given away once they have been met; the search that meets one first has a ring for a density. With
  heavy-tailed scatter each part's own width is given away too, and the places of the holes themselves. To first order
  in the boards' rotation.
- `estimate`, the estimated limit, is what the best cover found (`cover`) of the same density takes. It knows the true
  distributions of everything and the exact places of all earlier parts. It does not know the size of the hole's area in
  hand, only how sizes are distributed: the plated holes' radii and the turn of part against hole are drawn anew for
  each search. To know exact places is a little more than can be had, and the turn that a board's earlier holes would
  tell is left unused; a better cover may exist, so it is no bound. An error of fixed length counts as normal with the
  same mean square in all searches but the one that meets it first. Integrals and table are good to some 1 %.

There is no estimate, but nan, where scatter has heavy tails: the density of the next place then depends on what was
found. There is neither where the common error exceeds the search radius: nobody finds what lies out of reach.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, norm

from runtime.assembly import goal_for
from runtime.cell import HOLE_RADIUS_LIMIT, Board, Tolerances
from runtime.component import Component, component, feasible_area
from runtime.experiment.cover import Density, Shape, Sizes, bound, bound_of, fewest, reduced, ring_density
from runtime.experiment.cover_table import CoverTable
from runtime.experiment.worlds import NamedWorld
from runtime.feasible_area import FeasibleArea, area_of
from runtime.messages import Belief, Gaussian, header

Array = NDArray[np.float64]
Rows = tuple[tuple[float, ...], ...]

_NODES = 5  # sizes that stand for their distribution where a ring is covered
_WIDTHS_OF_TAILS = 400  # at even steps of probability; what they leave out of the tail only lowers the bound


@dataclass(frozen=True)
class Limits:
    """Mean attempts for each insertion, over boards and holes."""

    oracle: float  # of who knows every place
    bound: float
    estimate: float
    bounds: Rows  # boards x holes
    estimates: Rows


@dataclass(frozen=True, eq=False)
class Predicted:
    """What is not known of a part's place before its search, from the exact places of all parts before it."""

    place: Array  # (boards, holes, 2, 2) [m^2] covariance of the hole's offset
    scatter: Array  # (holes,) [m^2] variance of the part's own offset, per axis; of its normal share if tails are heavy

    @property
    def covariance(self) -> Array:
        """(boards, holes, 2, 2) [m^2] of the part's place."""
        return np.asarray(self.place + self.scatter[:, None, None] * np.eye(2))


def predicted(board: Board, tolerances: Tolerances, boards: int, *, given: bool = False) -> Predicted:
    """Covariances of a linear normal model of `runtime.world`, by a Kalman filter over the searches in their order.

    offset = common error + (board - 1) drift + jump + shift + rotation lever + bias + scatter, with errors of fixed
    length as normal ones of the same mean square. `given`: those are known, and with heavy tails so is every earlier
    part's scatter.
    """
    count, shift, bias = len(board.holes), slice(6, 9), slice(9, None)  # 0-5: common error, drift, jump
    fixed = (tolerances.common_error, tolerances.drift, tolerances.jump)
    variances = np.zeros(9 + 2 * count)
    variances[:6] = 0.0 if given else np.repeat(np.square(fixed) / 2, 2)
    board_variances = np.square([tolerances.board_shift, tolerances.board_shift, tolerances.board_rotation])
    variances[bias] = tolerances.hole_bias**2
    factors = np.ones(count)
    if 1 <= tolerances.abnormal_hole <= count:
        factors[tolerances.abnormal_hole - 1] = tolerances.abnormal_factor
    scatter = (tolerances.part_scatter * factors) ** 2
    noise = np.zeros(count) if given and tolerances.scatter_freedom > 0 else scatter
    covariance, place = np.diag(variances), np.zeros((boards, count, 2, 2))
    for b in range(boards):
        covariance[shift, :] = covariance[:, shift] = 0.0
        covariance[shift, shift] = np.diag(board_variances)
        for h in range(count):
            seen = _seen(board, tolerances, b + 1, h)
            place[b, h] = seen @ covariance @ seen.T
            gain = covariance @ seen.T @ np.linalg.pinv(place[b, h] + noise[h] * np.eye(2), hermitian=True)
            covariance = covariance - gain @ seen @ covariance
            covariance = (covariance + covariance.T) / 2
    return Predicted(place, scatter)


def _seen(board: Board, tolerances: Tolerances, number: int, h: int) -> Array:
    """How the errors add up to the offset of hole h (from 0) of board `number`, (2, 9 + 2 holes)."""
    hole, one = board.holes[h], np.eye(2)
    jumped = h + 1 == tolerances.jump_hole and number >= tolerances.jump_board
    parts = [one, (number - 1) * one, jumped * one, one, np.array([[-hole.y], [hole.x]])]
    return np.hstack([*parts, np.kron(np.eye(len(board.holes))[h], one)])


def limits_of(world: NamedWorld, component: str, boards: int = 10) -> Limits:
    """The limits of a world. Takes some seconds; up to a minute for a component's first with these sizes."""
    tolerances, shape = world.tolerances, (boards, len(world.cell(component, seed=0).board.holes))
    bounds, estimates = np.full(shape, math.nan), np.full(shape, math.nan)
    if tolerances.common_error <= world.search.radius:
        searches = _Searches(world, component, boards)
        for b, h in np.ndindex(shape):
            bounds[b, h], estimates[b, h] = searches.limits(b, h)
    rows, found = (tuple(tuple(map(float, row)) for row in values) for values in (bounds, estimates))
    return Limits(1.0, float(bounds.mean()), float(estimates.mean()), rows, found)


class _Searches:
    """The searches of a job in a world."""

    def __init__(self, world: NamedWorld, name: str, boards: int) -> None:
        cell = world.cell(name, seed=0, boards=boards)
        self._part, self._tolerances = component(name), world.tolerances
        self._known = predicted(cell.board, world.tolerances, boards, given=True)
        self._normal = predicted(cell.board, world.tolerances, boards)
        nothing = Belief(header(0), cell.board.type, "", 0, Gaussian(), [], [])
        self._areas = [area_of(goal_for(cell, hole, nothing, 1, 1, 0)) for hole in cell.board.holes]
        # A turn against the hole never makes the area larger, so the bound need not know how it is drawn.
        self._whole = _sizes(self._part, world.tolerances, turned=False)
        self._turned = _sizes(self._part, world.tolerances, turned=True)

    def limits(self, b: int, h: int) -> tuple[float, float]:
        """Attempts that no strategy goes below in a search, and those of the best cover found."""
        ring = self._ring(b, h)
        if ring > 0:
            return self._of_ring(b, h, ring)
        scatter = self._known.scatter[h] * self._tails()
        covariances = self._known.place[b, h] + scatter[:, None, None] * np.eye(2)
        widths = np.linalg.det(_own(self._areas[h], covariances)) ** 0.25
        least = _mean(self._whole, lambda size: float(np.mean([bound(width / size) for width in widths])))
        if self._tolerances.scatter_freedom > 0:
            return least, math.nan
        area = self._areas[h]
        narrow, wide = np.sqrt(np.linalg.eigvalsh(_own(area, self._normal.covariance[b, h])))
        return least, CoverTable(Shape(area.rim), self._turned).fewest((float(wide), float(narrow)))

    def _ring(self, b: int, h: int) -> float:
        """Length [m] of an error that this search is the first to meet; 0 for none."""
        tolerances = self._tolerances
        if b == h == 0:
            return tolerances.common_error
        met = b + 1 == tolerances.jump_board and h + 1 == tolerances.jump_hole
        return tolerances.jump if met else 0.0

    def _of_ring(self, b: int, h: int, length: float) -> tuple[float, float]:
        """The same where an error of fixed length is met for the first time."""
        area, one = self._areas[h], np.eye(2)
        circle = np.asarray(length * np.linalg.inv(area.half_axes))
        known = self._known.place[b, h] + self._tails().min() * self._known.scatter[h] * one
        density = ring_density(circle, _own(area, known))
        least = _mean(self._whole, lambda size: _least(density, size))
        if self._tolerances.scatter_freedom > 0:
            return least, math.nan
        density = ring_density(circle, _own(area, self._normal.covariance[b, h] - length**2 / 2 * one))
        if min(self._turned) <= 0:
            return least, math.inf
        few = reduced(self._turned, _NODES)
        excess = fewest(Shape(area.rim), density, few).expected / _mean(few, lambda size: _least(density, size))
        return least, max(1.0, excess) * _mean(self._turned, lambda size: _least(density, size))

    def _tails(self) -> Array:
        """Factors of the scatter's variance, all as probable as each other."""
        freedom = self._tolerances.scatter_freedom
        if not freedom > 0:
            return np.ones(1)
        probability = (np.arange(_WIDTHS_OF_TAILS) + 0.5) / _WIDTHS_OF_TAILS
        return np.asarray(freedom / chi2.ppf(probability, freedom))


def _own(area: FeasibleArea, covariance: Array) -> Array:
    """Covariances (..., 2, 2) [m^2] in the area's own units."""
    to_own = np.linalg.inv(area.half_axes)
    return np.asarray(to_own @ covariance @ to_own.T)


def _least(density: Density, size: float) -> float:
    """Attempts that no sequence goes below with areas of this size."""
    return bound_of(density, math.pi * size**2)


def _mean(sizes: Sizes, attempts: Callable[[float], float]) -> float:
    """Mean over sizes of the area, weighted; infinite if some parts go in nowhere."""
    return sum(share * (attempts(size) if size > 0 else math.inf) for size, share in sizes.items())


def _sizes(part: Component, tolerances: Tolerances, *, turned: bool) -> dict[float, float]:
    """Sizes of the feasible area, as factors of its radius on the drawing, and their probabilities."""
    nodes, weights = np.polynomial.legendre.leggauss(5)
    nodes, weights = HOLE_RADIUS_LIMIT * nodes, HOLE_RADIUS_LIMIT * weights * norm.pdf(HOLE_RADIUS_LIMIT * nodes)
    beyond = norm.sf(HOLE_RADIUS_LIMIT)  # wider and narrower holes are drawn at the limit itself
    nodes = np.concatenate([nodes, [-HOLE_RADIUS_LIMIT, HOLE_RADIUS_LIMIT]])
    weights = np.concatenate([weights, [beyond, beyond]])
    turns, of_turns = np.polynomial.hermite_e.hermegauss(5)
    turns = turns * (math.hypot(tolerances.board_rotation, tolerances.part_rotation) if turned else 0.0)
    drawn, sizes = feasible_area(part), defaultdict[float, float](float)
    for node, weight in zip(nodes, weights / weights.sum(), strict=True):
        wider = tolerances.hole_radius_error + tolerances.hole_radius * float(node)
        for turn, of_turn in zip(turns, of_turns / of_turns.sum(), strict=True):
            area = feasible_area(part, round(abs(float(turn)), 12), round(wider, 12))
            sizes[math.sqrt(area / drawn)] += float(weight * of_turn)
    return dict(sizes)
