"""The paper's four methods and their clock, as matched to its Tables 1 and 2.

The paper states neither its tolerances nor its strategies' parameters nor what an attempt costs. They were found by
`palpate experiment match` (see there); the tolerances are the worlds `paper-igbt` and `paper-capacitor`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from runtime.cell import SearchLimits
from runtime.component import COMPONENTS, feasible_radius
from runtime.experiment.contenders import Contender
from runtime.experiment.paper import HOLES, METHODS
from runtime.experiment.worlds import NamedWorld, world

MAX_ATTEMPTS = 60
REPULSION = 6e6  # [1/m^2] lambda of meta's covers, in the corrected Eq. 45: they touch each other and leave few gaps
SEARCH = SearchLimits(radius=15e-3, max_attempts=MAX_ATTEMPTS, prior_width=0.5e-3)
"""So wide that only the attempts end a search: the paper states a longest search time and no radius."""


@dataclass(frozen=True)
class Clock:
    """Seconds of the paper's cell: what a part costs, and what each attempt."""

    part: float  # [s]
    attempt: float  # [s] of line and meta search
    spiral_attempt: float  # [s] of spiral search; hybrid search takes the mean of both

    def per_attempt(self, method: str) -> float:
        """Time [s] that a method takes for each attempt."""
        spiral_share = {"spiral": 1.0, "hybrid": 0.5}.get(method, 0.0)
        return (1 - spiral_share) * self.attempt + spiral_share * self.spiral_attempt

    def board(self, method: str, attempts: float) -> float:
        """Time [s] of a board on which `attempts` were made altogether."""
        return HOLES * self.part + self.per_attempt(method) * attempts


@dataclass(frozen=True)
class Settings:
    """What the four methods are given, as far as it is matched."""

    stride: float  # [m] s of Eqs. 10-11, of line and hybrid
    cycles: int  # m of the line, after which it gives up
    step: float  # [rad] theta_d of Eq. 14, of spiral and hybrid
    pitch: float  # [m] between the turns of the spiral
    prior_width: float  # [m] of meta: N(m0, I) in this unit
    mean_count: float  # insertions that meta's prior mean is worth
    covariance_count: float  # insertions that meta's prior covariance is worth


@dataclass(frozen=True)
class Matched:
    """All that stands in for what one of the paper's tables leaves unsaid."""

    world_name: str
    component: str
    settings: Settings
    clock: Clock

    @property
    def world(self) -> NamedWorld:
        """The matched tolerances, with the paper's bound of a search."""
        return replace(world(self.world_name), search=SEARCH)

    @property
    def methods(self) -> tuple[Contender, ...]:
        """The four methods in the paper's order."""
        return methods(self.component, self.settings)


def methods(component: str, settings: Settings) -> tuple[Contender, ...]:
    """The paper's four methods with these settings.

    Line, spiral and hybrid (by turns) are the equations as printed, about the mean of the hole's earlier successes.
    Meta is the corrected one: with Eqs. 28-30 and 45-46 as printed it has no estimate and no covers, see table3.
    """
    radius = feasible_radius(COMPONENTS[component])
    line: dict[str, Any] = {"stride": _millimetres(settings.stride), "cycles": settings.cycles}
    spiral: dict[str, Any] = {"step": f"{math.degrees(settings.step):.6g} deg", "pitch": settings.pitch / radius}
    as_printed: dict[str, Any] = {"variant": "literal", "start": "hole"}
    meta: dict[str, Any] = {
        "start": "hole",
        "prior_width": _millimetres(settings.prior_width),
        "mean_count": settings.mean_count,
        "covariance_count": settings.covariance_count,
        "covers": MAX_ATTEMPTS,
        "repulsion": f"{REPULSION:g} m^-2",
    }
    given = (line | as_printed, spiral | as_printed, line | spiral | as_printed, meta)
    return tuple(Contender(name, name, one) for name, one in zip(METHODS, given, strict=True))


IGBT = Matched(
    "paper-igbt",
    "igbt",
    Settings(
        stride=0.188e-3,
        cycles=53,
        step=math.radians(72.8),
        pitch=0.317e-3,
        prior_width=1.12e-3,
        mean_count=0.166,
        covariance_count=2.73,
    ),
    Clock(part=3.66, attempt=0.183, spiral_attempt=0.174),
)
CAPACITOR = Matched(
    "paper-capacitor",
    "capacitor",
    Settings(
        stride=0.244e-3,
        cycles=59,
        step=math.radians(119.5),
        pitch=0.346e-3,
        prior_width=0.524e-3,
        mean_count=1.19,
        covariance_count=1.78,
    ),
    Clock(part=4.0, attempt=0.234, spiral_attempt=0.154),
)
MATCHED = {matched.component: matched for matched in (IGBT, CAPACITOR)}


def _millimetres(length: float) -> str:
    return f"{1e3 * length:.6g} mm"
