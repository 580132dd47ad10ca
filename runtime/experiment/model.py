"""The statistical model of a cell: the same worlds and jobs as the full physics, without contact.

An attempt succeeds exactly where the geometry says that every pin's tip lies over its hole; how long it takes and how
exactly a seated part tells its place was measured in the full physics (`palpate experiment calibrate` compares).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

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


@dataclass(frozen=True)
class Timing:
    """How long things take [s], as measured in the full physics."""

    part: float = 8.6  # to fetch a part, bring it to the hole, let go and rise
    blocked: float = 0.45  # a peck that meets the board, with the way up
    seated: float = 0.89  # a peck that goes in
    travel_speed: float = 0.05  # [m/s] between the positions of successive attempts
    slide_blocked: float = 0.55  # a slide that meets no hole, beside the way slid
    slide_seated: float = 1.0  # a slide that does, beside the way slid
    slide_speed: float = 5e-3  # [m/s]


@dataclass(frozen=True)
class Capture:
    """What a slide catches, and what a seated part tells."""

    swath: float = 0.85  # of the feasible area, about its centre: passed over by a slide, the pins drop in
    seat_noise: float = 0.04e-3  # [m] per axis, of the seated position against the hole's centre
    step: float = 0.02e-3  # [m] along a path between the points that are looked at


class StatisticalBench:
    """Parts are tried in holes by geometry alone."""

    def __init__(self, cell: Cell, timing: Timing | None = None, capture: Capture | None = None) -> None:
        self._world = World(cell.board, component(cell.component), cell.tolerances, cell.seed)
        self._timing, self._capture = timing or Timing(), capture or Capture()
        self._noise = np.random.default_rng([cell.seed, 1])
        self._seconds = 0.0
        self._gap: Gap | None = None
        self._last = (0.0, 0.0)

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
        self._last = (0.0, 0.0)

    def attempt(self, goal: SearchGoal, candidate: Candidate) -> Attempt:
        """Try a candidate."""
        assert self._gap is not None
        proposal, timing = candidate.proposal, self._timing
        path = [(proposal.x, proposal.y), *((point.x, point.y) for point in proposal.path)]
        duration = math.dist(path[0], self._last) / timing.travel_speed
        seated, travelled = self._gap.feasible(*path[0]), 0.0
        x, y = path[0]
        if not seated and proposal.path:
            seated, travelled, (x, y) = self._slide(path)
            duration += timing.slide_seated if seated else timing.slide_blocked
            duration += travelled / timing.slide_speed
        else:
            duration += timing.seated if seated else timing.blocked
        self._seconds += duration
        self._last = (x, y)
        nominal = goal.nominal.position
        noise = self._capture.seat_noise * self._noise.standard_normal(2) if seated else np.zeros(2)
        at = (self._gap.x + noise[0], self._gap.y + noise[1]) if seated else (x, y)
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

    def _slide(self, path: list[tuple[float, float]]) -> tuple[bool, float, tuple[float, float]]:
        """Whether the pins drop in along a path, after how much of it [m], and where [m]."""
        assert self._gap is not None
        gap, share = self._gap, self._capture.swath
        travelled = 0.0
        for begin, end in pairwise(path):
            length = math.dist(begin, end)
            for index in range(1, max(1, math.ceil(length / self._capture.step)) + 1):
                part = index / max(1, math.ceil(length / self._capture.step))
                x, y = (a + part * (b - a) for a, b in zip(begin, end, strict=True))
                if gap.feasible(gap.x + (x - gap.x) / share, gap.y + (y - gap.y) / share):
                    return True, travelled + part * length, (x, y)
            travelled += length
        return False, travelled, path[-1]

    def end(self, seated: bool) -> None:  # noqa: ARG002 - letting go takes as long as throwing away
        """Let go of the part."""
        self._seconds += self._timing.part
