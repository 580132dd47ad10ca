"""Where one hole may still be: a density on a grid from which every failure takes what it has ruled out.

Lengths are in the feasible area's own units (`FeasibleArea`): about its half axes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft2, next_fast_len, rfft2
from scipy.ndimage import distance_transform_edt
from scipy.special import ndtr

from runtime.feasible_area import FeasibleArea
from runtime.hierarchy import Mixture

Array = NDArray[np.float64]
Field = NDArray[np.float32]

_NODES = (-1.55, 0.0, 1.55)  # standard deviations of the area's size at which it is considered, and their weights:
NODE_WEIGHTS = np.array([0.2, 0.6, 0.2])  # a normal's first moments up to the fourth, nearly
_BETWEEN = 0.55  # of that standard deviation: what lies between the nodes
_REACH = 3.3  # standard deviations that the grid extends to
_CELLS = (24, 220)  # of a side, least and most
_FINE, _COARSE = 1 / 6, 1 / 3.3  # size of a cell
_SIZES = tuple(_FINE * (_COARSE / _FINE) ** (step / 6) for step in range(7))  # few, so that kernels are made once
_MERGED = 9  # components of a density, at most: those of one scale are gathered
_TIE = 1e-5  # relative difference of masses that single precision does not tell


@dataclass(frozen=True, eq=False)
class _Peck:
    point: Array  # (2,)


@dataclass(frozen=True, eq=False)
class _Slide:
    path: Array  # (n, 2)
    share: float
    catch: float


def hit(area: FeasibleArea, size_spread: float, errors: Array) -> Array:
    """Probability (nodes, ...) that a part goes in when it is off by `errors` (..., 2), for each size of the area."""
    size = 1 + size_spread * np.array(_NODES)
    gauge = area.gauge(errors)
    return np.asarray(ndtr((size.reshape(-1, *[1] * gauge.ndim) - gauge) / (_BETWEEN * size_spread)))


@lru_cache(maxsize=64)
def _hits(area: FeasibleArea, size_spread: float, cell: float, side: int) -> NDArray[np.complexfloating]:
    """Transform (nodes, side, side / 2 + 1) of the probability that a part goes in, for the errors on a grid."""
    index = np.arange(side)
    away = np.where(index < side / 2, index, index - side) * cell
    errors = np.stack(np.meshgrid(away, away, indexing="ij"), axis=-1)
    return np.asarray(rfft2(hit(area, size_spread, errors).astype(np.float32)))


class OffsetGrid:
    """The density of one offset, and what failures left of it."""

    def __init__(self, area: FeasibleArea, belief: Mixture, size_spread: float) -> None:
        """`size_spread` is the relative standard deviation of the area's size from part to part."""
        self._area, self._size_spread = area, size_spread
        inverse = np.linalg.inv(area.half_axes)
        own = Mixture(
            belief.weights,
            belief.means @ inverse.T,
            np.einsum("ai,nij,bj->nab", inverse, belief.covariances, inverse),
        )
        self._belief = _merged(own)
        self.mean = self._belief.mean  # (2,)
        whole = self._belief.covariance
        self.width = float(np.linalg.det(whole)) ** 0.25
        self._failures: list[_Peck | _Slide] = []
        self._masses: Array | None = None  # computed when asked for
        self._exhausted = 0.05  # of the density left, below which the grid is too small for what is left
        self._build(_REACH * float(np.linalg.eigvalsh(whole)[-1]) ** 0.5 + 1.0)

    @property
    def left(self) -> float:
        """Probability that the failures so far were to be expected."""
        return float(self._mass.sum())

    def masses(self) -> Array:
        """Probability (side, side) of success at each point of the grid, given all that has failed."""
        if self._masses is None:
            hits = _hits(self._area, self._size_spread, self.cell, self.side)
            found = (rfft2(self._mass) * hits).sum(axis=0)
            mass = irfft2(found, s=(self.side, self.side))
            self._masses = np.asarray(np.maximum(mass, 0.0) / max(self.left, 1e-30), dtype=float)
        return self._masses

    def cell_of(self, point: Array) -> tuple[int, int]:
        """Row and column of the cell that holds a point (2,), whether or not they are within the grid."""
        row, column = np.rint((point - self._points[0, 0]) / self.cell).astype(int)
        return int(row), int(column)

    def survival(self) -> Array:
        """Probability (side, side) that all that was tried would have failed, had the offset been there."""
        return np.asarray(self._mass.sum(axis=0) / np.maximum(self._prior, 1e-30), dtype=float)

    def points(self) -> Array:
        """Centres (side, side, 2) of the cells."""
        return np.asarray(self._points)

    def failed(self, path: Array, share: float, catch: float) -> None:
        """An attempt along points (n, 2) was blocked: a peck at the only one, or a slide, which first touched there."""
        self.miss(path[0])
        if len(path) > 1:
            self.passed(path, share, catch)

    def miss(self, point: Array) -> None:
        """A part did not go in at a point (2,)."""
        self._learn(_Peck(point))

    def passed(self, path: Array, share: float, catch: float) -> None:
        """A part slid along points (n, 2) and did not drop in.

        It would have in `catch` of all cases that pass within `share` of the area, which is taken for a disc here.
        """
        self._learn(_Slide(path, share, catch))

    def _learn(self, failure: _Peck | _Slide) -> None:
        self._failures.append(failure)
        self._masses = None
        self._cut(failure)
        if self.left < self._exhausted and self.side < _CELLS[1]:
            self._exhausted /= 2
            self._build(1.5 * self.half)

    def _build(self, half: float) -> None:
        cell = min(max(2 * half / 72, _FINE), _COARSE)
        self.cell = min(_SIZES, key=lambda size: abs(size - cell))
        side = next_fast_len(int(min(max(2 * half / self.cell, _CELLS[0]), _CELLS[1])), real=True)
        self.side = min(side + side % 2, _CELLS[1])
        self.half = self.side * self.cell / 2
        along = (np.arange(self.side) - self.side // 2) * self.cell
        self._points = self.mean + np.stack(np.meshgrid(along, along, indexing="ij"), axis=-1)
        density = np.zeros((self.side, self.side), dtype=np.float32)
        belief = self._belief
        for weight, mean, covariance in zip(belief.weights, belief.means, belief.covariances, strict=True):
            precision = np.linalg.inv(covariance)
            x, y = along + self.mean[0] - mean[0], along + self.mean[1] - mean[1]
            exponent = precision[0, 0] * (x * x)[:, None] + precision[1, 1] * y * y
            exponent += (2 * precision[0, 1]) * np.outer(x, y)
            scale = weight * self.cell**2 * float(np.sqrt(np.linalg.det(precision))) / (2 * np.pi)
            density += (scale * np.exp(-0.5 * exponent)).astype(np.float32)
        self._prior = density
        self._mass: Field = NODE_WEIGHTS.astype(np.float32)[:, None, None] * density
        for failure in self._failures:
            self._cut(failure)

    def _cut(self, failure: _Peck | _Slide) -> None:
        if isinstance(failure, _Slide):
            self._mass *= (1 - failure.catch * self._swept(failure)).astype(np.float32)
            return
        window = int(np.ceil((1 + 4 * self._size_spread) * 1.6 / self.cell)) + 1
        row, column = self.cell_of(failure.point)
        rows = slice(max(row - window, 0), max(row + window + 1, 0))
        columns = slice(max(column - window, 0), max(column + window + 1, 0))
        offsets = self._points[rows, columns]
        if offsets.size:
            hits = hit(self._area, self._size_spread, failure.point - offsets)
            self._mass[:, rows, columns] *= (1 - hits).astype(np.float32)

    def _swept(self, slide: _Slide) -> Array:
        """Probability (nodes, side, side) that the slide passed near enough, for each offset."""
        steps = np.diff(slide.path, axis=0)
        counts = np.maximum(np.ceil(np.hypot(steps[:, 0], steps[:, 1]) / (self.cell / 2)), 1).astype(int)
        along = np.concatenate([np.arange(count) / count for count in counts])
        passed = np.repeat(slide.path[:-1], counts, axis=0) + along[:, None] * np.repeat(steps, counts, axis=0)
        passed = np.concatenate([passed, slide.path[-1:]])
        cells = np.rint((passed - self._points[0, 0]) / self.cell).astype(int)
        cells = cells[((cells >= 0) & (cells < self.side)).all(axis=1)]
        far = np.ones((self.side, self.side), dtype=bool)
        far[cells[:, 0], cells[:, 1]] = False
        if not len(cells):
            return np.zeros((len(_NODES), 1, 1))
        distance = distance_transform_edt(far) * self.cell
        size = slide.share * (1 + self._size_spread * np.array(_NODES))
        return np.asarray(ndtr((size[:, None, None] - distance) / (_BETWEEN * self._size_spread)))


def best(values: Array) -> int:
    """Index of the greatest value; of equals the first, whatever the machine's rounding makes of them."""
    return int(np.argmax(values >= (1 - _TIE) * values.max()))


def _merged(whole: Mixture) -> Mixture:
    """A mixture with its components of like scale gathered into one each, by their moments."""
    if len(whole.weights) <= _MERGED:
        return whole
    scale = 0.25 * np.log(np.linalg.det(whole.covariances))
    edges = np.linspace(scale.min(), scale.max() + 1e-9, _MERGED + 1)
    group = np.digitize(scale, edges) - 1
    used = np.unique(group)
    member = (group == used[:, None]) * whole.weights  # (groups, n)
    total = member.sum(axis=1)
    share = member / total[:, None]
    centre = share @ whole.means
    apart = whole.means - centre[:, None]  # (groups, n, 2)
    within = np.einsum("gn,nij->gij", share, whole.covariances)
    return Mixture(total, centre, within + np.einsum("gn,gni,gnj->gij", share, apart, apart))
