"""A simulated control box with the cell it stands in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from drivers.ur3e.control_box.box import ControlBox
from drivers.ur3e.control_box.stage import Stage
from drivers.ur3e.control_box.version import PolyScope
from drivers.ur3e.setup import Setup
from runtime.config import Cell

_AWAY = -1.0  # [m] height of a board that nothing can reach


def simulated_box(
    setup: Setup,
    cell: Cell,
    *,
    version: PolyScope = PolyScope(),  # noqa: B008 - frozen
    empty: bool = False,
    log: Callable[[str], None] = lambda _line: None,
    programs_folder: Path | None = None,
) -> ControlBox:
    """The box and its cell; an empty one has an arm with a gripper, and neither board nor parts."""
    if empty:
        cell = replace(cell, board=replace(cell.board, z=_AWAY))
    simulated = setup.simulate(cell)
    return ControlBox(
        simulated.arm,
        version=version,
        log=log,
        programs_folder=programs_folder,
        seed=cell.seed,
        **({} if empty else {"stage": Stage(simulated)}),
    )
