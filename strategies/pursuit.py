"""One hole pursued with a belief: what is left of it after each failure, and where a peck is worth most."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from runtime.belief import gaussian, seat_points
from runtime.feasible_area import area_of
from runtime.messages import Proposal, SearchGoal, Waypoint
from strategies.guard import sweep
from strategies.learning import Reading, belief_at
from strategies.offset_grid import OffsetGrid, best
from strategies.patterns import lattice
from strategies.start import check

Array = NDArray[np.float64]

_SPARSE = 1.25  # width of the belief in own units above which a lattice beats greed
_SPACING = 1.6  # of that lattice, in own units
_WORTH = 0.62  # share of the best mass that a lattice point must have


class Pursuit:
    """A search under way."""

    def __init__(self, goal: SearchGoal, size: float, reading: Reading) -> None:
        """`size` is that of the feasible area over the stated one.

        Raises InputError unless the goal's radii are positive lengths.
        """
        check(goal)
        self.area = area_of(goal, size)
        self._reading = reading
        belief = belief_at(goal, self.area, reading)
        self.grid = OffsetGrid(self.area, belief, reading.size_spread)
        self.reach = _reach(goal)  # [m] from nominal
        self.brief = _found_nothing_lately(goal)
        self._told = gaussian(belief.mean, belief.covariance)
        self._tried = np.empty((0, 2))  # [m]
        away = float(np.hypot(*belief.mean))
        centre = belief.mean * min(1.0, self.reach / max(away, 1e-12))
        self._guard = sweep(self.area, centre, self.reach, lambda: self._tried, brief=self.brief)

    def attempt(self, path: Sequence[Array]) -> Proposal:
        """A slide along points (2,) [m]; a single one is pecked at."""
        x, y = path[0]
        probability = self._probability(path[0])
        ways = [Waypoint(float(point[0]), float(point[1])) for point in path[1:]]
        return Proposal(float(x), float(y), probability=probability, belief=self._told, path=ways)

    def guard_is_due(self, number: int, patience: int) -> bool:
        """Whether the attempt of this number belongs to the guard; see `strategies.bayes`."""
        if self.brief:
            return number > patience / 3
        return number > patience and (number % 2 == 0 or number > 3 * patience)

    def guarded(self) -> Array | None:
        """The next point (2,) [m] of the sweep that needs no belief; None once the search radius is swept."""
        return next(self._guard, None)

    def worthiest(self, peck_time: float, travel_speed: float) -> Array:
        """The point (2,) [m] with the greatest probability of insertion per second.

        `peck_time` [s] is what a failure takes, beside the way to it at `travel_speed` [m/s]. While the belief is wide
        the point is one of a lattice: greed leaves gaps between its choices in which no other area fits.
        """
        places = self.area.to_metres(self.grid.points())
        here = self._tried[-1] if len(self._tried) else self.area.to_metres(self.grid.mean)
        cost = peck_time + np.hypot(places[..., 0] - here[0], places[..., 1] - here[1]) / travel_speed
        worth = (self.allowed() / cost).ravel()
        index = best(worth)
        if self.grid.width > _SPARSE:
            on_lattice = lattice_cells(self.grid.cell, self.grid.side, _SPACING)
            chosen = int(on_lattice[best(worth[on_lattice])])
            if worth[chosen] > _WORTH * worth[index]:
                index = chosen
        return np.asarray(places.reshape(-1, 2)[index])

    def allowed(self) -> Array:
        """Probability (side, side) of insertion at each point of the grid, 0 beyond reach."""
        places = self.area.to_metres(self.grid.points())
        return np.where(np.hypot(places[..., 0], places[..., 1]) <= self.reach, self.grid.masses(), 0.0)

    def failed(self, path: Sequence[Array]) -> None:
        """An attempt along points (2,) [m] was blocked."""
        self._tried = np.concatenate([self._tried, path[0][None]])
        self.grid.failed(self.area.to_own(np.array(path)), self._reading.swath, self._reading.catch)

    def _probability(self, point: Array) -> float:
        row, column = self.grid.cell_of(self.area.to_own(point))
        masses = self.grid.masses()
        inside = 0 <= row < self.grid.side and 0 <= column < self.grid.side
        return float(min(masses[row, column], 1.0)) if inside else 0.0


def _reach(goal: SearchGoal) -> float:
    """How far from nominal a search may go [m]: the search radius, or a little beyond the farthest seat outside it."""
    seats = seat_points(goal.seats)
    farthest = float(np.hypot(seats[:, 0], seats[:, 1]).max()) if len(seats) else 0.0
    return goal.search_radius if farthest <= goal.search_radius else farthest + goal.feasible_radius


def _found_nothing_lately(goal: SearchGoal) -> bool:
    """Whether the board at hand has a search that found nothing, and nothing was found after it.

    Then the board may be the wrong one, and what was looked for in vain is not worth looking for as thoroughly again.
    """
    turn = {place.hole: number for number, place in enumerate(goal.layout)}
    seats = {seat.hole for seat in goal.seats if seat.board == goal.board}
    missed = {miss.hole for miss in goal.misses if miss.board == goal.board} - seats
    lost = [turn[hole] for hole in missed if hole in turn]
    if not lost:
        return not seats and _last_board_was_lost(goal)
    return all(turn.get(hole, 0) < max(lost) for hole in seats)


def _last_board_was_lost(goal: SearchGoal) -> bool:
    boards = {seat.board for seat in goal.seats}
    lost = {miss.board for miss in goal.misses} - boards
    return bool(lost) and max(lost) > max(boards, default=0)


@lru_cache(maxsize=128)
def lattice_cells(cell: float, side: int, spacing: float) -> NDArray[np.intp]:
    """Cells of a grid, numbered row by row, in which the points of a lattice about its middle lie."""
    points = np.array(lattice(spacing, cell * side * 0.7072))
    cells = np.rint(points / cell).astype(int) + side // 2
    inside = ((cells >= 0) & (cells < side)).all(axis=1)
    return np.unique(cells[inside, 0] * side + cells[inside, 1])
