"""The truth that simulations draw: what stays, what changes from board to board and part to part, and by how much."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from runtime.cell import HOLE_RADIUS_LIMIT, Board, Hole, Tolerances
from runtime.component import component
from runtime.experiment.worlds import WORLDS, world
from runtime.world import World

MM = 1e-3
BOARD = Board("two", (Hole("a", -0.03, 0.0, 0.0), Hole("b", 0.03, 0.02, math.pi)))
NONE = Tolerances(0.0, 0.0, 0.0, 0.0, 0.0, 0)
IGBT = component("igbt")


def worlds(tolerances: Tolerances, count: int = 400) -> list[World]:
    return [World(BOARD, IGBT, tolerances, seed) for seed in range(count)]


def test_same_seed_same_truth_in_any_order() -> None:
    tolerances = world("realistic").tolerances
    one, other = World(BOARD, IGBT, tolerances, 3), World(BOARD, IGBT, tolerances, 3)
    late = other.gap(7, 4, "b")
    assert one.gap(1, 1, "a") == other.gap(1, 1, "a")
    assert one.gap(7, 4, "b") == late
    assert World(BOARD, IGBT, tolerances, 4).gap(7, 4, "b") != late


def test_the_common_error_has_its_length_and_any_direction() -> None:
    offsets = np.array([w.offset(1, 1, "a") for w in worlds(replace(NONE, common_error=0.7 * MM))])
    assert np.hypot(*offsets.T) == pytest.approx(np.full(len(offsets), 0.7 * MM))
    assert np.abs(offsets.mean(axis=0)).max() < 0.1 * MM
    one = worlds(replace(NONE, common_error=0.7 * MM), 1)[0]
    assert one.offset(1, 1, "a") == pytest.approx(one.offset(9, 5, "b"))


def test_drift_goes_one_way_board_by_board() -> None:
    one = worlds(replace(NONE, drift=0.1 * MM), 1)[0]
    offsets = np.array([one.offset(board, board, "a") for board in range(1, 6)])
    assert offsets[0] == pytest.approx([0.0, 0.0])
    assert np.hypot(*np.diff(offsets, axis=0).T) == pytest.approx(np.full(4, 0.1 * MM))
    assert np.hypot(*offsets[4]) == pytest.approx(0.4 * MM)


def test_one_hole_jumps_and_stays_there() -> None:
    one = worlds(replace(NONE, jump=1 * MM, jump_hole=2, jump_board=3), 1)[0]
    assert [round(math.hypot(*one.offset(board, board, "b")) / MM, 9) for board in range(1, 6)] == [0, 0, 1, 1, 1]
    assert one.offset(4, 4, "a") == pytest.approx((0.0, 0.0))


def test_holes_vary_in_width_but_not_without_limit() -> None:
    tolerances = replace(NONE, hole_radius=0.02 * MM, hole_radius_error=-0.03 * MM)
    wider = np.array([w.hole(board, "a").wider for w in worlds(tolerances, 200) for board in (1, 2)])
    assert wider.mean() == pytest.approx(-0.03 * MM, abs=0.004 * MM)
    assert np.abs(wider + 0.03 * MM).max() == pytest.approx(HOLE_RADIUS_LIMIT * 0.02 * MM)
    assert wider.std() == pytest.approx(0.019 * MM, abs=0.002 * MM)


def test_heavy_tails_have_them() -> None:
    normal = replace(NONE, part_scatter=0.1 * MM)
    heavy = replace(normal, scatter_freedom=2.5)

    def far(tolerances: Tolerances) -> float:
        lengths = [math.hypot(*w.offset(1, 1, "a")) for w in worlds(tolerances, 1500)]
        return float(np.mean(np.array(lengths) > 0.4 * MM))

    assert far(normal) < 0.003
    assert 0.02 < far(heavy) < 0.12  # of Student's t in the plane: (1 + 16 / 2.5)^-1.25 = 0.082


@pytest.mark.parametrize("name", ["a", "b"])
def test_a_gap_is_where_the_offset_says(name: str) -> None:
    gap = World(BOARD, IGBT, world("realistic").tolerances, 5).gap(2, 1, name)
    offset = World(BOARD, IGBT, world("realistic").tolerances, 5).offset(2, 1, name)
    assert (gap.x, gap.y) == pytest.approx(offset)
    assert gap.feasible(gap.x, gap.y)
    assert not gap.feasible(gap.x + 0.5 * MM, gap.y)


def test_named_worlds_are_cells_that_a_launch_accepts() -> None:
    for named in WORLDS.values():
        for part in ("igbt", "capacitor"):
            cell = named.cell(part, seed=1)
            assert World(cell.board, component(part), cell.tolerances, 1).gap(1, 1, "1").wider < 0.15 * MM
