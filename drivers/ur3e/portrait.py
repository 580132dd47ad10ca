"""A cell at work, drawn: some parts inserted, one on its way."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from drivers.ur3e.simulated_cell import SimulatedCell
from drivers.ur3e.skill import InsertionSkill
from runtime.component import component
from runtime.config import Cell
from runtime.errors import InputError

if TYPE_CHECKING:
    from drivers.ur3e.driver import MujocoUr3e


def portrait(settings: MujocoUr3e, cell: Cell, path: Path) -> None:
    """Insert half of a board where its holes really are, hold the next part above its hole, and write a PNG.

    Raises InputError where this machine has nothing to draw with.
    """
    part = component(cell.component)
    world = SimulatedCell(
        cell.board, part, cell.tolerances, cell.seed, workcell=settings.workcell, fidelity=settings.fidelity
    )
    skill = InsertionSkill(world.arm, settings.workcell, cell.board, part, settings.skill)
    holes = cell.board.holes
    half = len(holes) // 2
    for search, hole in enumerate(holes[: half + 1], start=1):
        truth = world.begin_search(search, 1, hole.name)
        skill.pick()
        if search <= half:
            skill.peck(hole, *truth.offset)
            skill.release()
        else:
            skill.peck(hole, cell.search.radius, 0.0)
    try:
        world.render(path)
    except (ImportError, AttributeError, RuntimeError) as error:
        raise InputError(f"this machine has no EGL to draw with (Debian: libegl1, libegl-mesa0): {error}") from None
