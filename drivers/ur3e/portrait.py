"""A cell at work, drawn: some parts inserted, one on its way."""

from __future__ import annotations

from pathlib import Path

from drivers.ur3e.setup import Setup
from runtime.config import Cell
from runtime.errors import InputError


def portrait(setup: Setup, cell: Cell, path: Path) -> None:
    """Insert half of a board where its holes really are, hold the next part above its hole, and write a PNG.

    Raises InputError where this machine has nothing to draw with.
    """
    world, skill = setup.build(cell)
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
