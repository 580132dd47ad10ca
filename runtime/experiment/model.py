"""The statistical model of a cell: the same worlds and jobs as the full physics, without contact.

An attempt succeeds exactly where the geometry says that every pin's tip lies over its hole; how long it takes and how
exactly a seated part tells its place was measured in the full physics (`palpate experiment calibrate` compares).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol

import numpy as np

from runtime.component import component
from runtime.config import Cell
from runtime.messages import (
    NANOSECONDS,
    Attempt,
    Candidate,
    Outcome,
    Pose,
    SearchGoal,
    Vector3,
    Waypoint,
    Wrench,
    header,
)
from runtime.world import Gap, World

Point = tuple[float, float]  # [m] from nominal


@dataclass(frozen=True)
class Timing:
    """How long things take [s]: what `palpate experiment calibrate` finds to fit the full physics best."""

    part: float = 6.73  # to fetch a part, bring it over the first place to try, let go and rise
    blocked: float = 0.40  # a peck that meets the board, with the way up
    seated: float = 0.92  # a peck that goes in
    travel_speed: float = 0.0285  # [m/s] between the positions of successive attempts
    slide_blocked: float = 0.45  # a slide that meets no hole, beside the way slid
    slide_seated: float = 0.725  # a slide that does, beside the way slid
    slide_speed: float = 9.57e-3  # [m/s] along the path, all told

    def attempt(self, *, moved: float, seated: bool, slid: float | None = None) -> float:
        """Duration [s] of an attempt that begins `moved` [m] from the last, and slides so far [m]; None: a peck."""
        travel = moved / self.travel_speed
        if slid is None:
            return travel + (self.seated if seated else self.blocked)
        return travel + slid / self.slide_speed + (self.slide_seated if seated else self.slide_blocked)


@dataclass(frozen=True)
class Capture:
    """What a slide catches, and where a part sits in its hole: as `palpate experiment calibrate` finds.

    A part sits where it was tried, not in the middle: its pins have play, and a peck does not give way across.
    """

    swath: float = 0.85  # of the feasible area, about its centre: passed over by a slide, the pins drop in
    peck_kept: float = 0.93  # of the distance of a peck from the hole's centre that the seated part keeps
    peck_noise: float = 0.008e-3  # [m] per axis about that
    slide_kept: float = 0.58  # the same, of where a slide caught the hole
    slide_noise: float = 0.048e-3  # [m]
    step: float = 0.02e-3  # [m] along a path between the points that are looked at


def along(path: Sequence[Point], step: float) -> Iterator[tuple[float, Point]]:
    """Points along a path, at most `step` [m] apart, each after so much of it [m]; its first point is left out."""
    travelled = 0.0
    for (ax, ay), (bx, by) in pairwise(path):
        length = math.dist((ax, ay), (bx, by))
        count = max(1, math.ceil(length / step))
        for index in range(1, count + 1):
            share = index / count
            yield travelled + share * length, (ax + share * (bx - ax), ay + share * (by - ay))
        travelled += length


class Gaps(Protocol):
    """Where the holes are."""

    def gap(self, search_number: int, board_number: int, hole_name: str) -> Gap:
        """What one part meets at one hole."""
        ...


class StatisticalBench:
    """Parts are tried in holes by geometry alone: in the cell's simulated world, unless `gaps` say where holes are."""

    def __init__(
        self,
        cell: Cell,
        timing: Timing | None = None,
        capture: Capture | None = None,
        gaps: Gaps | None = None,
        seed: int | None = None,  # of how exactly parts sit; the cell's if there is none
    ) -> None:
        self._world = gaps or World(cell.board, component(cell.component), cell.tolerances, cell.seed)
        self._timing, self._capture = timing or Timing(), capture or Capture()
        self._noise = np.random.default_rng([cell.seed if seed is None else seed, 1])
        self._seconds = 0.0
        self._gap: Gap | None = None
        self._last: tuple[float, float] | None = None  # where the attempt before ended, in this search

    @property
    def time(self) -> int:
        """Session time [ns]."""
        return round(self._seconds * NANOSECONDS)

    @property
    def offset(self) -> tuple[float, float]:
        """Where the TCP must go relative to nominal [m] for the part in hand."""
        assert self._gap is not None
        return float(self._gap.x), float(self._gap.y)

    def begin(self, search: int, board: int, hole: str) -> None:
        """Put board and hole in place and a part into the gripper."""
        self._gap = self._world.gap(search, board, hole)
        self._last = None

    def attempt(self, goal: SearchGoal, candidate: Candidate) -> Attempt:
        """Try a candidate."""
        assert self._gap is not None
        proposal, timing = candidate.proposal, self._timing
        path = [(proposal.x, proposal.y), *((point.x, point.y) for point in proposal.path)]
        moved = math.dist(path[0], self._last) if self._last else 0.0
        seated, slid = self._gap.feasible(*path[0]), None
        x, y = path[0]
        if not seated and proposal.path:
            seated, slid, (x, y) = self._slide(path)
        duration = timing.attempt(moved=moved, seated=seated, slid=slid)
        self._seconds += duration
        self._last = (x, y)
        nominal = goal.nominal.position
        at = self._seat(x, y, slid is not None) if seated else (x, y)
        zero = Vector3(x=0.0, y=0.0, z=0.0)
        position = type(nominal)(x=nominal.x + at[0], y=nominal.y + at[1], z=nominal.z)
        return Attempt(
            header=header(self.time),
            search=goal.search,
            number=candidate.number,
            board=goal.board,
            hole=goal.hole,
            x=x,
            y=y,
            outcome=Outcome.SEATED if seated else Outcome.BLOCKED,
            reason="",
            pose=Pose(position=position, orientation=goal.nominal.orientation),
            wrench=Wrench(force=zero, torque=zero),
            depth=0.0,
            peak_force=0.0,
            duration=duration,
            path=[Waypoint(*point) for point in path] if proposal.path else [],
        )

    def _seat(self, x: float, y: float, slide: bool) -> tuple[float, float]:
        """Where [m] a part sits that went in at (x, y)."""
        assert self._gap is not None
        gap, capture = self._gap, self._capture
        kept, sd = (capture.slide_kept, capture.slide_noise) if slide else (capture.peck_kept, capture.peck_noise)
        noise = sd * self._noise.standard_normal(2)
        return float(gap.x + kept * (x - gap.x) + noise[0]), float(gap.y + kept * (y - gap.y) + noise[1])

    def _slide(self, path: list[Point]) -> tuple[bool, float, Point]:
        """Whether the pins drop in along a path, after how much of it [m], and where [m]."""
        assert self._gap is not None
        travelled, at = 0.0, path[0]
        for travelled, at in along(path, self._capture.step):
            if self._gap.feasible(*at, self._capture.swath):
                return True, travelled, at
        return False, travelled, at

    def end(self, seated: bool) -> None:  # noqa: ARG002 - letting go takes as long as throwing away
        """Let go of the part."""
        self._seconds += self._timing.part
