"""The simulated UR3e as a plugin: goals and candidates in, attempts out, under the interlock's permit."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from drivers.ur3e.mishap import Mishap
from drivers.ur3e.skill import SkillSettings
from drivers.ur3e.workcell import Workcell
from runtime.config import Cell
from runtime.context import Context
from runtime.errors import CellError
from runtime.plugin import BareRun, Punctuality, Strategy

if TYPE_CHECKING:
    from drivers.ur3e.setup import Setup


@dataclass(frozen=True)
class MujocoUr3e:
    """UR3e with gripper, feeder and boards, simulated in MuJoCo with contact; faster than real time."""

    fidelity: Literal["reference", "fast"] = "reference"  # reference: 1 ms steps; fast: 2 ms, contact 10 um less exact
    workcell: Workcell = field(default_factory=Workcell)
    skill: SkillSettings = field(default_factory=SkillSettings)
    mishaps: tuple[Mishap, ...] = ()  # what goes wrong on purpose

    simulated: ClassVar[bool] = True
    controller: ClassVar[str] = "drivers.ur3e.control_box.process"  # serves the arm on a UR controller's ports

    def check(self, cell: Cell, where: str) -> None:
        """Raise CellError if the arm cannot reach a hole, the feeder or the reject bin."""
        from drivers.ur3e.reach import unreachable

        beyond = unreachable(cell, self.workcell)
        if beyond:
            raise CellError(f"{where}: {beyond}")

    def bare_run(self, cell: Cell, strategy: Strategy | None = None, *, prior: bool = True) -> BareRun:
        """The cell's job without bus, log and other plugins: for experiments, and to measure what those cost.

        `strategy` stands in for the cell's own; without `prior` goals carry no belief.
        """
        from drivers.ur3e.bare_run import bare_run

        return bare_run(self.setup(), cell, strategy, prior=prior)

    def punctuality(self, where: str, document: dict[str, Any], seconds: float) -> Punctuality:
        """How well the controller keeps its time on UR's ports of this machine's loopback."""
        from drivers.ur3e.control_box.bench import punctuality

        order = {
            "document": document,
            "where": where,
            "polyscope": "5.22",
            "empty": False,
            "programs": "",
            "bus_port": 0,
        }
        return punctuality(self.controller, order, seconds)

    def picture(self, cell: Cell, path: Path) -> None:
        """Write a PNG of the cell with a part in the gripper. Raises InputError where nothing can be drawn."""
        from drivers.ur3e.portrait import portrait

        portrait(self.setup(), cell, path)

    def run(self, context: Context) -> None:
        """Serve searches until the cell closes; the arm is halted when this returns."""
        from drivers.ur3e.job import Job

        Job(self.setup(), context).run()

    def setup(self) -> Setup:
        """The simulation and the skill as the settings describe them."""
        from drivers.ur3e.setup import Setup

        return Setup(self.fidelity, self.workcell, self.skill, self.mishaps)
