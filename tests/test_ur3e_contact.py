"""Where pins stop going in: real pecks against the exact geometry."""

import logging
import math
from dataclasses import replace

import numpy as np
import pytest

from drivers.ur3e.simulated_cell import SimulatedCell
from drivers.ur3e.skill import InsertionSkill
from runtime.cell import Board, Hole, Tolerances
from runtime.component import Component, clearance, component
from runtime.messages import Outcome

HOLE = Hole("h1", 0.0, 0.0, 0.0)
BOARD = Board("single", (HOLE,))
EXACT = Tolerances(0.0, 0.0, 0.0, 0.0, 0.0, 0)


class Bench:
    """One part held over one hole that is exactly where the drawing has it."""

    def __init__(self, part: Component, wider: float = 0.0) -> None:
        self.part = part
        cell = SimulatedCell(BOARD, part, replace(EXACT, hole_radius_error=wider), noise=None)
        self.skill = InsertionSkill(cell.arm, cell.scene.workcell, BOARD, part)
        cell.begin_search(1, 1, HOLE.name)
        self.skill.pick()
        assert cell.arm.holding

    def goes_in(self, direction: float, distance: float) -> bool:
        """Whether the part goes in when it is off by that distance [m] in that direction of its own frame."""
        peck = self.skill.peck(HOLE, distance * math.cos(direction), -distance * math.sin(direction))
        assert peck.outcome in (Outcome.SEATED, Outcome.BLOCKED), peck
        return peck.outcome is Outcome.SEATED

    def boundary(self, direction: float) -> float:
        """Distance [m] at which it stops going in, to 1 um."""
        exact = clearance(self.part, direction)
        inside, outside = exact - 64e-6, exact + 64e-6
        assert self.goes_in(direction, inside)
        assert not self.goes_in(direction, outside)
        while outside - inside > 2e-6:
            middle = (inside + outside) / 2
            inside, outside = (middle, outside) if self.goes_in(direction, middle) else (inside, middle)
        return (inside + outside) / 2


@pytest.mark.parametrize("name", ["igbt", "capacitor"])
def test_pins_stop_going_in_where_the_geometry_says(name: str) -> None:
    part = component(name)
    bench = Bench(part)
    directions = [index * math.pi / 4 for index in range(8)]
    errors = [1e6 * (bench.boundary(direction) - clearance(part, direction)) for direction in directions]
    logging.info("%s: boundary minus clearance, um: %s", name, np.round(errors, 1).tolist())
    assert max(map(abs, errors)) < 15, errors


@pytest.mark.parametrize("name", ["igbt", "capacitor"])
@pytest.mark.parametrize("wider", [-0.05e-3, 0.08e-3])
def test_holes_may_be_tighter_and_wider_than_drawn(name: str, wider: float) -> None:
    part = component(name)
    bench = Bench(part, wider)
    for direction in (0.0, math.pi / 2, 0.8):
        exact = clearance(part, direction, wider=wider)
        assert bench.goes_in(direction, exact - 20e-6)
        assert not bench.goes_in(direction, exact + 20e-6)


@pytest.mark.parametrize("name", ["igbt", "capacitor"])
def test_no_part_goes_in_beyond_its_clearance(name: str) -> None:
    part = component(name)
    bench = Bench(part)
    rng = np.random.default_rng(3)
    false = []
    for _ in range(100):
        direction, beyond = rng.uniform(-math.pi, math.pi), rng.uniform(20e-6, 100e-6)
        if bench.goes_in(direction, clearance(part, direction) + beyond):
            false.append((round(math.degrees(direction)), round(1e6 * beyond)))
    logging.info("%s: false insertions at (deg, um beyond) out of 100: %s", name, false)
    assert not false
