"""The simulated cell: the truth it draws, a whole board inserted, blocked and interrupted pecks."""

import math
from ctypes.util import find_library
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from pydantic import TypeAdapter, ValidationError

from drivers.ur3e.frames import rotation_of_vector, tool_down, vector_of_quaternion
from drivers.ur3e.parameters import CYCLE_NS
from drivers.ur3e.simulated_arm import SimulatedArm
from drivers.ur3e.simulated_cell import SimulatedCell
from drivers.ur3e.skill import Felt, InsertionSkill, SkillSettings
from drivers.ur3e.workcell import Workcell
from runtime.cell import Board, Hole, Tolerances
from runtime.component import component
from runtime.errors import InputError
from runtime.messages import Outcome
from runtime.world import World

IGBT, CAPACITOR = component("igbt"), component("capacitor")
NONE = Tolerances(0.0, 0.0, 0.0, 0.0, 0.0, 0)


def grid(orientation: float | None, count: int = 9) -> Board:
    holes = [Hole(f"h{i + 1}", (i % 3 - 1) * 0.03, (i // 3 - 1) * 0.03, orientation) for i in range(count)]
    return Board("grid", tuple(holes))


BOARD = grid(None)


def world(seed: int = 1, session: int = 0, tolerances: Tolerances | None = None) -> World:
    return World(BOARD, CAPACITOR, tolerances or Tolerances(), seed, session)


@settings(max_examples=30)
@given(st.integers(0, 2**31), st.integers(1, 50), st.integers(1, 9), st.integers(1, 400))
def test_the_truth_does_not_depend_on_the_order_of_asking(seed: int, board: int, number: int, search: int) -> None:
    name = f"h{number}"
    one, other = world(seed), world(seed)
    other.part(search + 1, name)
    other.hole(board + 1, name)
    assert one.offset(search, board, name) == other.offset(search, board, name)
    hole, part = one.hole(board, name), one.part(search, name)
    assert one.offset(search, board, name) == (hole.x - part.x, hole.y - part.y)


def test_a_later_session_meets_the_same_holes_on_other_boards() -> None:
    first, second = world(), world(session=1)
    assert all(first.bias(hole.name) == second.bias(hole.name) for hole in BOARD.holes)
    assert first.placement(1) != second.placement(1)
    assert first.placement(1) != first.placement(2)
    assert first.part(1, "h1") != second.part(1, "h1")
    assert world(2).bias("h1") != first.bias("h1")


def test_a_turned_board_carries_its_holes_around_its_centre() -> None:
    turned = world(tolerances=Tolerances(0.0, 0.01, 0.0, 0.0, 0.0, 0))
    yaw = turned.placement(3).yaw
    assert yaw != 0
    for hole in BOARD.holes:
        found = turned.hole(3, hole.name)
        assert found.yaw == yaw
        radius = math.hypot(hole.x, hole.y)
        assert math.hypot(hole.x + found.x, hole.y + found.y) == pytest.approx(radius, abs=1e-12)
    assert (turned.hole(3, "h5").x, turned.hole(3, "h5").y) == (0.0, 0.0)


def test_the_draws_have_the_spread_of_the_tolerances() -> None:
    tolerances = Tolerances(abnormal_hole=7)
    many = [world(seed, tolerances=tolerances) for seed in range(600)]
    bias = np.std([w.bias("h2") for w in many])
    shift = np.std([(w.placement(1).x, w.placement(1).y) for w in many])
    usual = np.std([(w.part(1, "h6").x, w.part(1, "h6").y) for w in many])
    abnormal = np.std([(w.part(1, "h7").x, w.part(1, "h7").y) for w in many])
    assert bias == pytest.approx(tolerances.hole_bias, rel=0.1)
    assert shift == pytest.approx(tolerances.board_shift, rel=0.1)
    assert usual == pytest.approx(tolerances.part_scatter, rel=0.1)
    assert abnormal == pytest.approx(3 * tolerances.part_scatter, rel=0.1)


def insert_board(name: str, orientation: float | None, seed: int) -> list[Felt]:
    """Nine parts by somebody who knows where the holes are, after two tries beside each of them."""
    part, board = component(name), grid(orientation)
    cell = SimulatedCell(board, part, Tolerances(), seed)
    skill = InsertionSkill(cell.arm, cell.scene.workcell, board, part)
    pecks = []
    for number, hole in enumerate(board.holes, 1):
        truth = cell.begin_search(number, 1, hole.name)
        assert cell.board_changed == (number == 1)
        skill.pick()
        assert cell.arm.holding
        x, y = truth.offset
        for beside in ((0.5e-3, 0.1e-3), (-0.1e-3, -0.5e-3)):
            blocked = skill.peck(hole, x + beside[0], y + beside[1])
            assert blocked.outcome is Outcome.BLOCKED, blocked
            assert 4.0 < blocked.wrench[2] < 7.5
            assert 5.0 < blocked.peak_force < 8.0
            assert blocked.depth < 0.1e-3
            pecks.append(blocked)
        seated = skill.peck(hole, x, y)
        assert seated.outcome is Outcome.SEATED, seated
        assert seated.depth > 0.95 * part.depth
        assert seated.tcp_position[0] == pytest.approx(board.x + hole.x + x, abs=30e-6)
        assert seated.tcp_position[1] == pytest.approx(board.y + hole.y + y, abs=30e-6)
        down = tool_down(hole.orientation or 0.0)
        turned = rotation_of_vector(vector_of_quaternion(seated.tcp_quaternion))
        assert turned == pytest.approx(down, abs=2e-3)
        pecks.append(seated)
        skill.release()
        assert not cell.arm.holding
    skill.home()
    return pecks


@pytest.mark.parametrize(("name", "orientation"), [("igbt", 0.0), ("igbt", math.pi / 2), ("capacitor", None)])
def test_a_whole_board_is_inserted_by_one_who_knows(name: str, orientation: float | None) -> None:
    assert len(insert_board(name, orientation, 11)) == 27


def test_half_turns_do_not_add_up_in_the_wrist() -> None:
    hole = Hole("h1", 0.0, 0.0, math.pi)
    board = Board("single", (hole,))
    cell = SimulatedCell(board, IGBT, NONE, noise=None)
    skill = InsertionSkill(cell.arm, cell.scene.workcell, board, IGBT)
    wrist = []
    for number in range(1, 5):
        cell.begin_search(number, number, "h1")
        skill.pick()
        assert skill.peck(hole, 0.0, 0.0).outcome is Outcome.SEATED
        wrist.append(cell.arm.getActualQ()[5])
        skill.release()
    assert np.ptp(wrist) < 1e-3


def test_the_same_seed_gives_the_same_pecks() -> None:
    assert insert_board("capacitor", None, 4) == insert_board("capacitor", None, 4)


def test_a_part_that_will_not_go_in_is_discarded() -> None:
    cell = SimulatedCell(BOARD, CAPACITOR, NONE, 2)
    skill = InsertionSkill(cell.arm, cell.scene.workcell, BOARD, CAPACITOR)
    cell.begin_search(1, 1, "h1")
    skill.pick()
    assert skill.peck(BOARD.holes[0], 1e-3, 0.0).outcome is Outcome.BLOCKED
    skill.discard()
    assert not cell.arm.holding
    cell.begin_search(2, 1, "h1")
    skill.pick()
    assert cell.arm.holding


def test_a_hand_without_a_part_meets_no_resistance() -> None:
    cell = SimulatedCell(BOARD, CAPACITOR, NONE, 2)
    skill = InsertionSkill(cell.arm, cell.scene.workcell, BOARD, CAPACITOR)
    peck = skill.peck(BOARD.holes[4], 1e-3, 0.0)
    assert peck.depth > 0.9 * CAPACITOR.depth
    assert peck.peak_force < 3.0
    assert not cell.arm.holding


def test_a_peck_out_of_reach_is_aborted_and_says_so() -> None:
    cell = SimulatedCell(BOARD, CAPACITOR, NONE, 2)
    skill = InsertionSkill(cell.arm, cell.scene.workcell, BOARD, CAPACITOR)
    cell.begin_search(1, 1, "h1")
    skill.pick()
    peck = skill.peck(BOARD.holes[0], 0.5, 0.0)
    assert peck.outcome is Outcome.ABORTED
    assert "no straight way to TCP at (770.00, -30.00" in peck.reason
    assert skill.peck(BOARD.holes[0], 0.0, 0.0).outcome is Outcome.SEATED


@pytest.mark.parametrize(("offset", "outcome"), [(1e-3, Outcome.BLOCKED), (0.0, Outcome.SEATED)])
def test_a_safeguard_stop_during_the_descent_only_makes_the_peck_longer(offset: float, outcome: Outcome) -> None:
    stop: list[int] = []

    def gate(time: int) -> bool:
        return not (stop and stop[0] <= time < stop[0] + 500 * CYCLE_NS)

    def observe(arm: object) -> None:
        if armed and not stop and cell.arm.pose[0][2] < BOARD.z + 0.5e-3:
            stop.append(cell.arm.time)

    armed: list[bool] = []
    cell = SimulatedCell(BOARD, CAPACITOR, NONE, 2, gate=gate, observe=observe)
    skill = InsertionSkill(cell.arm, cell.scene.workcell, BOARD, CAPACITOR)
    cell.begin_search(1, 1, "h1")
    skill.pick()
    armed.append(True)
    peck = skill.peck(BOARD.holes[0], offset, 0.0)
    assert (peck.outcome, peck.reason) == (outcome, "")
    assert peck.duration > 1.0
    assert stop


def test_the_gripper_waits_for_a_safeguard_stop_to_end() -> None:
    closing: list[tuple[int, bool]] = []
    permitted_from = 30 * 1000 * CYCLE_NS

    def gate(time: int) -> bool:
        return not arrived or time >= permitted_from

    def observe(arm: SimulatedArm) -> None:
        feeder = (0.30, -0.20, 0.06)
        if not arrived and math.dist(arm.controller.position, feeder) < 1e-9:
            arrived.append(arm.time)
        if arm.holding and not closing:
            closing.append((arm.time, gate(arm.time)))

    arrived: list[int] = []
    cell = SimulatedCell(BOARD, CAPACITOR, NONE, 2, gate=gate, observe=observe)
    skill = InsertionSkill(cell.arm, cell.scene.workcell, BOARD, CAPACITOR)
    cell.begin_search(1, 1, "h1")
    skill.pick()
    assert arrived[0] < permitted_from
    assert closing[0][0] >= permitted_from


def test_workcell_and_skill_are_filled_from_texts_with_units() -> None:
    degrees = [f"{angle} deg" for angle in (-24, -96, 108, -102, -90, -114)]
    workcell = TypeAdapter(Workcell).validate_python({"home": degrees, "feeder_x": "310 mm"})
    assert workcell.home == pytest.approx(Workcell().home)
    assert workcell.feeder_x == pytest.approx(0.31)
    assert TypeAdapter(SkillSettings).validate_python({"contact_force": "4 N"}).contact_force == 4.0
    with pytest.raises(ValidationError, match="has no unit"):
        TypeAdapter(Workcell).validate_python({"feeder_x": 310})


def test_an_unknown_hole_is_refused() -> None:
    with pytest.raises(InputError, match=r"no hole 'h10' on board 'grid'"):
        SimulatedCell(BOARD, CAPACITOR, NONE).begin_search(1, 1, "h10")


def test_a_fresh_board_is_empty() -> None:
    cell = SimulatedCell(BOARD, CAPACITOR, NONE)
    cell.begin_search(1, 1, "h1")
    assert cell.board_changed
    cell.begin_search(2, 1, "h2")
    assert not cell.board_changed
    cell.begin_search(3, 2, "h1")
    assert cell.board_changed


def test_a_picture_shows_a_green_board(tmp_path: Path) -> None:
    if find_library("EGL") is None:
        pytest.skip("this machine has no libEGL to draw with")
    cell = SimulatedCell(BOARD, CAPACITOR, NONE)
    cell.render(tmp_path / "board.png", 320, 240, "board")
    with Image.open(tmp_path / "board.png") as image:
        pixels = np.asarray(image.convert("RGB"), dtype=float)
    assert pixels.shape == (240, 320, 3)
    green = (pixels[..., 1] > 1.5 * pixels[..., 0]) & (pixels[..., 1] > 1.5 * pixels[..., 2])
    assert green.mean() > 0.05
