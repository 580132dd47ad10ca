"""Fitting what the paper leaves unsaid to a table of its cycle times."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.experiment.match_model import Spread, Worlds, draw, simulate
from runtime.experiment.matched import Clock, Settings
from runtime.experiment.paper import METHODS, CycleTimes

Array = NDArray[np.float64]

FIRST_SEED = 100_001  # of those that are fitted to: tables are told about others
BOUNDS = {
    "common_error": (0.0, 1.2e-3),
    "board_shift": (0.02e-3, 0.4e-3),
    "hole_bias": (0.05e-3, 0.6e-3),
    "part_scatter": (0.05e-3, 0.2e-3),  # hole 7, which the paper calls scattered, has three times that
    "stride": (0.1e-3, 0.398e-3),  # up to 1.6 feasible radii, beyond which a line steps over holes
    "cycles": (10.0, 60.0),
    "step": (math.radians(25), math.radians(120)),
    "pitch": (0.15e-3, 1.0e-3),
    "prior_width": (0.3e-3, 1.5e-3),
    "mean_count": (0.02, 2.0),
    "covariance_count": (0.3, 4.0),
}
PARTS = ((1.0, 4.0), (0.1, 1.5), (0.1, 1.5))  # [s] bounds of a Clock, in its order
POPULATION = 6  # of differential evolution, for each parameter


@dataclass(frozen=True)
class Match:
    """What fits a table best, and how well."""

    spread: Spread
    settings: Settings
    clock: Clock
    rmse: float  # [s] over all boards of all methods, on the seeds it was fitted to


def match(table: CycleTimes, seeds: int, generations: int) -> Match:
    """Differential evolution over tolerances and settings; the clock that goes with them by least squares."""
    from scipy.optimize import Bounds, differential_evolution

    worlds = draw(table.component, range(FIRST_SEED, FIRST_SEED + seeds))

    def loss(vector: Array) -> float:
        return _fitted(table, worlds, vector)[1]

    found = differential_evolution(
        loss,
        Bounds(*np.transpose(list(BOUNDS.values()))),
        popsize=POPULATION,
        maxiter=generations,
        rng=np.random.default_rng(0),
        tol=0.0,
        polish=False,
        init="sobol",
    )
    clock, rmse = _fitted(table, worlds, found.x)
    return Match(*_parameters(found.x), clock, rmse)


def fit_clock(table: CycleTimes, attempts: Mapping[str, Array]) -> tuple[Clock, float]:
    """The clock under which these attempts of whole boards (boards,) come closest to a table, and the RMSE [s]."""
    from scipy.optimize import lsq_linear

    unit = (Clock(1.0, 0.0, 0.0), Clock(0.0, 1.0, 0.0), Clock(0.0, 0.0, 1.0))
    design = np.array([[one.board(name, float(n)) for one in unit] for name in METHODS for n in attempts[name]])
    printed = np.concatenate([table.cycles[name] for name in METHODS])
    low, high = zip(*PARTS, strict=True)
    found = lsq_linear(design, printed, (low, high), method="bvls")
    return Clock(*map(float, found.x)), math.sqrt(float(np.mean((design @ found.x - printed) ** 2)))


def _fitted(table: CycleTimes, worlds: Worlds, vector: Array) -> tuple[Clock, float]:
    outcomes = simulate(worlds, *_parameters(vector))
    return fit_clock(table, {name: outcome.by_board for name, outcome in outcomes.items()})


def _parameters(vector: Array) -> tuple[Spread, Settings]:
    named: dict[str, Any] = dict(zip(BOUNDS, map(float, vector), strict=True))
    spread = Spread(**{field.name: named.pop(field.name) for field in fields(Spread)})
    return spread, Settings(**{**named, "cycles": round(named["cycles"])})
