"""Many seeds of the paper's experiment at once, as arrays: what fitting its tables needs.

The worlds are those of `runtime.world`, draw for draw, and line, spiral and hybrid are the strategies' own candidates,
so that their attempts are exactly those of the trials as long as none lies beyond the search radius. Meta search is
approximated: its covers are a lattice by probability under the same posterior.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.assembly import goal_for
from runtime.cell import Tolerances
from runtime.component import COMPONENTS, feasible_radius
from runtime.config import Cell
from runtime.experiment.contenders import Contender
from runtime.experiment.matched import MAX_ATTEMPTS, SEARCH, Settings, methods
from runtime.experiment.model import Capture
from runtime.experiment.paper import ABNORMAL_HOLE, BOARDS, HOLES
from runtime.experiment.worlds import GRID
from runtime.messages import Belief, Gaussian, header
from runtime.world import World

Array = NDArray[np.float64]

HOLE_RADIUS = 0.025e-3  # [m] standard deviation of the plated holes' radius: a tenth of the feasible radius
ABNORMAL_FACTOR = 3.0
SPACING = 1.5  # [feasible radii] of the lattice that stands in for meta's covers


@dataclass(frozen=True)
class Spread:
    """The tolerances that are fitted [m]."""

    common_error: float
    board_shift: float
    hole_bias: float
    part_scatter: float

    @property
    def tolerances(self) -> Tolerances:
        """As a world has them."""
        return Tolerances(
            common_error=self.common_error,
            board_shift=self.board_shift,
            board_rotation=0.0,
            hole_bias=self.hole_bias,
            part_scatter=self.part_scatter,
            part_rotation=0.0,
            abnormal_hole=ABNORMAL_HOLE,
            abnormal_factor=ABNORMAL_FACTOR,
            hole_radius=HOLE_RADIUS,
        )


@dataclass(frozen=True)
class Worlds:
    """What many seeds draw, for tolerances of 1 m: shape (seeds, boards, holes, 2); of radii (seeds, boards, holes)."""

    component: str
    common: Array
    shift: Array
    bias: Array
    scatter: Array
    wider: Array  # [m]

    def offsets(self, spread: Spread) -> Array:
        """Where the TCP must go relative to nominal [m]."""
        factor = np.where(np.arange(1, HOLES + 1) == ABNORMAL_HOLE, ABNORMAL_FACTOR, 1.0)[:, None]
        offsets = spread.common_error * self.common + spread.board_shift * self.shift + spread.hole_bias * self.bias
        return np.asarray(offsets - spread.part_scatter * factor * self.scatter)

    def feasible(self, errors: Array, board: int) -> NDArray[np.bool_]:
        """Whether parts go in that are off by errors (seeds, holes, n, 2) [m], at one board; no part is turned."""
        part = COMPONENTS[self.component]
        x, y = np.abs(errors[..., 0]), np.abs(errors[..., 1])
        inside = np.ones(x.shape, dtype=bool)
        for pin in {(pin.half_x - pin.chamfer, pin.half_y - pin.chamfer, pin.round) for pin in part.pins}:
            half_x, half_y, is_round = pin
            room = part.hole_radius + self.wider[:, board, :, None] - (half_x if is_round else 0.0)
            inside &= np.hypot(x + (0.0 if is_round else half_x), y + (0.0 if is_round else half_y)) <= room
        return inside


def draw(component: str, seeds: Sequence[int]) -> Worlds:
    """The draws of these seeds, as `World` makes them."""
    part = COMPONENTS[component]
    shape = (len(seeds), BOARDS, HOLES, 2)
    arrays = {name: np.zeros(shape) for name in ("common", "shift", "bias", "scatter")}
    wider = np.zeros(shape[:3])
    rigid: dict[str, Any] = {
        "board_shift": 0.0,
        "board_rotation": 0.0,
        "hole_bias": 0.0,
        "part_scatter": 0.0,
        "part_rotation": 0.0,
    }
    for s, seed in enumerate(seeds):

        def world(seed: int = seed, **one: float) -> World:
            return World(GRID, part, Tolerances(**{**rigid, **one}), seed)

        common, shift = world(common_error=1.0), world(board_shift=1.0)
        bias, scatter = world(hole_bias=1.0), world(part_scatter=1.0)
        radius = world(hole_radius=HOLE_RADIUS)
        for h, hole in enumerate(GRID.holes):
            truth = common.hole(1, hole.name)
            arrays["common"][s, :, h] = truth.x, truth.y
            arrays["bias"][s, :, h] = bias.bias(hole.name)
            for b in range(BOARDS):
                wider[s, b, h] = radius.hole(b + 1, hole.name).wider
                held = scatter.part(b * HOLES + h + 1, hole.name)
                arrays["scatter"][s, b, h] = held.x, held.y
        for b in range(BOARDS):
            placed = shift.placement(b + 1)
            arrays["shift"][s, b, :] = placed.x, placed.y
    return Worlds(component, **arrays, wider=wider)


@dataclass(frozen=True)
class Outcomes:
    """How one method's searches went, shape (seeds, boards, holes)."""

    attempts: Array
    seated: NDArray[np.bool_]

    @property
    def by_board(self) -> Array:
        """Mean attempts of a whole board (boards,)."""
        return np.asarray(self.attempts.sum(axis=2).mean(axis=0))


