"""Named worlds: how far boards, holes and parts stray from the drawing.

The matched worlds come from fitting the paper's Tables 1 and 2, which state none of it (`palpate experiment match`).
The realistic one is a bare board that lies loosely on its carrier, parts in a printed clamp, and a nominal position
taught half a millimetre off; every `off-` world departs from it in one way that a strategy's model does not know of.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from runtime.cell import Board, Hole, SearchLimits, Tolerances
from runtime.config import Cell
from runtime.errors import InputError, alternatives

MM = 1e-3
SEARCH = SearchLimits(radius=2.5 * MM, max_attempts=400, prior_width=0.5 * MM)
PITCH = 30e-3  # [m] of the 3 x 3 grid of holes

GRID = Board(
    type="grid-9",
    holes=tuple(
        Hole(str(3 * row + column + 1), PITCH * (column - 1), PITCH * (row - 1), 0.0)
        for row in range(3)
        for column in range(3)
    ),
)


@dataclass(frozen=True)
class NamedWorld:
    """Tolerances with a name and a reason."""

    name: str
    description: str
    tolerances: Tolerances
    search: SearchLimits = SEARCH

    def cell(self, component: str, *, seed: int, boards: int = 10) -> Cell:
        """The job of an experiment in this world."""
        return Cell(
            board=GRID, component=component, boards=boards, seed=seed, search=self.search, tolerances=self.tolerances
        )


REALISTIC = Tolerances(
    common_error=0.5 * MM,
    board_shift=0.5 * MM,
    board_rotation=4e-3,
    hole_bias=0.3 * MM,
    part_scatter=0.15 * MM,
    part_rotation=2e-3,
    abnormal_hole=7,
    abnormal_factor=3.0,
    hole_radius=0.025 * MM,
)

_WORLDS = (
    NamedWorld("realistic", "a board loose on its carrier, parts in a printed clamp, taught 0.5 mm off", REALISTIC),
    NamedWorld(
        "located",
        "the same, but boards located by pins: 0.1 mm and 1 mrad",
        replace(REALISTIC, board_shift=0.1 * MM, board_rotation=1e-3),
    ),
    NamedWorld(
        "paper-igbt",
        "matched to the paper's Table 1",
        Tolerances(
            common_error=0.867 * MM,
            board_shift=0.102 * MM,
            board_rotation=0.0,
            hole_bias=0.393 * MM,
            part_scatter=0.0569 * MM,
            part_rotation=0.0,
            abnormal_hole=7,
            abnormal_factor=3.0,
            hole_radius=0.025 * MM,
        ),
    ),
    NamedWorld(
        "paper-capacitor",
        "matched to the paper's Table 2",
        Tolerances(
            common_error=0.204 * MM,
            board_shift=0.0233 * MM,
            board_rotation=0.0,
            hole_bias=0.569 * MM,
            part_scatter=0.0995 * MM,
            part_rotation=0.0,
            abnormal_hole=7,
            abnormal_factor=3.0,
            hole_radius=0.025 * MM,
        ),
    ),
    NamedWorld("off-heavy-tails", "scatter with Student's t of 2.5 degrees", replace(REALISTIC, scatter_freedom=2.5)),
    NamedWorld("off-drift", "all places drift 0.1 mm a board", replace(REALISTIC, drift=0.1 * MM)),
    NamedWorld(
        "off-jump", "hole 4 moves 1 mm before board 6", replace(REALISTIC, jump=1 * MM, jump_hole=4, jump_board=6)
    ),
    NamedWorld("off-tight", "holes 0.07 mm tighter than drawn", replace(REALISTIC, hole_radius_error=-0.07 * MM)),
    NamedWorld(
        "off-wide", "holes 0.1 mm wider than drawn", replace(REALISTIC, hole_radius_error=0.1 * MM, hole_radius=0.0)
    ),
    NamedWorld("off-mean-1.2", "taught 1.2 mm off", replace(REALISTIC, common_error=1.2 * MM)),
    NamedWorld("off-mean-2.0", "taught 2 mm off", replace(REALISTIC, common_error=2.0 * MM)),
    NamedWorld("off-shift", "boards shift 1 mm", replace(REALISTIC, board_shift=1 * MM)),
    NamedWorld("off-scatter", "parts scatter twice as far", replace(REALISTIC, part_scatter=0.3 * MM)),
    NamedWorld("off-board", "another board type than was taught: 8 mm off", replace(REALISTIC, common_error=8 * MM)),
)
WORLDS = {world.name: world for world in _WORLDS}


def world(name: str) -> NamedWorld:
    """The world of that name. Raises InputError that names the ones there are."""
    try:
        return WORLDS[name]
    except KeyError:
        raise InputError(f"no world {name!r}; {alternatives(name, WORLDS)}") from None
