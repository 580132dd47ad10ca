"""The same attempts in the full physics and in the statistical model of it: one trial in both, and then the physics'
attempts, one by one, in the model's world of the same seed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

from runtime import config
from runtime.assembly import goal_for
from runtime.component import component
from runtime.errors import InputError
from runtime.experiment.model import Capture, StatisticalBench, along
from runtime.experiment.trial import Trial
from runtime.messages import Attempt, Belief, Candidate, Gaussian, Outcome, Proposal, SearchGoal, header
from runtime.plugin import SearchRecord
from runtime.world import Gap, World

_HALVINGS = 12  # of an interval in which a rim is sought
_FARTHEST = 4.0  # times the feasible area: what is farther from a slide's path does not matter


@dataclass(frozen=True)
class Twin:
    """One attempt of the physics, and what the model makes of the same proposal."""

    search: int  # from 1
    number: int  # within its search, from 1
    slide: bool  # a proposal with a path whose first point already went in was but a peck
    seated: bool
    model_seated: bool
    aborted: bool  # neither seated nor blocked in the physics
    margin: float  # [m] from where the pins first touch to the feasible area's rim, along the ray from its centre
    nearest: float  # a slide: how much the area must grow about its centre to reach the path; 0 for a peck
    moved: float  # [m] from where the attempt before ended; the first of a search begins where it is
    slid: float  # [m] along the path
    duration: float  # [s]
    model_duration: float  # [s]
    off: tuple[float, float]  # [m] of where the attempt ended against the place where the pins are centred
    seat_off: tuple[float, float]  # [m] of the seated TCP against it; nan if blocked


@dataclass(frozen=True)
class Pair:
    """What both did."""

    physics: tuple[SearchRecord, ...]
    model: tuple[SearchRecord, ...]
    twins: tuple[Twin, ...]


@dataclass(frozen=True)
class PairedTrial:
    """A trial of the statistical model, and the same in the full physics."""

    trial: Trial

    @property
    def content(self) -> Mapping[str, Any]:
        """The trial's."""
        return self.trial.content

    @property
    def code(self) -> tuple[str, ...]:
        """All modules of both."""
        return (*self._with(physics=False).code, *self._with(physics=True).code)

    def run(self) -> Pair:
        """Both, and the twins of all attempts."""
        trial = self.trial
        run = getattr(config.robot_of(trial.cell, trial.world.name), "bare_run", None)
        if run is None:
            raise InputError(f"{trial.cell.robot} is not simulated; there is no physics to compare with")
        real = run(trial.cell, trial.contender.make(), prior=trial.contender.prior)
        return Pair(real.searches, self._with(physics=False).run(), _twins(trial, real.attempts))

    def _with(self, *, physics: bool) -> Trial:
        return replace(self.trial, physics=physics)


def _twins(trial: Trial, attempts: tuple[Attempt, ...]) -> tuple[Twin, ...]:
    cell = trial.cell
    bench, world = StatisticalBench(cell), World(cell.board, component(cell.component), cell.tolerances, cell.seed)
    nothing = Belief(header(0), cell.board.type, "", 0, Gaussian(), [], [])
    twins: list[Twin] = []
    last: Attempt | None = None
    for attempt in attempts:
        goal = goal_for(cell, cell.board.hole(attempt.hole), nothing, attempt.board, attempt.search, 0)
        if last is None or last.search != attempt.search:
            bench.begin(attempt.search, attempt.board, attempt.hole)
            last = None
        twins.append(_twin(attempt, last, goal, bench, world.gap(attempt.search, attempt.board, attempt.hole)))
        last = attempt
    return tuple(twins)


def _twin(attempt: Attempt, last: Attempt | None, goal: SearchGoal, bench: StatisticalBench, gap: Gap) -> Twin:
    path = [(point.x, point.y) for point in attempt.path] or [(attempt.x, attempt.y)]
    proposal = Proposal(*path[0], path=attempt.path[1:])
    model = bench.attempt(goal, Candidate(header(0), goal.search, attempt.number, False, "", proposal))
    seated, nominal, where = attempt.outcome == Outcome.SEATED, goal.nominal.position, attempt.pose.position
    seat = (float(where.x - nominal.x - gap.x), float(where.y - nominal.y - gap.y))
    slid = _slid(path, attempt.x, attempt.y)
    slide = bool(attempt.path) and not (seated and slid == 0.0)
    return Twin(
        search=attempt.search,
        number=attempt.number,
        slide=slide,
        seated=seated,
        model_seated=model.outcome == Outcome.SEATED,
        aborted=attempt.outcome == Outcome.ABORTED,
        margin=_margin(gap, *path[0]),
        nearest=_nearest(gap, path) if slide else 0.0,
        moved=math.dist((last.x, last.y), path[0]) if last else 0.0,
        slid=slid,
        duration=attempt.duration,
        model_duration=model.duration,
        off=(float(attempt.x - gap.x), float(attempt.y - gap.y)),
        seat_off=seat if seated else (math.nan, math.nan),
    )


def _margin(gap: Gap, x: float, y: float) -> float:
    """How far [m] a point lies within the feasible area, along the ray from its centre; negative outside."""
    dx, dy = x - gap.x, y - gap.y
    length = math.hypot(dx, dy)
    if length == 0.0:
        dx, length = 1e-9, 1e-9
    low, high = 0.0, 1e-3 / length
    for _ in range(2 * _HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if gap.feasible(gap.x + middle * dx, gap.y + middle * dy) else (low, middle)
    return (low - 1.0) * length


def _nearest(gap: Gap, path: list[tuple[float, float]]) -> float:
    """The least factor by which the area, grown about its centre, reaches a path."""
    points = [path[0], *(point for _, point in along(path, Capture().step))]

    def reached(factor: float) -> bool:
        return any(gap.feasible(x, y, factor) for x, y in points)

    low, high = 0.0, _FARTHEST
    if not reached(high):
        return _FARTHEST
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        low, high = (low, middle) if reached(middle) else (middle, high)
    return high


def _slid(path: list[tuple[float, float]], x: float, y: float) -> float:
    """How far [m] along a path the point of it is that lies next to (x, y)."""
    nearest, slid, travelled = math.inf, 0.0, 0.0
    for (ax, ay), (bx, by) in pairwise(path):
        length = math.dist((ax, ay), (bx, by))
        share = ((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / length**2 if length else 0.0
        share = min(max(share, 0.0), 1.0)
        distance = math.dist((x, y), (ax + share * (bx - ax), ay + share * (by - ay)))
        if distance < nearest - 1e-9:
            nearest, slid = distance, travelled + share * length
        travelled += length
    return slid
