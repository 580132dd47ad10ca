"""A whole job without bus, log or other plugins: the same physics, controller, skill and strategy in one plain loop."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import mujoco

from drivers.ur3e.job import attempt_message
from drivers.ur3e.setup import Setup
from runtime.assembly import goal_for
from runtime.belief import belief_about
from runtime.clock import Stopwatch
from runtime.config import Cell, redacted_cell, strategy_of
from runtime.messages import NANOSECONDS, Attempt, Belief, Outcome, Seat, header
from runtime.plugin import BareRun
from runtime.strategy_host import SearchSession


@dataclass
class _TimedPhysics:
    """MuJoCo's step with a stopwatch around it."""

    seconds: float = 0.0
    watch: Stopwatch = field(default_factory=Stopwatch)

    def __call__(self, model: Any, data: Any, steps: int) -> None:
        begun = self.watch.seconds
        mujoco.mj_step(model, data, steps)
        self.seconds += self.watch.seconds - begun


def bare_run(setup: Setup, cell: Cell) -> BareRun:
    """Work through the cell's boards from an empty store; tells how long it took and what of it was physics."""
    physics = _TimedPhysics()
    world, skill = setup.build(cell, integrate=physics)
    arm = world.arm
    decide = redacted_cell(cell, "assembly")
    session = SearchSession(strategy_of(cell, "cell"))
    seats: list[Seat] = []
    attempts = inserted = search = 0
    watch = Stopwatch()
    for board in range(1, cell.boards + 1):
        for hole in cell.board.holes:
            search += 1
            distribution, count = belief_about(hole.name, seats, cell.search.prior_width, session="bare", board=board)
            belief = Belief(header(arm.time), cell.board.type, hole.name, count, distribution, list(seats))
            goal = goal_for(decide, hole, belief, board, search, arm.time)
            world.begin_search(search, board, hole.name)
            if world.board_changed:
                skill.home()
            skill.pick()
            candidate = session.begin(goal)
            attempt: Attempt | None = None
            while not candidate.exhausted:
                peck = skill.peck(hole, candidate.proposal.x, candidate.proposal.y)
                attempt = attempt_message(goal, candidate, peck, arm.time)
                attempts += 1
                following = session.observe(attempt)
                if following is None:
                    break
                candidate = following
            if attempt is not None and attempt.outcome == Outcome.SEATED:
                skill.release()
                inserted += 1
                where, nominal = attempt.pose.position, goal.nominal.position
                x, y = where.x - nominal.x, where.y - nominal.y
                seats.append(Seat("bare", board, hole.name, attempt.x, attempt.y, x, y))
            else:
                skill.discard()
    return BareRun(arm.time / NANOSECONDS, watch.seconds, physics.seconds, attempts, inserted)
