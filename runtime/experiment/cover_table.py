"""Fewest attempts for a normal density of any width, from a table for each shape and spread of sizes.

What is tabulated is by how much the best cover found exceeds the bound, which knows each size: between 1 for narrow
densities, where one attempt does, and 1.18 for wide ones, with 1.27 in between, if there is one size; 1.4 for wide ones
if sizes scatter by 12 %. It hardly depends on how elongated the density is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from scipy.interpolate import PchipInterpolator

from runtime.experiment.cover import Shape, Sizes, bound, fewest, normal_density, reduced

Pairs = tuple[tuple[float, float], ...]

# Geometric means, for a mean size of 1; beyond them the excess changes little.
_WIDTHS = (0.2, 0.3, 0.4, 0.52, 0.68, 0.85, 1.05, 1.4, 2.0, 3.0)
_RATIOS = (1.0, 1.6, 2.8)  # of the wider to the narrower width, the wider along x
_NODES = 5  # sizes that stand for a distribution
_LITTLE = 1e-3  # weight of an entry that is not worth its computing


@dataclass(frozen=True, eq=False)
class CoverTable:
    """Of one shape with one distribution of sizes; entries are computed when they are first asked for."""

    shape: Shape
    sizes: Sizes

    def fewest(self, widths: tuple[float, float]) -> float:
        """Mean attempts of the best cover found of a normal density with these two widths, in the area's own units.

        Interpolation costs some 1 % of accuracy while one width is at most three times the other; beyond that the value
        is that of three times. Infinite if some sizes are 0.
        """
        if min(self.sizes) <= 0:
            return math.inf
        mean, middle = math.sqrt(widths[0] * widths[1]), _mean(self.sizes)
        # The excess is an even function of the logarithm of the ratio, so close to linear in its square.
        at, squares = math.log(widths[0] / widths[1]) ** 2, np.log(_RATIOS) ** 2
        j = min(max(int(np.searchsorted(squares, at)) - 1, 0), len(_RATIOS) - 2)
        share = min((at - squares[j]) / (squares[j + 1] - squares[j]), 1.0)
        excess = (1 - share) * self._excess(mean / middle, j)
        if share > _LITTLE:
            excess += share * self._excess(mean / middle, j + 1)
        else:
            excess /= 1 - share
        return float(excess) * _known(self.sizes, mean)

    def _excess(self, width: float, j: int) -> float:
        """Of densities with ratio j, over the bound."""
        at = min(max(width, _WIDTHS[0]), _WIDTHS[-1])
        i = min(max(int(np.searchsorted(_WIDTHS, at)) - 1, 0), len(_WIDTHS) - 2)
        rows = range(max(i - 1, 0), min(i + 3, len(_WIDTHS)))  # no other bears on what lies between i and i + 1
        entries = [_entry(*self._key, row, j) for row in rows]
        return float(PchipInterpolator(np.log([_WIDTHS[row] for row in rows]), entries)(math.log(at)))

    @cached_property
    def _key(self) -> tuple[tuple[float, ...], Pairs]:
        middle = _mean(self.sizes)
        few = reduced({size / middle: share for size, share in self.sizes.items()}, _NODES)
        pairs = tuple((round(size, 3), round(share, 4)) for size, share in few.items())
        return tuple(round(float(reach), 3) for reach in self.shape.rim), pairs


def _mean(sizes: Sizes) -> float:
    return sum(size * share for size, share in sizes.items())


def _known(sizes: Sizes, width: float) -> float:
    """Attempts that no sequence goes below on average, even one that knows each size."""
    return sum(share * bound(width / size) for size, share in sizes.items())


@cache
def _entry(rim: tuple[float, ...], sizes: Pairs, i: int, j: int) -> float:
    """Fewest attempts found, over the bound."""
    whole = sum(share for _, share in sizes)  # 1, but for rounding
    shares = {size: share / whole for size, share in sizes}
    wide, narrow = (_WIDTHS[i] * factor for factor in (math.sqrt(_RATIOS[j]), 1 / math.sqrt(_RATIOS[j])))
    found = fewest(Shape(np.array(rim)), normal_density(wide, narrow), shares).expected
    return max(1.0, found / _known(shares, _WIDTHS[i]))
