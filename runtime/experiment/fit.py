"""The statistical model's constants by least squares from attempts in the full physics."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from runtime.experiment.model import Capture, Timing
from runtime.experiment.paired import Pair, Twin

Array = NDArray[np.float64]

_FEWEST = 3  # data for a constant; with fewer the model's own is kept


@dataclass(frozen=True)
class Fitted:
    """One constant."""

    value: float  # in the model's unit
    error: float  # its standard error; nan where it is kept
    data: int  # attempts or searches that it comes from; 0 where the model's own is kept


def fit_timing(pairs: Sequence[Pair]) -> dict[str, Fitted]:
    """Every field of `Timing`."""
    given, twins = Timing(), [twin for pair in pairs for twin in pair.twins if not twin.aborted]

    def some(*, slide: bool, seated: bool) -> list[Twin]:
        return [twin for twin in twins if twin.slide == slide and twin.seated == seated]

    blocked, caught = some(slide=False, seated=False), some(slide=True, seated=True)
    found: dict[str, Fitted | None] = {}
    found["blocked"], slope = _line([twin.moved for twin in blocked], [twin.duration for twin in blocked])
    found["travel_speed"] = _inverse(slope)
    speed = (found["travel_speed"] or _kept(given.travel_speed)).value
    found["seated"] = _mean([twin.duration - twin.moved / speed for twin in some(slide=False, seated=True)])

    def still(twin: Twin) -> float:
        return twin.duration - twin.moved / speed

    found["slide_seated"], slope = _line([twin.slid for twin in caught], [still(twin) for twin in caught])
    found["slide_speed"] = _inverse(slope)
    slide_speed = (found["slide_speed"] or _kept(given.slide_speed)).value
    found["slide_blocked"] = _mean([still(twin) - twin.slid / slide_speed for twin in some(slide=True, seated=False)])

    timing = Timing(**{name: fitted.value for name, fitted in found.items() if fitted})
    found["part"] = _mean([rest for pair in pairs for rest in _rests(pair, timing)])
    return {name: found[name] or _kept(getattr(given, name)) for name in vars(given)}


def _rests(pair: Pair, timing: Timing) -> list[float]:
    """What the parts that were seated took [s] beside their attempts, as `timing` has those."""
    spent: dict[int, float] = {}
    for twin in pair.twins:
        slid = twin.slid if twin.slide else None
        duration = timing.attempt(moved=twin.moved, seated=twin.seated, slid=slid)
        spent[twin.search] = spent.get(twin.search, 0.0) + duration
    return [search.part_time - spent[number] for number, search in enumerate(pair.physics, 1) if search.seated]


def fit_capture(pairs: Sequence[Pair]) -> dict[str, Fitted]:
    """Every field of `Capture` that can be measured."""
    twins, given = [twin for pair in pairs for twin in pair.twins if not twin.aborted], Capture()
    found = {"swath": _swath([twin for twin in twins if twin.slide and twin.margin < 0])}
    for kind, slide in (("peck", False), ("slide", True)):
        seated = [twin for twin in twins if twin.seated and twin.slide == slide]
        found[f"{kind}_kept"], found[f"{kind}_noise"] = _seat(seated)
    return {name: fitted or _kept(getattr(given, name)) for name, fitted in found.items()}


def _seat(seated: Sequence[Twin]) -> tuple[Fitted | None, Fitted | None]:
    """Which share of where it was tried a part keeps when it goes in, and the noise about that [m]."""
    if len(seated) < _FEWEST:
        return None, None
    tried, sat = (np.array([getattr(twin, name) for twin in seated]).ravel() for name in ("off", "seat_off"))
    share = float(tried @ sat / (tried @ tried))
    noise = math.sqrt(float(np.mean((sat - share * tried) ** 2)))
    count = len(sat)
    error = noise / math.sqrt(float(tried @ tried))
    return Fitted(share, error, len(seated)), Fitted(noise, noise / math.sqrt(2 * count), len(seated))


def _swath(slides: Sequence[Twin]) -> Fitted | None:
    """The share of the area which tells best what slides caught: the least of those that tell fewest wrong.

    Its error is the width of their range.
    """
    if len(slides) < _FEWEST or all(twin.seated for twin in slides) or not any(twin.seated for twin in slides):
        return None
    shares = np.sort([twin.nearest for twin in slides])
    wrong = np.array([sum((twin.nearest <= share) != twin.seated for twin in slides) for share in shares])
    best = int(wrong.argmin())
    return Fitted(float(shares[best]), float(shares[min(best + 1, len(shares) - 1)] - shares[best]), len(slides))


def _line(x: Sequence[float], y: Sequence[float]) -> tuple[Fitted | None, Fitted | None]:
    """Intercept and slope of y over x; none where x hardly varies."""
    if len(x) < _FEWEST or np.ptp(x) < 1e-4:
        return None, None
    design = np.stack([np.ones(len(x)), np.asarray(x)], axis=1)
    found = np.linalg.lstsq(design, np.asarray(y), rcond=None)[0]
    variance = np.sum((np.asarray(y) - design @ found) ** 2) / (len(x) - 2)
    errors = np.sqrt(np.diag(variance * np.linalg.inv(design.T @ design)))
    intercept, slope = (Fitted(float(v), float(e), len(x)) for v, e in zip(found, errors, strict=True))
    return intercept, slope


def _inverse(fitted: Fitted | None) -> Fitted | None:
    if fitted is None or fitted.value <= 0:
        return None
    return Fitted(1 / fitted.value, fitted.error / fitted.value**2, fitted.data)


def _mean(values: Sequence[float]) -> Fitted | None:
    if len(values) < _FEWEST:
        return None
    return Fitted(float(np.mean(values)), float(np.std(values, ddof=1)) / math.sqrt(len(values)), len(values))


def _kept(value: float) -> Fitted:
    return Fitted(value, math.nan, 0)
