"""Discs that together are likely to hold the hole: gradient ascent on the paper's Eqs. 44-47, and what comes after."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Literal

import numpy as np

from runtime.belief import Array, covariance_of, disc_mass, disc_mass_slope, mean_of
from runtime.messages import Gaussian
from strategies.patterns import Offset, lattice

Force = Literal["overlap", "hinge", "eq_45", "eq_46"]
"""What keeps covers apart, see `repulsion_gradient`."""

STEPS = 120  # of ascent: plans within about 10 ms; run to rest, the covers' summed mass changes by less than a tenth
MILLIMETRE = 1e-3  # [m]
_ROUND = 1e-6  # relative difference of variances below which a belief counts as round
_GOLDEN_ANGLE = math.pi * (3 - math.sqrt(5))  # [rad]


def plan_covers(
    belief: Gaussian,
    radius: float,
    count: int,
    repulsion: float,
    reach: float,
    force: Force = "overlap",
    *,
    unit: float = MILLIMETRE,
    steps: int = STEPS,
    step: float | None = None,
) -> tuple[Array, Array]:
    """Centres (count, 2) [m] of discs that may hold the hole, most probable first, and their probabilities (count,).

    Gradient ascent on F = sum_i Phi_i (Eq. 47) with Phi_i = phi(m_i), the mass of Eq. 44, plus a term that keeps the
    covers apart (`force`, `unit` [m]), without which they all gather at the mean because F counts overlaps twice.

    `repulsion` is lambda [1/m^2], `reach` [m] how far from nominal a centre may lie: centres are moved back onto it.
    In each of `steps` a centre moves by `step` [m^2] times its gradient; none: by as much as is stable with the
    corrected forces (those of Eqs. 45-46 have no stable step, being unbounded).
    The ascent starts from a sunflower of discs stretched like the belief; it draws no random numbers.
    """
    if step is None:
        step = 1.0 / (8 * repulsion + _sharpness(belief, radius))
    slope = disc_mass_slope(belief, radius)
    centres = _inside(_sunflower(belief, radius, count), reach)
    for _ in range(steps):
        push = repulsion_gradient(force, centres, radius, repulsion, unit)
        centres = _inside(centres + step * (slope(centres) + push), reach)
    probabilities = disc_mass(belief, centres, radius)
    order = np.argsort(-probabilities, kind="stable")
    return centres[order], probabilities[order]


def repulsion_gradient(force: Force, centres: Array, radius: float, repulsion: float, unit: float) -> Array:
    """Gradient (n, 2) [1/m] of what F gains from the covers' distances d, with lambda = `repulsion` [1/m^2].

    As printed (lengths in `unit` [m], as Eq. 45 takes one from an area; lambda times unit^2 is the paper's number):

    eq_45: +lambda / (n - 1) max(d^2 - radius, 0) for each pair. The sign makes covers flee that are already apart and
    leaves overlapping ones alone: small lambda leaves them gathered, large lambda drives them off, F has no bound.
    eq_46: +lambda |m_i - centre of all|^2 for each cover. No bound either: the radius at which it balances the mass
    is unstable, covers within it gather and covers beyond it flee.

    Corrected:

    hinge: -lambda / (n - 1) max((2 radius)^2 - d^2, 0) for each pair, Eq. 45 with its sign and unit mended: covers
    push each other while they overlap. It has no force at d = 0 and gathers covers into clumps.
    overlap: -lambda / (n - 1) max(2 radius - d, 0)^2 for each pair, which pushes most where covers coincide.

    Eq. 46 has no corrected form. A cover feels nothing but its place relative to the centre, so that even with a
    bound covers in the same direction come together: it cannot part what overlaps.
    """
    if force == "eq_46":
        return np.asarray(2 * repulsion * (centres - centres.mean(axis=0)))
    coordinates = np.ascontiguousarray(centres.T)
    apart = coordinates[:, None, :] - coordinates[:, :, None]  # (2, n, n): from the second index to the third
    squared = apart[0] * apart[0] + apart[1] * apart[1]
    if force == "overlap":
        strength = np.maximum(2 * radius / np.maximum(np.sqrt(squared), 1e-9 * radius) - 1, 0.0)
    elif force == "hinge":
        strength = (squared < (2 * radius) ** 2).astype(float)
    else:
        strength = (squared > radius * unit).astype(float)
    pair_weight = 4 * repulsion / max(len(centres) - 1, 1)  # each pair is in F twice; a square's derivative doubles it
    return np.asarray(pair_weight * (strength * apart).sum(axis=1).T)


def sweep(centre: Offset, tried: Sequence[Offset], radius: float, reach: float) -> Iterator[Offset]:
    """What remains once the covers have run out: the whole disc of `reach` [m] about nominal, nearest `centre` first.

    Two triangular lattices of 1.5 radii at once: one for discs of the radius stated, and following it at a third of
    its distance one for discs of half of it, because a part may fit less well than stated. A point is left out if the
    discs already tried cover its hexagonal cell. Bounded: at most 2 (reach + |centre|)^2 / radius^2 points of the
    first lattice and four times as many of the second.
    """
    angles = math.pi / 6 + math.pi / 3 * np.arange(6)
    hexagon = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    cell = np.concatenate([np.zeros((1, 2)), hexagon, hexagon / 2, (hexagon + np.roll(hexagon, 1, axis=0)) / 2])
    widest = reach + math.hypot(*centre)
    points = [
        (rank * math.hypot(dx, dy), size, centre[0] + dx, centre[1] + dy)
        for size, rank in ((radius, 1.0), (radius / 2, 3.0))
        for dx, dy in lattice(1.5 * size, widest)
    ]
    done = np.concatenate([np.reshape(tried, (-1, 2)), np.empty((len(points), 2))])
    count = len(tried)
    for _, size, x, y in sorted(points, key=lambda point: point[0]):
        if math.hypot(x, y) > reach:
            continue
        corners = 1.5 * size / math.sqrt(3)  # [m] from the middle of its cell
        if _covered(cell * corners + np.array([x, y]), done[:count], size, corners):
            continue
        done[count] = x, y
        count += 1
        yield x, y


def _covered(points: Array, tried: Array, radius: float, extent: float) -> bool:
    """Whether discs of `radius` about `tried` (k, 2) cover all of points (n, 2), within `extent` of the first."""
    away = ((tried - points[0]) ** 2).sum(axis=1)
    if not (away <= radius**2).any():
        return False
    apart = points[:, None, :] - tried[away <= (1.001 * (radius + extent)) ** 2]
    return bool((np.einsum("ijk,ijk->ij", apart, apart).min(axis=1) <= radius**2).all())


def _sharpness(belief: Gaussian, radius: float) -> float:
    """Greatest curvature of the disc mass, nearly [1/m^2]: the ascent is stable below two steps of its inverse."""
    narrow = max(float(np.linalg.eigvalsh(covariance_of(belief))[0]), 0.0)
    peak = float(disc_mass(belief, mean_of(belief), radius)[0])
    return peak / (narrow + radius**2 / 4)


def _sunflower(belief: Gaussian, radius: float, count: int) -> Array:
    """Evenly spread points (count, 2) [m] about the mean, dense enough that discs of `radius` just cover."""
    index = np.arange(count)
    distance = radius * np.sqrt(1.5 * math.sqrt(3) / math.pi * index)  # a hexagon inscribed in the disc for each point
    flower = np.stack([np.cos(_GOLDEN_ANGLE * index), np.sin(_GOLDEN_ANGLE * index)], axis=1) * distance[:, None]
    variances, axes = np.linalg.eigh(covariance_of(belief))
    if variances[1] - variances[0] < _ROUND * variances[1]:
        axes = np.eye(2)  # no direction is the wider one, and rounding is not to choose
    narrow, wide = np.sqrt(np.maximum(variances, (radius / 2) ** 2))
    stretch = min(math.sqrt(wide / narrow), 2.0)
    return np.asarray(mean_of(belief) + (flower * (1 / stretch, stretch)) @ axes.T)


def _inside(points: Array, reach: float) -> Array:
    distance = np.sqrt((points * points).sum(axis=1, keepdims=True))
    return np.asarray(points * np.minimum(1.0, 0.999999 * reach / np.maximum(distance, 1e-12)))
