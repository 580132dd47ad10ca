"""What the simulated world is really like: where boards, holes and pins are, drawn from the cell's tolerances.

Every draw has a key of its own (seed, what, which), so the order in which things are asked for does not matter, and a
second session with the same seed meets the same holes again. Frame: base_link.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from runtime.cell import Board, Tolerances
from runtime.component import Component


@dataclass(frozen=True)
class Placement:
    """How one board lies in its carrier: shift of its centre and turn about it."""

    x: float  # [m]
    y: float  # [m]
    yaw: float  # [rad]


@dataclass(frozen=True)
class HoleTruth:
    """Where a hole pattern is: offset from nominal."""

    x: float  # [m]
    y: float  # [m]
    yaw: float  # [rad]


@dataclass(frozen=True)
class PartTruth:
    """Where a held part's pins are: offset from the TCP, in base_link while the part is over its hole."""

    x: float  # [m]
    y: float  # [m]
    yaw: float  # [rad] about base_link's z


class World:
    """The truth of one seed. Boards and parts differ from one `session` to another, the holes' bias does not."""

    def __init__(self, board: Board, component: Component, tolerances: Tolerances, seed: int, session: int = 0) -> None:
        self.board = board
        self.component = component
        self.tolerances = tolerances
        self._seed = seed
        self._session = session

    def placement(self, board_number: int) -> Placement:
        """How board `board_number` of the session lies in its carrier."""
        draw = self._normal("placement", self._session, board_number)
        tolerances = self.tolerances
        shift = tolerances.board_shift
        return Placement(shift * draw[0], shift * draw[1], tolerances.board_rotation * draw[2])

    def bias(self, hole_name: str) -> tuple[float, float]:
        """Offset [m] of a hole on every board of this type, before the board is shifted and turned."""
        draw = self._normal("bias", self.board.type, hole_name)
        return self.tolerances.hole_bias * draw[0], self.tolerances.hole_bias * draw[1]

    def hole(self, board_number: int, hole_name: str) -> HoleTruth:
        """Where a hole of one board really is."""
        nominal = self.board.hole(hole_name)
        placement = self.placement(board_number)
        bias = self.bias(hole_name)
        x, y = nominal.x + bias[0], nominal.y + bias[1]
        cosine, sine = math.cos(placement.yaw), math.sin(placement.yaw)
        return HoleTruth(
            placement.x + cosine * x - sine * y - nominal.x,
            placement.y + sine * x + cosine * y - nominal.y,
            placement.yaw,
        )

    def part(self, search_number: int, hole_name: str) -> PartTruth:
        """How the part of one search sits in the gripper."""
        tolerances = self.tolerances
        number = next(i for i, hole in enumerate(self.board.holes, 1) if hole.name == hole_name)
        factor = tolerances.abnormal_factor if number == tolerances.abnormal_hole else 1.0
        draw = self._normal("part", self._session, search_number, hole_name)
        scatter = tolerances.part_scatter * factor
        return PartTruth(scatter * draw[0], scatter * draw[1], tolerances.part_rotation * draw[2])

    def offset(self, search_number: int, board_number: int, hole_name: str) -> tuple[float, float]:
        """Where the TCP must go relative to nominal [m] for the part to sit centred: hole minus pins."""
        hole, part = self.hole(board_number, hole_name), self.part(search_number, hole_name)
        return hole.x - part.x, hole.y - part.y

    def _normal(self, *key: str | int) -> NDArray[np.float64]:
        """Three standard normal numbers that belong to this key."""
        digest = hashlib.blake2b(repr((self._seed, *key)).encode(), digest_size=16).digest()
        return np.random.default_rng(int.from_bytes(digest, "big")).standard_normal(3)
