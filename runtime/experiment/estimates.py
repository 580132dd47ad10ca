"""Means with standard errors over seeds. Searches of one seed share a world: seeds are what is independent."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

_ROUNDING = 1e-12  # relative error of a mean of equal numbers


@dataclass(frozen=True)
class Estimate:
    """A value and its standard error; not a number where one seed alone gives none."""

    value: float
    error: float

    def __str__(self) -> str:
        if not math.isfinite(self.value):
            return "-"
        if not math.isfinite(self.error):
            return f"{self.value:.3g} (one seed)"
        if self.error <= _ROUNDING * abs(self.value):
            return f"{self.value:.4g} ± 0"
        digits = max(0, 1 - math.floor(math.log10(self.error)))
        return f"{self.value:.{digits}f} ± {self.error:.{digits}f}"


def mean_over_seeds(values: Sequence[Sequence[float]]) -> Estimate:
    """Mean of all values, grouped by seed, and its standard error from the scatter of the seeds' own means."""
    means = [float(np.mean(seed)) for seed in values if len(seed)]
    if not means:
        return Estimate(math.nan, math.nan)
    error = float(np.std(means, ddof=1)) / math.sqrt(len(means)) if len(means) > 1 else math.nan
    return Estimate(float(np.mean(means)), error)


def ratio_over_seeds(above: Sequence[Sequence[float]], below: Sequence[Sequence[float]]) -> Estimate:
    """Ratio of two means, seeds paired; its standard error by the jackknife over seeds."""
    a = np.array([np.mean(seed) for seed in above])
    b = np.array([np.mean(seed) for seed in below])
    if not len(a) or len(a) != len(b) or b.sum() == 0:
        return Estimate(math.nan, math.nan)
    ratio = float(a.sum() / b.sum())
    count = len(a)
    if count < 2 or np.any(b.sum() - b == 0):
        return Estimate(ratio, math.nan)
    without = (a.sum() - a) / (b.sum() - b)
    return Estimate(ratio, float(math.sqrt((count - 1) / count * np.sum((without - without.mean()) ** 2))))


def percentile_95(values: Sequence[Sequence[float]]) -> float:
    """The value that 95 % of all searches do not exceed."""
    return float(np.percentile(np.concatenate([np.asarray(seed, dtype=float) for seed in values]), 95))
