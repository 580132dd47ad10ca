"""Fewest attempts for a normal density of any width, from a table that is computed once for each shape of area.

What is tabulated is by how much the best cover found exceeds the bound: between 1 for narrow densities, where one
attempt does, and 1.18 for wide ones, with 1.27 in between. It hardly depends on how elongated the density is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from runtime.experiment.cover import Shape, bound, fewest, normal_density

Array = NDArray[np.float64]

_WIDTHS = (
    0.2,
    0.3,
    0.4,
    0.52,
    0.68,
    0.85,
    1.05,
    1.4,
    2.0,
    3.0,
)  # geometric means; beyond them the excess no longer changes
_RATIOS = (1.0, 1.6, 2.8)  # of the wider to the narrower width, the wider along x


@dataclass(frozen=True, eq=False)
class CoverTable:
    """Of one shape."""

    excess: Array  # (widths, ratios) fewest attempts found, over the bound

    def fewest(self, widths: tuple[float, float]) -> float:
        """Mean attempts of the best cover found of a normal density with these two widths, in the area's own units.

        Interpolation costs less than 1 % of accuracy while one width is at most three times the other; beyond that
        the value is that of three times.
        """
        mean = math.sqrt(widths[0] * widths[1])
        at = min(max(mean, _WIDTHS[0]), _WIDTHS[-1])
        row = PchipInterpolator(np.log(_WIDTHS), self.excess)(math.log(at))
        # The excess is an even function of the logarithm of the ratio, so close to linear in its square.
        excess = np.interp(math.log(widths[0] / widths[1]) ** 2, np.log(_RATIOS) ** 2, row)
        return float(excess) * bound(mean)


def cover_table(shape: Shape) -> CoverTable:
    """The table of a shape; some ten seconds where it was not asked for before in this process."""
    return _table(tuple(round(float(reach), 3) for reach in shape.rim))


@cache
def _table(rim: tuple[float, ...]) -> CoverTable:
    shape = Shape(np.array(rim))
    excess = np.ones((len(_WIDTHS), len(_RATIOS)))
    for i, mean in enumerate(_WIDTHS[1:], 1):
        for j, ratio in enumerate(_RATIOS):
            density = normal_density(mean * math.sqrt(ratio), mean / math.sqrt(ratio))
            excess[i, j] = max(1.0, fewest(shape, density).expected / bound(mean))
    return CoverTable(excess)
