"""One trial: one strategy works through the boards of one world with one seed."""

from __future__ import annotations

from dataclasses import dataclass

from runtime import config
from runtime.experiment.contenders import Contender
from runtime.experiment.model import StatisticalBench
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


def run_trial(trial: Trial) -> tuple[SearchRecord, ...]:
    """One record for each search, in order."""
    cell = trial.world.cell(trial.component, seed=trial.seed, boards=trial.boards)
    strategy, prior = trial.contender.make(), trial.contender.prior
    if trial.physics:
        robot = config.robot_of(cell, trial.world.name)
        searches: tuple[SearchRecord, ...] = robot.bare_run(cell, strategy, prior=prior).searches  # type: ignore[attr-defined]
        return searches
    return tuple(PlainJob(cell, strategy, StatisticalBench(cell), prior).searches())
