"""Bayes search that slides: the same belief, but the pins stay on the board where that saves time."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from runtime.messages import SearchGoal
from runtime.plugin import Search
from runtime.quantity import Duration, Length, Positive, Speed
from strategies.learning import Reading
from strategies.offset_grid import best
from strategies.pursuit import Pursuit, lattice_cells

Array = NDArray[np.float64]

_SHORT = 1e-6  # [m] ways are not shorter


@dataclass(frozen=True)
class BayesSlide:
    """The belief of bayes, and slides under light force along the path on which most of it lies per second.

    A slide first touches where a peck would, and goes on from there over the cells of a lattice, always to the one
    with the most probability left per way to it. Pins that slide fall in where `swath` of the feasible area passes,
    in `catch` of all cases, so what was slid over is not ruled out for good. Peck or slide is chosen by the time that
    the insertion is expected to take.

    The model may be wrong: after `patience` attempts every other one, and after three times as many every one, is a
    peck of the sweep that finds any hole within the search radius. Where the search before found nothing either, so
    that the board may be the wrong one, `patience` attempts are all.
    """

    patience: Annotated[int, Field(ge=1, le=10_000)] = 12  # attempts
    size: Annotated[float, Field(ge=0.5, le=1.5)] = 0.97  # of the stated feasible area's half axes: parts are turned
    size_spread: Annotated[float, Field(ge=0.02, le=0.5)] = 0.15  # of them, from part to part
    slide_noise: Annotated[Length, Positive] = 0.09e-3  # [m] per axis, of a slid part's position as a hole's centre
    peck_time: Annotated[Duration, Positive] = 0.37  # [s] that a blocked peck takes
    travel_speed: Annotated[Speed, Positive] = 0.05  # [m/s] between positions
    slide_time: Annotated[Duration, Positive] = 0.40  # [s] that a blocked slide takes beside its way
    push_time: Annotated[Duration, Positive] = 0.1  # [s] that pushing a part home after a slide takes more than a peck
    slide_speed: Annotated[Speed, Positive] = 10e-3  # [m/s]
    longest: Annotated[Length, Positive] = 20e-3  # [m] way of one slide
    swath: Annotated[float, Field(gt=0.2, le=1.0)] = Reading.swath  # of the feasible area
    catch: Annotated[float, Field(gt=0.0, le=1.0)] = Reading.catch
    spacing: Annotated[float, Field(ge=0.5, le=2.0)] = 1.5  # [half axes of the area] of the lattice

    def search(self, goal: SearchGoal) -> Search:
        """Propose slides and pecks until the search radius is swept."""
        reading = Reading(self.size_spread, self.slide_noise, self.swath, self.catch)
        pursuit = Pursuit(goal, self.size, reading)
        number = 0
        while True:
            number += 1
            if pursuit.brief and number > self.patience:
                return
            if not pursuit.brief and pursuit.guard_is_due(number, self.patience):
                point = pursuit.guarded()
                if point is None:
                    return
                path = [point]
            else:
                path = self._path(pursuit)
            yield pursuit.attempt(path)
            pursuit.failed(path)

    def _path(self, pursuit: Pursuit) -> list[Array]:
        """Where to touch first, and then the way on; no way if pecks are expected to be done sooner."""
        first = pursuit.worthiest(self.peck_time, self.travel_speed)
        cells = lattice_cells(pursuit.grid.cell, pursuit.grid.side, self.spacing)
        points = pursuit.area.to_metres(pursuit.grid.points().reshape(-1, 2)[cells])
        mass = pursuit.allowed().ravel()[cells] * self._share  # of each lattice cell
        mass[pursuit.area.gauge(pursuit.area.to_own(points - first)) < 1.0] = 0.0
        path, found, travelled = [first], [0.0], [0.0]
        for _ in range(len(cells)):
            way = np.hypot(*(points - path[-1]).T)
            step = best(mass / np.maximum(way, _SHORT))
            if mass[step] <= 0.0 or travelled[-1] + way[step] > self.longest:
                break
            path.append(points[step])
            found.append(float(mass[step]))
            travelled.append(travelled[-1] + float(way[step]))
            mass[step] = 0.0
        return path if self._pays(np.array(found), np.array(travelled)) else path[:1]

    @property
    def _share(self) -> float:
        """Area of a lattice cell over the feasible area."""
        return self.spacing**2 * math.sqrt(3) / 2 / math.pi

    def _pays(self, found: Array, travelled: Array) -> bool:
        """Whether going on from a blocked touch by sliding takes less time than by pecks over the same ground.

        `found` is the probability that each point of the path brings, `travelled` [m] the way to it.
        """
        left = max(1.0 - float(found.sum()), 0.0)
        slid = travelled / self.slide_speed
        pecked = np.arange(len(found)) * self._share * self.peck_time
        slide = float(found @ (self.push_time + slid)) + left * (self.slide_time - self.peck_time + float(slid[-1]))
        return slide < float(found @ pecked) + left * float(pecked[-1])
