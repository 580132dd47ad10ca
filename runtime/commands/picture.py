"""palpate picture: draw a cell as the simulation has it."""

from __future__ import annotations

import argparse
from pathlib import Path

from runtime import config
from runtime.errors import InputError


def picture_command(arguments: argparse.Namespace) -> int:
    """Write a PNG."""
    cell_file = config.load(arguments.cell)
    cell = cell_file.cell
    draw = getattr(config.robot_of(cell, cell_file.name), "picture", None)
    if draw is None:
        raise InputError(f"{cell_file.name}: {cell.robot} is not simulated; there is nothing to draw")
    path = Path(arguments.output)
    if not path.parent.is_dir():
        raise InputError(f"{path.parent} is no folder; choose another with --output")
    draw(cell, path)
    print(path)  # noqa: T201
    return 0
