"""A small world without contact physics or parts: where holes are is drawn, an attempt succeeds near enough."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from runtime.belief import belief_about
from runtime.messages import (
    Attempt,
    Gaussian,
    Outcome,
    Point,
    Pose,
    Quaternion,
    SearchGoal,
    Seat,
    Vector3,
    Wrench,
    header,
)
from runtime.plugin import Strategy

ABNORMAL = 7  # number of the hole, from 1, whose parts scatter more


@dataclass(frozen=True)
class World:
    """Standard deviations per axis of what the drawing does not say; lengths [m]."""

    common: float = 0.5e-3  # length of the error that all offsets share
    board_shift: float = 0.1e-3
    board_rotation: float = 1e-3  # [rad]
    hole_bias: float = 0.3e-3
    part_scatter: float = 0.15e-3
    abnormal_factor: float = 3.0
    feasible_radius: float = 0.25e-3
    radius_variation: float = 0.1
    boards: int = 10
    holes: int = 9
    pitch: float = 30e-3
    seat_noise: float = 0.04e-3  # of the seated position as the robot reads it
    search_radius: float = 2e-3
    max_attempts: int = 150
    prior_width: float = 0.5e-3


WORLDS = {
    "S": World(),  # a located board
    "R": World(board_shift=0.5e-3, board_rotation=4e-3),  # a board that lies loosely on its carrier
    "cell": World(  # the tolerances that cell files begin with
        common=0.0, board_shift=0.1e-3, hole_bias=0.2e-3, part_scatter=0.05e-3, feasible_radius=0.2e-3
    ),
}


@dataclass(frozen=True)
class Insertion:
    """How one search in the world ended."""

    board: int  # from 0
    hole: int  # from 0
    attempts: int
    seated: bool


def goal_for(**changes: object) -> SearchGoal:
    """A goal in the middle of nowhere: 2 mm to search, 0.2 mm feasible, nothing learnt."""
    plain = SearchGoal(
        header=header(0),
        search=1,
        board=1,
        hole="h1",
        component="igbt",
        nominal=Pose(position=Point(x=0.3, y=0.0, z=0.05), orientation=Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)),
        feasible_radius=0.2e-3,
        search_radius=2e-3,
        max_attempts=150,
        seed=7,
        prior=Gaussian(0.0, 0.0, 0.25e-6, 0.0, 0.25e-6),
        seats=[],
    )
    return replace(plain, **changes)


def attempt_at(goal: SearchGoal, number: int, x: float, y: float, outcome: Outcome) -> Attempt:
    """What an arm would report."""
    zero = Vector3(x=0.0, y=0.0, z=0.0)
    return Attempt(
        header=header(0),
        search=goal.search,
        number=number,
        board=goal.board,
        hole=goal.hole,
        x=x,
        y=y,
        outcome=outcome,
        reason="",
        pose=goal.nominal,
        wrench=Wrench(force=zero, torque=zero),
        depth=0.0,
        peak_force=0.0,
        duration=0.5,
    )


def run_search(
    strategy: Strategy, goal: SearchGoal, offset: tuple[float, float], radius: float
) -> tuple[list[tuple[float, float]], bool]:
    """Positions tried for a hole at `offset` [m] in which a part goes within `radius` [m], and whether it went in.

    Of a slide the positions are its points, and it drops in wherever it passes near enough.
    """
    tried: list[tuple[float, float]] = []
    number = 0
    search = strategy.search(goal)
    try:
        proposal = next(search)
        while True:
            number += 1
            way = [(proposal.x, proposal.y), *((point.x, point.y) for point in proposal.path)]
            for begin, end in pairwise([way[0], *way]):
                steps = max(1, math.ceil(math.dist(begin, end) / (radius / 8)))
                for step in range(1, steps + 1):
                    at = tuple(a + step / steps * (b - a) for a, b in zip(begin, end, strict=True))
                    if math.dist(at, offset) < radius:
                        return [*tried, (at[0], at[1])], True
                tried.append(end)
            if number >= goal.max_attempts:
                return tried, False
            proposal = search.send(attempt_at(goal, number, proposal.x, proposal.y, Outcome.BLOCKED))
    except StopIteration:
        return tried, False
    finally:
        search.close()


@dataclass
class Line:
    """An assembly line: boards in a row, with what was learnt on the way."""

    world: World
    seed: int
    seats: list[Seat] = field(default_factory=list)

    def run(self, strategy: Strategy) -> list[Insertion]:
        w, draw = self.world, np.random.default_rng(self.seed)
        side = math.ceil(math.sqrt(w.holes))
        grid = np.array([(i // side, i % side) for i in range(w.holes)], dtype=float)
        grid = (grid - (side - 1) / 2) * w.pitch
        direction = draw.uniform(0, 2 * math.pi)
        common = w.common * np.array([math.cos(direction), math.sin(direction)])
        bias = w.hole_bias * draw.standard_normal((w.holes, 2))
        results = []
        for board in range(w.boards):
            shift = w.board_shift * draw.standard_normal(2)
            turn = w.board_rotation * draw.standard_normal()
            for hole in range(w.holes):
                factor = w.abnormal_factor if hole + 1 == ABNORMAL else 1.0
                scatter = factor * w.part_scatter * draw.standard_normal(2)
                lever = turn * np.array([-grid[hole, 1], grid[hole, 0]])
                offset = common + shift + lever + bias[hole] + scatter
                radius = w.feasible_radius * max(0.25, 1 + w.radius_variation * draw.standard_normal())
                read = offset + w.seat_noise * draw.standard_normal(2)
                name = f"h{hole + 1}"
                prior, _ = belief_about(name, self.seats, w.prior_width, session="now", board=board + 1)
                goal = goal_for(
                    search=board * w.holes + hole + 1,
                    board=board + 1,
                    hole=name,
                    feasible_radius=w.feasible_radius,
                    search_radius=w.search_radius,
                    max_attempts=w.max_attempts,
                    prior=prior,
                    seats=list(self.seats),
                )
                tried, seated = run_search(strategy, goal, (float(offset[0]), float(offset[1])), radius)
                if seated:
                    x, y = tried[-1]
                    self.seats.append(Seat("now", board + 1, name, x, y, float(read[0]), float(read[1])))
                results.append(Insertion(board, hole, len(tried), seated))
        return results
