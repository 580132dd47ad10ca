"""The guard: a sweep of the whole search radius that finds the hole even if everything believed about it is wrong."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from runtime.feasible_area import FeasibleArea
from strategies.patterns import Offset, lattice

Array = NDArray[np.float64]


@dataclass(frozen=True)
class _Pass:
    """One lattice of the sweep, in the area's own units."""

    cover: float  # covering radius of the lattice
    size: float  # of the areas that it surely finds
    rank: float  # how many times nearer its points must be to have their turn with those of rank 1


_PASSES = (_Pass(0.72, 0.8, 1.0), _Pass(0.45, 0.55, 2.0))
_BRIEF = (_Pass(0.94, 1.0, 1.0),)
_RINGS = 3  # of points in a lattice cell at which is looked whether it is covered: 0.03 is the most they miss


def sweep(
    area: FeasibleArea, centre: Array, reach: float, tried: Callable[[], Array], *, brief: bool = False
) -> Iterator[Array]:
    """Positions (2,) [m], nearest to `centre` (2,) [m] first, that leave no gap within `reach` [m] of nominal.

    Two triangular lattices in the area's own units. One finds any hole within reach whose area has 0.8 of the stated
    width or more, the other, following at half its distance, any of 0.55 or more: about 260 positions and 660 more
    for a reach of ten feasible radii. `tried` tells the positions (n, 2) [m] that were tried so far; cells that they
    cover are left out. `brief`: one lattice, that finds any area of the stated width, in about 150 positions.
    """
    here = area.to_own(centre)
    shorter = float(np.linalg.svd(area.half_axes, compute_uv=False)[-1])  # [m]
    widest = (reach + float(np.hypot(*centre))) / shorter + 1.0
    for cell, offset in _in_turn(_BRIEF if brief else _PASSES, widest):
        middle = here + np.array(offset)
        corners = area.to_metres(middle + _hexagon(cell.cover))
        inside = np.hypot(corners[:, 0], corners[:, 1]) <= reach
        if not inside.any() or _covered(area, area.to_own(corners[inside]), area.to_own(tried()), cell.size):
            continue
        point = area.to_metres(middle)
        distance = float(np.hypot(*point))
        yield point if distance <= reach else point * (reach / distance * (1 - 1e-9))


def _in_turn(passes: tuple[_Pass, ...], widest: float) -> list[tuple[_Pass, Offset]]:
    """The points of all lattices out to `widest`, in the order of their turns."""
    points = [
        (each.rank * math.hypot(*offset), index, each, offset)
        for each in passes
        for index, offset in enumerate(lattice(math.sqrt(3) * each.cover, widest))
    ]
    return [(each, offset) for _, _, each, offset in sorted(points, key=lambda point: (round(point[0], 6), point[1]))]


def _covered(area: FeasibleArea, points: Array, tried: Array, size: float) -> bool:
    """Whether areas of `size` about what was tried hold all points (n, 2), in own units."""
    near = tried[np.abs(tried - points.mean(axis=0)).max(axis=1) < 3.0] if len(tried) else tried
    if not len(near):
        return False
    return bool((area.gauge(points[:, None] - near).min(axis=1) <= size).all())


@cache
def _hexagon(radius: float) -> Array:
    """Points (n, 2) that lie close in a hexagon of this circumradius about 0, its rim included."""
    angle = math.pi / 6 + math.pi / 3 * np.arange(6)
    corners = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points = [np.zeros((1, 2))]
    for ring in range(1, _RINGS + 1):
        share = np.arange(ring)[:, None, None] / ring
        points.append(((1 - share) * corners + share * np.roll(corners, -1, axis=0)).reshape(-1, 2) * ring / _RINGS)
    return radius * np.concatenate(points)
