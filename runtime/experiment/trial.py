"""One trial: one strategy works through the boards of one world with one seed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from runtime import config, registry
from runtime.config import Cell
from runtime.errors import InputError
from runtime.experiment.contenders import Contender
from runtime.experiment.model import StatisticalBench
from runtime.experiment.study import Choices
from runtime.experiment.worlds import NamedWorld
from runtime.plain_job import PlainJob
from runtime.plugin import SearchRecord


@dataclass(frozen=True)
class Trial:
    """What to do. Two equal trials have equal results on any machine."""

    world: NamedWorld
    component: str
    contender: Contender
    seed: int
    boards: int = 10
    physics: bool = False  # in the full physics, instead of the statistical model of it

    @property
    def cell(self) -> Cell:
        """The job to do."""
        return self.world.cell(self.component, seed=self.seed, boards=self.boards)

    @property
    def content(self) -> Mapping[str, Any]:
        """All that the result depends on, beside the code: names and descriptions are not among it."""
        contender = self.contender
        return {
            "cell": self.cell,
            "strategy": contender.strategy,
            "settings": dict(sorted(contender.settings.items())),
            "prior": contender.prior,
            "physics": self.physics,
        }

    @property
    def code(self) -> tuple[str, ...]:
        """The modules of the job, of the strategy, and of the physics if it runs in it."""
        strategy = registry.load(registry.STRATEGIES, self.contender.strategy).__module__
        robot = registry.load(registry.DRIVERS, self.cell.robot).__module__
        return ("runtime.plain_job", strategy, robot if self.physics else StatisticalBench.__module__)

    def run(self) -> tuple[SearchRecord, ...]:
        """One record for each search, in order."""
        cell, strategy, prior = self.cell, self.contender.make(), self.contender.prior
        if not self.physics:
            return tuple(PlainJob(cell, strategy, StatisticalBench(cell), prior).searches())
        robot = config.robot_of(cell, self.world.name)
        bare_run = getattr(robot, "bare_run", None)
        if bare_run is None:
            raise InputError(f"{cell.robot} is not simulated; there is no physics to try {self.contender.name} in")
        searches: tuple[SearchRecord, ...] = bare_run(cell, strategy, prior=prior).searches
        return searches


def trials(chosen: Choices, world: NamedWorld, component: str, contender: Contender) -> list[Trial]:
    """One trial for each of the seeds chosen."""
    physics = bool(chosen.physics)
    return [Trial(world, component, contender, seed, chosen.boards, physics) for seed in chosen.seed_numbers]
