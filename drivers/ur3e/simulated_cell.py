"""The simulated cell as a whole: scene, truth and arm, search after search."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.ur3e.force_torque import ForceTorqueNoise
from drivers.ur3e.frames import tool_down, unrotate
from drivers.ur3e.scene import Fidelity, Scene
from drivers.ur3e.simulated_arm import SimulatedArm
from drivers.ur3e.workcell import Workcell
from runtime.cell import Board, Tolerances
from runtime.component import Component
from runtime.errors import InputError
from runtime.world import HoleTruth, PartTruth, World


@dataclass(frozen=True)
class SearchTruth:
    """What a search is really about: for the record, hidden from everything that decides. Frame: base_link."""

    search: int
    board: int
    hole: str
    hole_truth: HoleTruth
    part_truth: PartTruth
    offset: tuple[float, float]  # [m] where the TCP must go relative to nominal: hole minus pins


class SimulatedCell:
    """One cell with its world. `arm` is the arm in it; `truth` belongs to the search begun last."""

    def __init__(
        self,
        board: Board,
        component: Component,
        tolerances: Tolerances,
        seed: int = 0,
        *,
        workcell: Workcell | None = None,
        fidelity: Fidelity = "reference",
        noise: ForceTorqueNoise | None = ForceTorqueNoise(),  # noqa: B008 - frozen
        session: int = 0,
        integrate: Callable[[Any, Any, int], None] | None = None,
        gate: Callable[[int], bool] | None = None,
        observe: Callable[[SimulatedArm], None] | None = None,
    ) -> None:
        self.scene = Scene(board, component, workcell, fidelity, integrate)
        self.world = World(board, component, tolerances, seed, session)
        self.arm = SimulatedArm(self.scene, seed, noise=noise, gate=gate, observe=observe)
        self.truth: SearchTruth | None = None
        self.board_changed = False  # whether the search begun last is the first on a fresh board

    def begin_search(self, search_number: int, board_number: int, hole_name: str) -> SearchTruth:
        """Put the hole where it really is and the next part into the feeder; a new board number means a fresh board.

        Raises InputError for a hole that the board has not.
        """
        board, world = self.scene.board, self.world
        if hole_name not in {hole.name for hole in board.holes}:
            raise InputError(
                f"no hole {hole_name!r} on board {board.type!r}; known: {[hole.name for hole in board.holes]}"
            )
        self.board_changed = self.truth is None or self.truth.board != board_number
        if self.board_changed:
            self.scene.clear_board()
        hole, part = self.reveal_hole(board_number, hole_name), self.present_part(search_number, hole_name)
        offset = world.offset(search_number, board_number, hole_name)
        self.truth = SearchTruth(search_number, board_number, hole_name, hole, part, offset)
        return self.truth

    def reveal_hole(self, board_number: int, hole_name: str) -> HoleTruth:
        """Let the holes that can be touched be those of one place on a board, where they really are."""
        board = self.scene.board
        nominal, hole = board.hole(hole_name), self.world.hole(board_number, hole_name)
        yaw = (nominal.orientation or 0.0) + hole.yaw
        self.scene.place_holes(board.x + nominal.x + hole.x, board.y + nominal.y + hole.y, yaw, hole.wider)
        return hole

    def present_part(self, search_number: int, hole_name: str) -> PartTruth:
        """Put the part of one search into the feeder.

        Its offset over the hole, base_link, is one in the TCP's frame, whose z points down.
        """
        part = self.world.part(search_number, hole_name)
        turn = tool_down(self.scene.board.hole(hole_name).orientation or 0.0)
        x, y, _ = unrotate(turn, (part.x, part.y, 0.0))
        self.scene.present_part(True, x, y, -part.yaw)
        return part

    def render(self, path: Path, width: int = 1200, height: int = 900, camera: str = "iso") -> None:
        """Write a PNG of the cell as it is now; cameras are `iso` and `board`. Works without a screen through EGL."""
        from drivers.ur3e.picture import write_picture

        write_picture(self.scene, path, camera, width, height)