def simulate(worlds: Worlds, spread: Spread, settings: Settings) -> dict[str, Outcomes]:
    """The four methods through all boards."""
    offsets = worlds.offsets(spread)
    line, spiral, hybrid, _ = methods(worlds.component, settings)
    found = {one.name: _patterned(worlds, offsets, pattern(one, worlds.component)) for one in (line, spiral, hybrid)}
    return {**found, "meta": _meta(worlds, offsets, settings)}


def pattern(contender: Contender, component: str) -> Array:
    """The candidates (n, 2) [m] that a strategy proposes where nothing was learnt and nothing goes in."""
    cell = Cell(board=GRID, component=component, boards=1, seed=0, search=SEARCH, tolerances=Tolerances())
    belief = Belief(header(0), GRID.type, GRID.holes[0].name, 0, Gaussian(), [], [])
    goal = goal_for(cell, GRID.holes[0], belief, board=1, search=1, now=0)
    return np.array([(p.x, p.y) for p in islice(contender.make().search(goal), MAX_ATTEMPTS)])


def _patterned(worlds: Worlds, offsets: Array, points: Array) -> Outcomes:
    """One pattern about the mean of each hole's successful candidates."""
    seeds = len(offsets)
    total, count = np.zeros((seeds, HOLES, 2)), np.zeros((seeds, HOLES, 1))
    attempts, seated = np.zeros(offsets.shape[:3]), np.zeros(offsets.shape[:3], dtype=bool)
    for board in range(BOARDS):
        tried = (total / np.maximum(count, 1))[:, :, None] + points
        attempts[:, board], seated[:, board], at = _try(worlds, offsets, tried, board)
        total += np.where(seated[:, board, :, None], at, 0.0)
        count += seated[:, board, :, None]
    return Outcomes(attempts, seated)


def _meta(worlds: Worlds, offsets: Array, settings: Settings) -> Outcomes:
    """Meta search, its covers a lattice by Mahalanobis distance."""
    seeds, radius = len(offsets), feasible_radius(COMPONENTS[worlds.component])
    k0, n0, prior = settings.mean_count, settings.covariance_count, settings.prior_width**2 * np.eye(2)
    count, first = np.zeros((seeds, HOLES)), np.zeros((seeds, HOLES, 2))
    second = np.zeros((seeds, HOLES, 2, 2))
    attempts, seated = np.zeros(offsets.shape[:3]), np.zeros(offsets.shape[:3], dtype=bool)
    lattice = _lattice(SPACING * radius)
    kept = Capture().peck_kept
    for board in range(BOARDS):
        some = count[..., None, None]
        average = first / np.maximum(count, 1)[..., None]
        outer = average[..., :, None] * average[..., None, :]
        scatter = n0 * prior + second - some * outer + k0 * some / (k0 + some) * outer
        covariance = np.where(some > 0, scatter / (n0 + some), prior)
        variances, axes = np.linalg.eigh(covariance)
        inverse = (axes / np.maximum(variances, (radius / 2) ** 2)[..., None, :]) @ axes.swapaxes(-1, -2)
        distance = np.einsum("ni,shij,nj->shn", lattice, inverse, lattice, optimize=True)
        order = np.argsort(distance, axis=-1)[..., :MAX_ATTEMPTS]
        tried = (first / (k0 + count)[..., None])[:, :, None] + lattice[order]
        attempts[:, board], seated[:, board], at = _try(worlds, offsets, tried, board)
        went_in = seated[:, board, :, None] * (offsets[:, board] + kept * (at - offsets[:, board]))
        count += seated[:, board]
        first += went_in
        second += went_in[..., :, None] * went_in[..., None, :]
    return Outcomes(attempts, seated)


def _try(worlds: Worlds, offsets: Array, tried: Array, board: int) -> tuple[Array, NDArray[np.bool_], Array]:
    """Attempts, success and last candidate at each hole of a board, for candidates (seeds, holes, n, 2) in turn."""
    inside = worlds.feasible(tried - offsets[:, board, :, None], board)
    seated: NDArray[np.bool_] = np.asarray(inside.any(axis=-1))
    last = np.where(seated, inside.argmax(axis=-1), tried.shape[2] - 1)
    return last + 1.0, seated, np.take_along_axis(tried, last[..., None, None], axis=2)[:, :, 0]


def _lattice(spacing: float) -> Array:
    index = np.arange(-8, 9)
    i, j = (axis.ravel() for axis in np.meshgrid(index, index))
    points = spacing * np.stack([i + j / 2, np.sqrt(3) / 2 * j], axis=1)
    return np.asarray(points[np.hypot(points[:, 0], points[:, 1]) < 8 * spacing])
