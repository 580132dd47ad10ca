"""A whole job without bus, log or other plugins: the same physics, controller, skill and strategy in one plain loop."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import mujoco

from drivers.ur3e.search_service import attempt_message, touch
from drivers.ur3e.setup import Setup
from drivers.ur3e.simulated_cell import SimulatedCell
from drivers.ur3e.skill import InsertionSkill
from runtime.clock import Stopwatch
from runtime.config import Cell, strategy_of
from runtime.messages import NANOSECONDS, Attempt, Candidate, SearchGoal
from runtime.plain_job import PlainJob
from runtime.plugin import BareRun, Strategy


@dataclass
class _TimedPhysics:
    """MuJoCo's step with a stopwatch around it."""

    seconds: float = 0.0
    watch: Stopwatch = field(default_factory=Stopwatch)

    def __call__(self, model: Any, data: Any, steps: int) -> None:
        begun = self.watch.seconds
        mujoco.mj_step(model, data, steps)
        self.seconds += self.watch.seconds - begun


@dataclass(frozen=True)
class PhysicsBench:
    """Parts are tried in holes by the arm of a simulated cell."""

    cell: Cell
    world: SimulatedCell
    skill: InsertionSkill

    @property
    def time(self) -> int:
        """Session time [ns]."""
        return self.world.arm.time

    @property
    def offset(self) -> tuple[float, float]:
        """Where the TCP must go relative to nominal [m] for the part in hand."""
        assert self.world.truth is not None
        x, y = self.world.truth.offset
        return float(x), float(y)

    def begin(self, search: int, board: int, hole: str) -> None:
        """Put board and hole in place and fetch a part."""
        self.world.begin_search(search, board, hole)
        if self.world.board_changed:
            self.skill.home()
        self.skill.pick()

    def attempt(self, goal: SearchGoal, candidate: Candidate) -> Attempt:
        """Try a candidate."""
        felt = touch(self.skill, self.cell.board.hole(goal.hole), candidate.proposal)
        return attempt_message(goal, candidate, felt, self.time)

    def end(self, seated: bool) -> None:
        """Let go of the part where it is seated, or over the reject bin."""
        if seated:
            self.skill.release()
        else:
            self.skill.discard()


def bare_run(setup: Setup, cell: Cell, strategy: Strategy | None = None, *, prior: bool = True) -> BareRun:
    """Work through the cell's boards from an empty store; tells how long it took and what of it was physics.

    `strategy` stands in for the cell's own; without `prior` goals carry no belief.
    """
    physics = _TimedPhysics()
    world, skill = setup.build(cell, integrate=physics)
    watch = Stopwatch()
    job = PlainJob(cell, strategy or strategy_of(cell, "cell"), PhysicsBench(cell, world, skill), prior)
    searches = tuple(job.searches())
    return BareRun(world.arm.time / NANOSECONDS, watch.seconds, physics.seconds, searches, tuple(job.attempts))
