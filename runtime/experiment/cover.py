"""One hole, one known density: in how few attempts, on average, can copies of the feasible area cover it?

Lengths are in the area's own units (`runtime.feasible_area`): it is about a disc of radius 1, its area is pi. A part's
area is larger or smaller by a factor, its size, of which only the distribution is known. A failed attempt tells nothing
but that it failed, so any strategy is a sequence of places c_1, c_2, ...; sought is the one with the least

    E[N] = sum over n >= 0 of P(the hole lies in none of the first n areas),

probability being over place and size. No sequence goes below `bound`, averaged over sizes; `fewest` returns the best of
three ways to lay one: always the largest mass that is left (greedy); a covering lattice in order of density (several
spacings and origins), with the gaps that smaller sizes leave once more mass is left there than under the next place;
and the best two of these moved downhill in E[N]. Integrals are sums on a grid with anti-aliased rims, good to 0.5 %. It
is a local search: to move a longer sequence bettered it by 0.9 %. How far below the true optimum lies is unknown.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from heapq import heappop, heappush
from itertools import chain, product
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh_tridiagonal
from scipy.ndimage import map_coordinates
from scipy.optimize import minimize
from scipy.signal import fftconvolve

Array = NDArray[np.float64]
Sizes = Mapping[float, float]  # factors of the area's radius, and their probabilities, which add up to 1

ONE_SIZE: Sizes = MappingProxyType({1.0: 1.0})

_CUT = 4.95  # widths from its mean at which a normal density is cut off: 5e-6 of it lies beyond
_LEFT = 3e-5  # of the mass: what greedy and lattice may leave
_SOUGHT = 3  # sizes while a cover is sought; it is judged on all
_POLISHED = 70  # places: sequences that leave more than a few are left as they are, for the time that it takes
_FEW = 1e-3  # of the mass: what the places that are polished may leave
_SPACINGS = (1.45, 1.55, 1.65, 1.73)  # of a triangular lattice of discs; sqrt 3 is the widest that leaves no gap
# Ratio of its rows' spacing to that of a triangular lattice, for shapes that are no discs.
_SQUEEZED = (0.88, 1.0, 1.14)


def bound(width: float) -> float:
    """Attempts that no sequence goes below for a normal density with geometric mean `width` of its two widths.

    n areas of pi hold at most the mass of the best set of area n pi, a level ellipse:
    E[N] >= sum over n of exp(-n / (2 width^2)).
    """
    return -1.0 / math.expm1(-0.5 / width**2)


def reduced(sizes: Sizes, count: int) -> dict[float, float]:
    """At most `count` sizes whose distribution has the same first 2 count - 1 moments: Gauss's nodes and weights.

    From the recurrence of the polynomials orthogonal under the distribution (Golub and Welsch, Math. Comp. 23, 1969).
    """
    if len(sizes) <= count:
        return dict(sizes)
    size, share = np.array(list(sizes)), np.array(list(sizes.values()))
    basis = np.zeros((count + 1, len(size)))  # of vectors orthonormal in the shares; one of zeros in front
    diagonal, beside = np.zeros(count), np.zeros(count)
    vector = np.sqrt(share / share.sum())
    for k in range(count):
        basis[k + 1] = vector
        diagonal[k] = vector @ (size * vector)
        rest = size * vector
        for _ in range(2):  # once more, against rounding
            rest -= basis.T @ (basis @ rest)
        beside[k] = np.linalg.norm(rest)
        vector = rest / beside[k]
    nodes, vectors = eigh_tridiagonal(diagonal, beside[:-1])
    return {float(node): float(first**2) for node, first in zip(nodes, vectors[0], strict=True)}


def _columns(sizes: Sizes) -> tuple[Array, Array]:
    """Sizes and their probabilities, (sizes, 1, 1) each."""
    found = np.array(list(sizes.items()))
    return found[:, :1, None], found[:, 1:, None]


@dataclass(frozen=True, eq=False)
class Shape:
    """A feasible area by its rim."""

    rim: Array  # (n,) distance from centre to rim at n even directions from +x

    @cached_property
    def reach(self) -> float:
        """The largest distance from centre to rim."""
        return float(self.rim.max())

    @cached_property
    def _closed(self) -> tuple[Array, Array]:
        slope = (np.roll(self.rim, -1) - np.roll(self.rim, 1)) * len(self.rim) / (4 * math.pi)
        return np.append(self.rim, self.rim[0]), np.append(slope, slope[0])

    def depth(self, x: Array, y: Array, size: float | Array = 1.0) -> Array:
        """How far points relative to the centre lie inside the rim of the area times `size`, along the ray there."""
        rim = np.interp(self._turns(x, y), np.arange(len(self.rim) + 1), self._closed[0])
        return np.asarray(size * rim - np.hypot(x, y))

    def slope(self, x: Array, y: Array, size: float = 1.0) -> tuple[Array, Array]:
        """Derivatives of `depth` with respect to x and y."""
        r = np.maximum(np.hypot(x, y), 1e-12)
        across = size * np.interp(self._turns(x, y), np.arange(len(self.rim) + 1), self._closed[1]) / r
        cosine, sine = x / r, y / r
        return -cosine - across * sine, -sine + across * cosine

    def _turns(self, x: Array, y: Array) -> Array:
        return np.asarray(np.arctan2(y, x) / (2 * math.pi) % 1.0 * len(self.rim))


@dataclass(frozen=True, eq=False)
class Density:
    """Probability on a square grid; masses add up to 1."""

    x: Array  # (n,) even spacing
    y: Array  # (m,)
    mass: Array  # (n, m)

    @cached_property
    def spacing(self) -> float:
        """Of the grid, along both axes."""
        return float(self.x[1] - self.x[0])

    def thinned(self) -> Density:
        """The same on a grid with half as many points along each axis."""
        n, m = len(self.x) // 2, len(self.y) // 2
        mass = self.mass[: 2 * n, : 2 * m].reshape(n, 2, m, 2).sum(axis=(1, 3))
        x, y = (axis[: 2 * half].reshape(half, 2).mean(axis=1) for axis, half in ((self.x, n), (self.y, m)))
        return Density(x, y, mass / mass.sum())


def normal_density(wide: float, narrow: float, spacing: float | None = None) -> Density:
    """A normal density about the origin with widths along x and y."""
    h = spacing or min(0.05 if wide * narrow < 9 else 0.08, narrow / 6)
    x, y = (_axis(_CUT * width + 1.5, h) for width in (wide, narrow))
    mass = np.exp(-0.5 * ((x[:, None] / wide) ** 2 + (y / narrow) ** 2))
    return Density(x, y, mass / mass.sum())


def ring_density(circle: Array, covariance: Array) -> Density:
    """A normal density whose mean lies anywhere on an ellipse: `circle` (2, 2) times all unit vectors, evenly."""
    narrow = math.sqrt(np.linalg.eigvalsh(covariance)[0])
    length = np.linalg.norm(circle, 2)
    count = max(16, 4 * math.ceil(2 * math.pi * length / narrow))
    angle = 2 * math.pi / count * np.arange(count)
    means = circle @ np.stack([np.cos(angle), np.sin(angle)])  # (2, count)
    half = np.abs(means).max(axis=1) + _CUT * np.sqrt(np.diag(covariance)) + 1.5
    x, y = (_axis(float(reach), max(min(0.05, narrow / 6), float(half.max()) / 400)) for reach in half)
    inverse, mass = np.linalg.inv(covariance), np.zeros((len(x), len(y)))
    for mean in means.T:
        dx, dy = x[:, None] - mean[0], y[None, :] - mean[1]
        mass += np.exp(-0.5 * (inverse[0, 0] * dx**2 + 2 * inverse[0, 1] * dx * dy + inverse[1, 1] * dy**2))
    return Density(x, y, mass / mass.sum())


def bound_of(density: Density, area: float) -> float:
    """Attempts that no sequence goes below for any density: n areas hold at most the mass of the best cells."""
    held = np.concatenate([[0.0], np.cumsum(np.sort(density.mass, axis=None)[::-1])])
    cells = np.arange(0.0, len(held), area / density.spacing**2)
    return float((1.0 - np.interp(cells, np.arange(len(held)), held)).sum())


def _axis(half: float, spacing: float) -> Array:
    count = math.ceil(half / spacing)
    return np.asarray(spacing * np.arange(-count, count + 1))


@dataclass
class Cover:
    """Places laid one after another over a density, for an area that has one of several sizes."""

    shape: Shape
    density: Density
    sizes: Sizes = field(default_factory=lambda: ONE_SIZE)
    places: list[tuple[float, float]] = field(default_factory=list)
    attempts: float = 0.0  # sum over n so far of the mass that n places left

    def __post_init__(self) -> None:
        self._factors, shares = _columns(self.sizes)
        self._left = shares * self.density.mass  # (sizes, n, m)
        self._reach = self.shape.reach * float(self._factors.max())
        self.left = 1.0  # mass that is not covered, over all sizes

    @property
    def expected(self) -> float:
        """Mean number of attempts, if what is left is found with the next one."""
        return self.attempts + self.left

    def lay(self, x: float, y: float) -> None:
        """The next place."""
        rows, columns, inside = self._patch(x, y)
        self.attempts += self.left
        taken = self._left[:, rows, columns] * inside
        self._left[:, rows, columns] -= taken
        self.left -= float(taken.sum())
        self.places.append((x, y))

    def takes(self, x: float, y: float) -> float:
        """Mass that the next place would cover."""
        rows, columns, inside = self._patch(x, y)
        return float((self._left[:, rows, columns] * inside).sum())

    def gain(self) -> Array:
        """The same at each point of the grid, (n, m)."""
        reach, flipped = self._kernels()
        gain = np.zeros(self.density.mass.shape)
        for left, kernel in zip(self._left, flipped, strict=True):
            gain += fftconvolve(np.pad(left, reach), kernel, mode="valid")
        return gain

    def finish(self) -> Cover:
        """Lay where the most mass is left, over and over, until next to nothing is."""
        d, gain = self.density, self.gain()
        reach, flipped = self._kernels()
        size = 2 * reach + 1
        while self.left > _LEFT:
            i, j = divmod(int(gain.argmax()), gain.shape[1])
            before = self._window(i, j, reach)
            self.lay(float(d.x[i]), float(d.y[j]))
            lost = fftconvolve(before - self._window(i, j, reach), flipped, axes=(1, 2)).sum(axis=0)
            rows, columns = (
                slice(max(0, k - 2 * reach), min(n, k + 2 * reach + 1)) for k, n in zip((i, j), gain.shape, strict=True)
            )
            gain[rows, columns] -= lost[
                rows.start - i + size - 1 : rows.stop - i + size - 1,
                columns.start - j + size - 1 : columns.stop - j + size - 1,
            ]
            gain[i, j] = min(gain[i, j], 0.0)
        return self

    def _kernels(self) -> tuple[int, Array]:
        """The areas on the grid, upside down, (sizes, 2 reach + 1, 2 reach + 1), and their reach in cells."""
        h = self.density.spacing
        reach = math.ceil(self._reach / h) + 1
        axis = np.asarray(h * np.arange(-reach, reach + 1))
        return reach, self._inside(axis[:, None], axis[None, :])[:, ::-1, ::-1]

    def _window(self, i: int, j: int, reach: int) -> Array:
        """What is left about a point of the grid, (sizes, 2 reach + 1, 2 reach + 1), zero beyond its edge."""
        size = 2 * reach + 1
        count, n, m = self._left.shape
        window = np.zeros((count, size, size))
        rows, columns = slice(max(0, i - reach), min(n, i + reach + 1)), slice(max(0, j - reach), min(m, j + reach + 1))
        window[
            :, rows.start - i + reach : rows.stop - i + reach, columns.start - j + reach : columns.stop - j + reach
        ] = self._left[:, rows, columns]
        return window

    def _patch(self, x: float, y: float) -> tuple[slice, slice, Array]:
        d, reach = self.density, self._reach + self.density.spacing
        rows = slice(*np.searchsorted(d.x, (x - reach, x + reach)))
        columns = slice(*np.searchsorted(d.y, (y - reach, y + reach)))
        return rows, columns, self._inside(d.x[rows, None] - x, d.y[None, columns] - y)

    def _inside(self, x: Array, y: Array) -> Array:
        """Share of each cell of the grid within the area, for each size."""
        return np.asarray(np.clip(self.shape.depth(x, y, self._factors) / self.density.spacing + 0.5, 0.0, 1.0))


def fewest(shape: Shape, density: Density, sizes: Sizes = ONE_SIZE) -> Cover:
    """The best cover found for an area whose size is drawn from `sizes` and not known."""
    empty = Cover(shape, density.thinned(), reduced(sizes, _SOUGHT))
    gain, middle = empty.gain(), sum(size * share for size, share in sizes.items())

    def lattice(spacing: float, squeezed: float, origin: int) -> Cover:
        over = _Lattice.over(empty.density, gain, spacing * middle, squeezed, origin)
        return over.laid(_more(empty, ())).finish()

    regular = {spacing: lattice(spacing, 1.0, 1) for spacing in _SPACINGS}
    spacing = min(regular, key=lambda spacing: regular[spacing].expected)
    others = [lattice(spacing, *other) for other in product(_SQUEEZED, range(3)) if other != (1.0, 1)]
    covers = sorted([_more(empty, ()).finish(), *regular.values(), *others], key=lambda cover: cover.expected)
    best = [cover.places for cover in covers[:2] + [_polished(cover) for cover in covers[:2]]]
    empty = Cover(shape, density, sizes)
    return min((_more(empty, places).finish() for places in best), key=lambda cover: cover.expected)


def _more(cover: Cover, places: Iterable[tuple[float, float]]) -> Cover:
    """A copy with these places laid after its own."""
    copy = Cover(cover.shape, cover.density, cover.sizes)
    for x, y in chain(cover.places, places):
        copy.lay(x, y)
    return copy


@dataclass(frozen=True, eq=False)
class _Lattice:
    """Places in order of their mass, and the gaps between three of them in the order in which the third comes."""

    places: Array  # (n, 2)
    gaps: Array  # (m, 2)
    third: NDArray[np.int_]  # (m,) place by which a gap is closed in

    @staticmethod
    def over(density: Density, gain: Array, spacing: float, squeezed: float, origin: int) -> _Lattice:
        """Over a density. `gain`: mass that its points would take each; `origin`: at a place, between two or three."""
        along, rows = spacing / math.sqrt(squeezed), spacing * math.sqrt(0.75 * squeezed)
        start = ((0.0, 0.0), (along / 2, 0.0), (along / 2, rows / 3))[origin]
        n, m = math.ceil(density.x[-1] / along) + 1, math.ceil(density.y[-1] / rows) + 1
        i, j = np.meshgrid(np.arange(-n, n + 1), np.arange(-m, m + 1), indexing="ij")
        x, y = start[0] + along * (i + 0.5 * (j % 2)), start[1] + rows * j
        cells = [(x - density.x[0]) / density.spacing, (y - density.y[0]) / density.spacing]
        mass = map_coordinates(gain, cells, order=1)
        order = np.argsort(-mass, axis=None, kind="stable")
        order = order[mass.ravel()[order] > _LEFT / 100]
        rank = np.full(mass.shape, mass.size)
        rank.ravel()[order] = np.arange(len(order))
        places = np.stack([x, y], axis=-1)
        inner = (slice(1, -1), slice(1, -1))
        step = j[inner] % 2  # to the right-hand neighbour in the rows above and below
        corners = [
            [(i[inner] + n, j[inner] + m), (i[inner] + n + 1, j[inner] + m), (i[inner] + n + step, j[inner] + m + side)]
            for side in (-1, 1)
        ]
        gaps = np.concatenate([np.mean([places[at] for at in triangle], axis=0).reshape(-1, 2) for triangle in corners])
        third = np.concatenate([np.max([rank[at] for at in triangle], axis=0).ravel() for triangle in corners])
        closed = np.argsort(third, kind="stable")[: int((third < mass.size).sum())]
        return _Lattice(places.reshape(-1, 2)[order], gaps[closed], third[closed])

    def laid(self, cover: Cover) -> Cover:
        """Lay the places one by one, and each gap as soon as it takes more than the next place."""
        gaps: list[tuple[float, int]] = []  # heap; what a gap took when last asked, which never grows
        start = 0
        for number, (x, y) in enumerate(self.places.tolist()):
            takes = cover.takes(x, y)
            while gaps and -gaps[0][0] > takes:
                gap = heappop(gaps)[1]
                now = cover.takes(*self.gaps[gap])
                if now >= max(takes, -gaps[0][0] if gaps else 0.0):
                    cover.lay(*map(float, self.gaps[gap]))
                    takes = cover.takes(x, y)
                elif now > _LEFT / 100:
                    heappush(gaps, (-now, gap))
            if cover.left <= _LEFT:
                break
            cover.lay(x, y)
            stop = int(np.searchsorted(self.third, number, side="right"))
            for gap in range(start, stop):
                heappush(gaps, (-cover.takes(*self.gaps[gap]), gap))
            start = stop
        return cover


def _polished(cover: Cover) -> Cover:
    """The first places moved downhill in E[N], on a coarser grid, and the rest laid anew; judged on the fine one."""
    first = Cover(cover.shape, cover.density, cover.sizes)
    for place in cover.places[:_POLISHED]:
        if first.left < _FEW:
            break
        first.lay(*place)
    if first.left >= _FEW:
        return cover
    coarse = cover.density
    while coarse.spacing < 0.13:
        coarse = coarse.thinned()
    seen = coarse.mass > 1e-3 * _LEFT * coarse.mass.max()
    x, y, mass = coarse.x[np.nonzero(seen)[0]], coarse.y[np.nonzero(seen)[1]], coarse.mass[seen]

    def cost(flat: Array) -> tuple[float, Array]:
        places, attempts, slope = flat.reshape(-1, 2), 0.0, np.zeros(len(flat))
        for size, share in cover.sizes.items():
            taken, steeper = _attempts_and_slope(cover.shape, size, places, x, y, mass, coarse.spacing)
            attempts, slope = attempts + share * taken, slope + share * steeper
        return attempts, slope

    found = minimize(cost, np.array(first.places).ravel(), jac=True, method="L-BFGS-B", options={"maxiter": 40})
    places = [(float(a), float(b)) for a, b in found.x.reshape(-1, 2)]
    return _more(Cover(cover.shape, cover.density, cover.sizes), places).finish()


def _attempts_and_slope(
    shape: Shape, size: float, places: Array, x: Array, y: Array, mass: Array, spacing: float
) -> tuple[float, Array]:
    """E[N] of places (n, 2) over masses at points for one size of the area, and its derivative (2 n,)."""
    n = len(places)
    dx, dy = x - places[:, :1], y - places[:, 1:]  # (n, points)
    reach = shape.reach * size + spacing
    place, point = np.nonzero((np.abs(dx) < reach) & (np.abs(dy) < reach))
    dx, dy = dx[place, point], dy[place, point]
    depth = shape.depth(dx, dy, size) / spacing + 0.5
    outside = np.ones((n, len(mass)))
    outside[place, point] -= np.clip(depth, 0.0, 1.0)
    missed = np.cumprod(np.vstack([np.ones_like(mass), outside]), axis=0)  # by the first 0 ... n places
    later = np.empty_like(outside)  # attempts after this one, per unit of mass that it misses
    later[-1] = float(n)
    for k in range(n - 2, -1, -1):
        later[k] = 1.0 + outside[k + 1] * later[k + 1]
    rims = (depth > 0) & (depth < 1)  # nothing else depends on the places
    place, point = place[rims], point[rims]
    worth = mass[point] * (missed[:-1] * later)[place, point] / spacing
    slopes = shape.slope(dx[rims], dy[rims], size)
    slope = np.stack([np.bincount(place, weights=worth * along, minlength=n) for along in slopes], axis=1)
    return float((missed[:-1] @ mass).sum() + n * missed[-1] @ mass), np.asarray(slope.ravel(), dtype=float)
