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

from runtime.cell import HOLE_RADIUS_LIMIT, Board, Tolerances
from runtime.component import Component, feasible


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
    wider: float = 0.0  # [m] by which the plated holes' radius exceeds the drawing's


@dataclass(frozen=True)
class PartTruth:
    """Where a held part's pins are: offset from the TCP, in base_link while the part is over its hole."""

    x: float  # [m]
    y: float  # [m]
    yaw: float  # [rad] about base_link's z


@dataclass(frozen=True)
class Gap:
    """One part over one hole: at which offsets of the TCP from nominal the pins find their holes. Frame: base_link."""

    component: Component
    x: float  # [m] offset at which the pins are centred over the holes
    y: float  # [m]
    orientation: float  # [rad] of the hole pattern about base_link's z
    turned: float  # [rad] of the part against the hole pattern, in the component's frame
    wider: float  # [m] by which the plated holes' radius exceeds the drawing's

    def feasible(self, x: float, y: float, size: float = 1.0) -> bool:
        """Whether every pin's tip is over its hole with the TCP at (x, y) [m] from nominal.

        `size` other than 1 asks about the same area grown that many times about its centre.
        """
        cosine, sine = math.cos(self.orientation), math.sin(self.orientation)
        dx, dy = (x - self.x) / size, (y - self.y) / size
        return feasible(self.component, cosine * dx + sine * dy, sine * dx - cosine * dy, self.turned, self.wider)


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
        """Where a hole of one board really is, and how wide its plated holes are."""
        tolerances = self.tolerances
        nominal = self.board.hole(hole_name)
        placement = self.placement(board_number)
        bias = self.bias(hole_name)
        x, y = nominal.x + bias[0], nominal.y + bias[1]
        cosine, sine = math.cos(placement.yaw), math.sin(placement.yaw)
        errors = [
            self._in_random_direction(tolerances.common_error, "common error"),
            self._in_random_direction(tolerances.drift * (board_number - 1), "drift"),
        ]
        if self._number(hole_name) == tolerances.jump_hole and board_number >= tolerances.jump_board:
            errors.append(self._in_random_direction(tolerances.jump, "jump"))
        wider = tolerances.hole_radius_error
        if tolerances.hole_radius > 0:
            draw = self._normal("hole radius", self._session, board_number, hole_name)[0]
            wider += tolerances.hole_radius * min(max(draw, -HOLE_RADIUS_LIMIT), HOLE_RADIUS_LIMIT)
        return HoleTruth(
            placement.x + cosine * x - sine * y - nominal.x + sum(error[0] for error in errors),
            placement.y + sine * x + cosine * y - nominal.y + sum(error[1] for error in errors),
            placement.yaw,
            wider,
        )

    def part(self, search_number: int, hole_name: str) -> PartTruth:
        """How the part of one search sits in the gripper."""
        tolerances = self.tolerances
        factor = tolerances.abnormal_factor if self._number(hole_name) == tolerances.abnormal_hole else 1.0
        draw = self._normal("part", self._session, search_number, hole_name)
        scatter = tolerances.part_scatter * factor
        if tolerances.scatter_freedom > 0:
            squares = self._generator("tails", self._session, search_number, hole_name).chisquare(
                tolerances.scatter_freedom
            )
            scatter *= math.sqrt(tolerances.scatter_freedom / squares)
        return PartTruth(scatter * draw[0], scatter * draw[1], tolerances.part_rotation * draw[2])

    def offset(self, search_number: int, board_number: int, hole_name: str) -> tuple[float, float]:
        """Where the TCP must go relative to nominal [m] for the part to sit centred: hole minus pins."""
        hole, part = self.hole(board_number, hole_name), self.part(search_number, hole_name)
        return hole.x - part.x, hole.y - part.y

    def gap(self, search_number: int, board_number: int, hole_name: str) -> Gap:
        """What one part meets at one hole."""
        hole, part = self.hole(board_number, hole_name), self.part(search_number, hole_name)
        orientation = (self.board.hole(hole_name).orientation or 0.0) + hole.yaw
        # A component's z points down: seen from its frame, turns and the board's y change sign.
        return Gap(self.component, hole.x - part.x, hole.y - part.y, orientation, hole.yaw - part.yaw, hole.wider)

    def _number(self, hole_name: str) -> int:
        return next(i for i, hole in enumerate(self.board.holes, 1) if hole.name == hole_name)

    def _in_random_direction(self, length: float, *key: str | int) -> tuple[float, float]:
        if length == 0.0:
            return 0.0, 0.0
        angle = self._generator(*key, self.board.type).uniform(0.0, 2 * math.pi)
        return length * math.cos(angle), length * math.sin(angle)

    def _normal(self, *key: str | int) -> NDArray[np.float64]:
        """Three standard normal numbers that belong to this key."""
        return self._generator(*key).standard_normal(3)

    def _generator(self, *key: str | int) -> np.random.Generator:
        digest = hashlib.blake2b(repr((self._seed, *key)).encode(), digest_size=16).digest()
        return np.random.default_rng(int.from_bytes(digest, "big"))
