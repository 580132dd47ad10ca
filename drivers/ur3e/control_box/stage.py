"""The simulated cell around a simulated controller: which part the feeder presents, where the holes of the board are.

A client that works through a job says what comes next in general purpose integer registers, as it would tell a feeder
and a conveyor: 18 the number of the search, 19 that of the board, 20 the hole's place on the board, from 1. The answer
is the number of the search in output integer register 19, once part and board are there. A 0 in 18 takes question and
answer back; the next board is a fresh one, whatever its number. The part and the hole are the very ones that the cell
would meet in one process with the same seed.

A client that says nothing finds a part in the feeder whenever the gripper is empty, on one board that is never changed,
whose holes are where they are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from drivers.ur3e.control_box.box import ControlBox
from drivers.ur3e.parameters import CYCLE
from drivers.ur3e.simulated_cell import SimulatedCell

SEARCH, BOARD, HOLE = 18, 19, 20  # input integer registers
READY = 19  # output integer register: the last that ur-rtde's clients can read
_REFILL = 0.5  # [s] assumed: the feeder's next part comes this long after the last one is gone
_FAR = 2e-3  # [m] the nearest hole changes only when the tool has moved this far


@dataclass
class Stage:
    """Sets up the cell before each control cycle."""

    cell: SimulatedCell
    _asked: int = 0  # search that a client asked for last
    _served: int = 0
    _empty: float = 0.0  # [s] since the gripper and the feeder are empty
    _at: tuple[float, float] | None = None  # [m] where the tool was when the nearest hole was last looked for
    _hole: str = ""

    def __call__(self, box: ControlBox) -> None:
        """A control cycle begins."""
        search = box.registers.input_int[SEARCH]
        if search != self._asked:
            self._asked = search
            self._answer(box, search)
        if self._asked <= 0:
            self._serve_by_itself()

    def _answer(self, box: ControlBox, search: int) -> None:
        registers = box.registers
        holes = self.cell.scene.board.holes
        board, number = registers.input_int[BOARD], registers.input_int[HOLE]
        if search <= 0:
            registers.output_int[READY] = 0
            self.cell.truth = None
            return
        if board < 1 or not 1 <= number <= len(holes):
            box.log(
                f"cell: search {search} asks for board {board}, hole {number}; "
                f"boards count from 1, holes from 1 to {len(holes)}"
            )
            return
        self.cell.begin_search(search, board, holes[number - 1].name)
        registers.output_int[READY] = search
        box.log(f"cell: board {board}, part for hole {holes[number - 1].name} in the feeder")

    def _serve_by_itself(self) -> None:
        cell = self.cell
        (x, y, _), _ = cell.arm.pose
        if self._at is None or math.dist(self._at, (x, y)) > _FAR:
            self._at = (x, y)
            hole = self._nearest(x, y)
            if hole != self._hole:
                self._hole = hole
                cell.reveal_hole(1, hole)
        if cell.arm.holding or cell.scene.part_waiting:
            self._empty = 0.0
            return
        self._empty += CYCLE
        if self._empty >= _REFILL or self._served == 0:
            self._served += 1
            cell.present_part(self._served, self._hole)

    def _nearest(self, x: float, y: float) -> str:
        board = self.cell.scene.board
        return min(board.holes, key=lambda hole: math.dist((board.x + hole.x, board.y + hole.y), (x, y))).name
