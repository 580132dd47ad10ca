"""A simulated cell, and the skill to work in it, as a cell file describes them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from drivers.ur3e.arm import Arm
from drivers.ur3e.mishap import Mishap
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
    mishaps: tuple[Mishap, ...] = ()  # in sessions

    def simulate(
        self,
        cell: Cell,
        *,
        gate: Callable[[int], bool] | None = None,
        observe: Callable[[SimulatedArm], None] | None = None,
        integrate: Callable[[Any, Any, int], None] | None = None,
    ) -> SimulatedCell:
        """The simulation of a cell; the hooks are those of `SimulatedArm` and `Scene`."""
        return SimulatedCell(
            cell.board,
            component(cell.component),
            cell.tolerances,
            cell.seed,
            workcell=self.workcell,
            fidelity=self.fidelity,
            gate=gate,
            observe=observe,
            integrate=integrate,
        )

    def build(
        self,
        cell: Cell,
        *,
        gate: Callable[[int], bool] | None = None,
        observe: Callable[[SimulatedArm], None] | None = None,
        integrate: Callable[[Any, Any, int], None] | None = None,
    ) -> tuple[SimulatedCell, InsertionSkill]:
        """The simulation of a cell, and the skill on its arm."""
        simulated = self.simulate(cell, gate=gate, observe=observe, integrate=integrate)
        return simulated, self.skilled(simulated.arm, cell)

    def skilled(self, arm: Arm, cell: Cell) -> InsertionSkill:
        """The skill to work in a cell on an arm, simulated or real."""
        return InsertionSkill(arm, self.workcell, cell.board, component(cell.component), self.skill)
