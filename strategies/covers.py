"""Discs that together are likely to hold the hole: gradient ascent on the paper's Eq. 45, and what comes after."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from runtime.belief import Array, covariance_of, disc_mass, disc_mass_gradient, mean_of
from runtime.messages import Gaussian
from strategies.patterns import Offset, lattice

_STEPS = 120  # of ascent: plans within about 20 ms; run to rest, the covers' summed mass changes by less than a tenth
_GOLDEN_ANGLE = math.pi * (3 - math.sqrt(5))  # [rad]
_MILLIMETRE = 1e-3  # [m]


def plan_covers(
    belief: Gaussian, radius: float, count: int, repulsion: float, reach: float, *, literal: bool = False
) -> tuple[Array, Array]:
    """Centres (count, 2) [m] of discs that may hold the hole, most probable first, and their probabilities (count,).

    Gradient ascent on F = sum_i Phi_i (Eq. 47) with Phi_i = phi(m_i) plus a term between each pair of covers:

    corrected: -repulsion / (n - 1) * max(2 radius - d, 0)^2: covers push each other while they overlap, most where
    they coincide. (A hinge on d^2 with its sign mended has no force at d = 0 and gathers covers into clumps.)
    literal (Eq. 45): +repulsion / (n - 1) * max(d^2 - radius, 0): the sign makes covers flee that are already apart and
    leaves overlapping ones alone, F has no bound, and a length is taken from an area; the numbers are read in mm.

    `repulsion` is lambda [1/m^2], `reach` [m] how far from nominal a centre may lie: centres are moved back onto it.
    The ascent starts from a sunflower of discs stretched like the belief; it draws no random numbers.
    """
    step = 1.0 / (8 * repulsion + _sharpness(belief, radius))
    pair_weight = 4 * repulsion / max(count - 1, 1)  # each pair is in F twice; a square's derivative doubles it
    centres = _inside(_sunflower(belief, radius, count), reach)
    for _ in range(_STEPS):
        apart = centres[:, None, :] - centres  # (n, n, 2)
        distance = np.sqrt(np.einsum("ijk,ijk->ij", apart, apart))
        if literal:
            strength = (distance**2 > radius * _MILLIMETRE).astype(float)
        else:
            strength = np.maximum(2 * radius / np.maximum(distance, 1e-9 * radius) - 1, 0.0)
        push = pair_weight * np.einsum("ij,ijk->ik", strength, apart)
        centres = _inside(centres + step * (disc_mass_gradient(belief, centres, radius) + push), reach)
    probabilities = disc_mass(belief, centres, radius)
    order = np.argsort(-probabilities, kind="stable")
    return centres[order], probabilities[order]


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
    done = list(tried)
    for _, size, x, y in sorted(points, key=lambda point: point[0]):
        if math.hypot(x, y) > reach or _covered(cell * (1.5 * size / math.sqrt(3)) + np.array([x, y]), done, size):
            continue
        done.append((x, y))
        yield x, y


def _covered(points: Array, tried: Sequence[Offset], radius: float) -> bool:
    if not tried:
        return False
    apart = points[:, None, :] - np.asarray(tried)
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
    narrow, wide = np.sqrt(np.maximum(variances, (radius / 2) ** 2))
    stretch = min(math.sqrt(wide / narrow), 2.0)
    return np.asarray(mean_of(belief) + (flower * (1 / stretch, stretch)) @ axes.T)


def _inside(points: Array, reach: float) -> Array:
    distance = np.linalg.norm(points, axis=1, keepdims=True)
    return np.asarray(points * np.minimum(1.0, 0.999999 * reach / np.maximum(distance, 1e-12)))
