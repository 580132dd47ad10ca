"""A simulated cell, and the skill to work in it, as a cell file describes them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from drivers.ur3e.scene import Fidelity
from drivers.ur3e.simulated_arm import SimulatedArm
from drivers.ur3e.simulated_cell import SimulatedCell
from drivers.ur3e.skill import InsertionSkill, SkillSettings
from drivers.ur3e.workcell import Workcell
from runtime.component import component
from runtime.config import Cell


@dataclass(frozen=True)
class Setup:
    """What a driver's settings say of the simulation."""

    fidelity: Fidelity
    workcell: Workcell
    skill: SkillSettings

    def build(
        self,
        cell: Cell,
        *,
        gate: Callable[[int], bool] | None = None,
        observe: Callable[[SimulatedArm], None] | None = None,
        integrate: Callable[[Any, Any, int], None] | None = None,
    ) -> tuple[SimulatedCell, InsertionSkill]:
        """The simulation of a cell, and the skill on its arm; the hooks are those of `SimulatedArm` and `Scene`."""
        part = component(cell.component)
        simulated = SimulatedCell(
            cell.board,
            part,
            cell.tolerances,
            cell.seed,
            workcell=self.workcell,
            fidelity=self.fidelity,
            gate=gate,
            observe=observe,
            integrate=integrate,
        )
        return simulated, InsertionSkill(simulated.arm, self.workcell, cell.board, part, self.skill)
