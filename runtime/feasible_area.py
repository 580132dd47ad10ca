"""The feasible area of a part as a search sees it: at which errors of the TCP the pins still find their holes.

In the area's own units, the half axes of the ellipse with its second moments, it is about a disc of radius 1 whatever
its shape: flat pins give an area nearly twice as long as wide. Frame: base_link.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from runtime.component import COMPONENTS, clearance, feasible_radius
from runtime.errors import InputError
from runtime.messages import SearchGoal

Array = NDArray[np.float64]

_DIRECTIONS = 360  # in which the rim is known
_ROUND = 1e-6  # relative difference of the squared half axes below which an area counts as round
_DIGITS = 9  # of an orientation [rad] that matter


@dataclass(frozen=True, eq=False)
class FeasibleArea:
    """A star-shaped area about the place at which the pins are centred."""

    half_axes: Array  # (2, 2) [m] as columns: own units to metres
    rim: Array  # (n,) distance from centre to rim in own units, at n even directions from +x

    def to_metres(self, points: ArrayLike) -> Array:
        """Points (..., 2) in own units as metres."""
        return np.asarray(np.asarray(points, dtype=float) @ self.half_axes.T)

    def to_own(self, points: ArrayLike) -> Array:
        """Points (..., 2) [m] in own units."""
        return np.asarray(np.asarray(points, dtype=float) @ np.linalg.inv(self.half_axes).T)

    def gauge(self, errors: ArrayLike) -> Array:
        """How far out errors (..., 2) in own units are: below 1 within the area, 1 on its rim, shape (...,)."""
        e = np.asarray(errors, dtype=float)
        angle = np.arctan2(e[..., 1], e[..., 0])
        turns = angle / (2 * math.pi) % 1.0 * len(self.rim)
        rim = np.interp(turns, np.arange(len(self.rim) + 1), np.append(self.rim, self.rim[0]))
        return np.asarray(np.hypot(e[..., 0], e[..., 1]) / rim)


def area_of(goal: SearchGoal, size: float = 1.0) -> FeasibleArea:
    """The area in which the goal's part goes in: its component's shape with the goal's feasible radius, times `size`.

    A disc if the component is not known. Raises InputError unless the radius is a positive length.
    """
    radius = goal.feasible_radius
    if not (math.isfinite(radius) and radius > 0):
        raise InputError(f"search {goal.search}: feasible_radius must be a positive length, not {radius} m")
    turn = goal.nominal.orientation  # half a turn about x, then the part's orientation about z
    yaw = 2 * math.atan2(turn.y, turn.x)
    return _area(goal.component, round(math.remainder(yaw, 2 * math.pi), _DIGITS), radius * size)


@lru_cache(maxsize=64)
def _area(name: str, yaw: float, radius: float) -> FeasibleArea:
    if name not in COMPONENTS:
        return FeasibleArea(radius * np.eye(2), np.ones(_DIRECTIONS))
    component = COMPONENTS[name]
    step = 2 * math.pi / _DIRECTIONS
    angle = step * np.arange(_DIRECTIONS)
    reach = np.array([clearance(component, float(direction)) for direction in angle])
    reach *= radius / feasible_radius(component)
    # A component's z points down: its y is the board's -y.
    direction = np.stack([np.cos(yaw + angle), np.sin(yaw + angle)], axis=1)
    reach = reach[(-np.arange(_DIRECTIONS)) % _DIRECTIONS]
    moments = step / 4 * np.einsum("n,ni,nj->ij", reach**4, direction, direction)
    variances, axes = np.linalg.eigh(moments / (math.pi * radius**2))
    if variances[1] - variances[0] < _ROUND * variances[1]:
        axes = np.eye(2)  # no direction is the longer one, and rounding is not to choose
    half_axes = axes * np.sqrt(variances) * np.where(axes.sum(axis=0) < 0, -1.0, 1.0)
    half_axes *= radius / math.sqrt(abs(np.linalg.det(half_axes)))
    outline = (reach[:, None] * direction) @ np.linalg.inv(half_axes).T
    seen = np.arctan2(outline[:, 1], outline[:, 0]) % (2 * math.pi)
    order = np.argsort(seen)
    distance = np.hypot(outline[:, 0], outline[:, 1])
    return FeasibleArea(half_axes, np.interp(angle, seen[order], distance[order], period=2 * math.pi))
