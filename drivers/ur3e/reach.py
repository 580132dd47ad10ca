"""Whether the arm gets everywhere the cell sends it."""

from __future__ import annotations

import numpy as np

from drivers.ur3e.frames import tool_down
from drivers.ur3e.kinematics import Kinematics
from drivers.ur3e.workcell import Workcell
from runtime.component import component
from runtime.config import Cell
from runtime.errors import ArmError


def unreachable(cell: Cell, workcell: Workcell) -> str:
    """The first place out of reach, in words; empty if there is none."""
    kinematics = Kinematics()
    kinematics.set_tcp([0.0, 0.0, workcell.gripper_reach + component(cell.component).grip, 0.0, 0.0, 0.0])
    near = np.array(workcell.home)
    board = cell.board
    depth = component(cell.component).depth
    places = [
        (
            f"board.holes: hole {hole.name!r}",
            board.x + hole.x,
            board.y + hole.y,
            board.z - depth,
            hole.orientation or 0.0,
        )
        for hole in board.holes
    ]
    places.append(("the feeder", workcell.feeder_x, workcell.feeder_y, workcell.feeder_z, 0.0))
    places.append(("the reject bin", workcell.reject_x, workcell.reject_y, workcell.reject_z, 0.0))
    travel = max(board.z, workcell.feeder_z, workcell.reject_z) + workcell.clearance_height
    for what, x, y, z, yaw in places:
        for height in (z, travel):
            try:
                kinematics.inverse((x, y, height), tool_down(yaw), near)
            except ArmError as error:
                return f"{what} is outside the UR3e's reach (500 mm about its base): {error}"
    return ""
