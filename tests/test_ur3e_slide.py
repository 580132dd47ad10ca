"""Slides: paths as geometry, pins that drop in on the way, paths that miss, and what may happen in between."""

import itertools
import math
from collections.abc import Callable, Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError

from drivers.ur3e.parameters import CYCLE_NS
from drivers.ur3e.simulated_arm import SimulatedArm
from drivers.ur3e.simulated_cell import SimulatedCell
from drivers.ur3e.skill import Felt, InsertionSkill, SkillSettings
from drivers.ur3e.slide import Polyline
from runtime.cell import Board, Hole, Tolerances
from runtime.component import Component, component
from runtime.errors import InputError
from runtime.messages import Outcome

IGBT, CAPACITOR = component("igbt"), component("capacitor")
NONE = Tolerances(0.0, 0.0, 0.0, 0.0, 0.0, 0)
HOLE = Hole("h1", 0.0, 0.0, 0.0)
BOARD = Board("single", (HOLE,))
STRAY = 70e-6  # [m] of the TCP from its path at a corner: 56 were measured at 10 mm/s

points = st.lists(st.tuples(st.floats(-1e-2, 1e-2), st.floats(-1e-2, 1e-2)), min_size=1, max_size=8)


@given(points)
def test_a_path_begins_at_its_first_point_and_ends_at_its_last(path: list[tuple[float, float]]) -> None:
    line = Polyline(path)
    assert line.at(0.0) == pytest.approx(path[0], abs=1e-12) or math.dist(path[0], path[1]) == 0
    assert line.at(line.length) == path[-1]
    assert line.length == pytest.approx(sum(math.dist(a, b) for a, b in itertools.pairwise(path)))


@given(points, st.floats(0, 1), st.floats(0, 1))
def test_along_a_path_nobody_is_further_away_than_the_way_is_long(
    path: list[tuple[float, float]], first: float, second: float
) -> None:
    line = Polyline(path)
    a, b = first * line.length, second * line.length
    assert math.dist(line.at(a), line.at(b)) <= abs(a - b) + 1e-9


@given(points, st.integers(1, 60))
def test_who_goes_where_a_path_leads_arrives(path: list[tuple[float, float]], steps: int) -> None:
    line = Polyline(path)
    stride = line.length / steps
    (x, y), travelled, count = path[0], 0.0, 0
    while travelled < line.length:
        dx, dy = line.direction(travelled)
        x, y = x + stride * dx, y + stride * dy
        before, travelled = travelled, line.progress(x, y, travelled)
        assert before <= travelled <= line.length
        count += 1
        assert count <= steps + 3 * len(path)


@given(points, st.tuples(st.floats(-1, 1), st.floats(-1, 1)), st.floats(0, 1))
def test_a_path_is_never_gone_back(path: list[tuple[float, float]], aside: tuple[float, float], share: float) -> None:
    line = Polyline(path)
    assert share * line.length <= line.progress(*aside, share * line.length) <= line.length


def test_a_corner_is_not_cut() -> None:
    line = Polyline([(0.0, 0.0), (1e-3, 0.0), (1e-3, 1e-3)])
    assert line.progress(0.5e-3, 0.9e-3, 0.2e-3) == pytest.approx(0.5e-3)
    assert line.progress(1.001e-3, 0.3e-3, 0.9e-3) == pytest.approx(1.3e-3)
    assert line.direction(0.5e-3) == pytest.approx((1.0, 0.0))
    assert line.direction(1e-3) == pytest.approx((0.0, 1.0))
    assert line.direction(2e-3) == pytest.approx((0.0, 1.0))


def test_a_path_without_points_is_refused_before_anything_moves() -> None:
    bench = Bench(CAPACITOR)
    before = bench.arm.time
    with pytest.raises(InputError, match="at least one point"):
        bench.skill.slide(HOLE, [])
    assert bench.arm.time == before


class Bench:
    """A part in the gripper, and its hole at a place that the test knows."""

    def __init__(
        self,
        part: Component,
        hole: tuple[float, float] = (0.0, 0.0),
        *,
        part_yaw: float = 0.0,
        settings: SkillSettings | None = None,
        gate: Callable[[int], bool] | None = None,
    ) -> None:
        self.part = part
        self.cell = SimulatedCell(BOARD, part, NONE, 3, gate=gate, observe=self._after_cycle)
        self.watch: Callable[[SimulatedArm], None] | None = None
        self.arm = self.cell.arm
        self.skill = InsertionSkill(self.arm, self.cell.scene.workcell, BOARD, part, settings)
        self.cell.begin_search(1, 1, "h1")
        self.cell.scene.place_holes(BOARD.x + hole[0], BOARD.y + hole[1], 0.0)
        self.cell.scene.present_part(True, 0.0, 0.0, part_yaw)
        self.skill.pick()

    def _after_cycle(self, arm: SimulatedArm) -> None:
        if self.watch is not None:
            self.watch(arm)

    @property
    def sliding(self) -> bool:
        return self.arm.controller.compliance is not None

    def slide(self, *path: tuple[float, float]) -> Felt:
        felt = self.skill.slide(HOLE, path)
        assert not self.sliding
        return felt


def distance(x: float, y: float, path: Sequence[tuple[float, float]]) -> float:
    """From a path of straight lines [m]."""
    nearest = math.inf
    for (ax, ay), (bx, by) in itertools.pairwise(path):
        length = math.dist((ax, ay), (bx, by))
        share = min(max(((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / length**2, 0.0), 1.0)
        nearest = min(nearest, math.dist((x, y), (ax + share * (bx - ax), ay + share * (by - ay))))
    return nearest


@pytest.mark.parametrize("part", [IGBT, CAPACITOR], ids=lambda part: part.name)
@pytest.mark.parametrize("angle", [0.0, math.pi / 2, -3 * math.pi / 4])
def test_pins_drop_in_on_the_way(part: Component, angle: float) -> None:
    hole = (0.3e-3, -0.2e-3)
    bench = Bench(part, hole)
    dx, dy = math.cos(angle), math.sin(angle)
    aside = 0.1e-3
    start = (hole[0] - 1e-3 * dx - aside * dy, hole[1] - 1e-3 * dy + aside * dx)
    felt = bench.slide(start, (start[0] + 2e-3 * dx, start[1] + 2e-3 * dy))
    assert (felt.outcome, felt.reason) == (Outcome.SEATED, "")
    assert felt.depth > 0.95 * part.depth
    assert math.dist((felt.x, felt.y), start) == pytest.approx(felt.travelled, abs=1e-9)
    assert felt.travelled == pytest.approx(1e-3, abs=0.45e-3)
    seated = (felt.tcp_position[0] - BOARD.x, felt.tcp_position[1] - BOARD.y)
    assert math.dist(seated, hole) < 0.3e-3
    assert felt.peak_force < 8.5
    assert bench.arm.stops == 0
    bench.skill.release()
    assert not bench.arm.holding


def test_pins_over_their_holes_go_in_without_a_slide() -> None:
    bench = Bench(CAPACITOR)
    felt = bench.slide((0.0, 0.0), (1e-3, 0.0))
    assert felt.outcome is Outcome.SEATED
    assert (felt.x, felt.y, felt.travelled) == (0.0, 0.0, 0.0)


def test_a_peck_tells_where_it_was() -> None:
    bench = Bench(CAPACITOR)
    felt = bench.skill.peck(HOLE, 1e-3, -0.5e-3)
    assert felt.outcome is Outcome.BLOCKED
    assert (felt.x, felt.y, felt.travelled) == (1e-3, -0.5e-3, 0.0)


@pytest.mark.parametrize("speed", [5e-3, 10e-3])
def test_a_path_that_misses_is_followed_to_its_end_with_a_light_force(speed: float) -> None:
    bench = Bench(CAPACITOR, (3e-3, 3e-3), settings=SkillSettings(slide_speed=speed))
    path = [(-1e-3, -0.5e-3), (1e-3, -0.5e-3), (1e-3, -0.1e-3), (-1e-3, -0.1e-3)]
    places: list[tuple[float, float]] = []
    forces: list[float] = []

    def watch(arm: SimulatedArm) -> None:
        if bench.sliding:
            places.append((arm.pose[0][0] - BOARD.x, arm.pose[0][1] - BOARD.y))
            forces.append(arm.wrench[2])

    bench.watch = watch
    felt = bench.slide(*path)
    assert (felt.outcome, felt.reason) == (Outcome.BLOCKED, "")
    assert (felt.x, felt.y) == path[-1]
    assert felt.travelled == pytest.approx(4.4e-3)
    assert felt.wrench[2] == pytest.approx(SkillSettings().slide_force, abs=0.7)
    assert sum(forces[30:]) / len(forces[30:]) == pytest.approx(SkillSettings().slide_force, abs=0.2)
    assert max(distance(x, y, path) for x, y in places) < STRAY
    assert len(places) * 2e-3 == pytest.approx(4.4e-3 / speed, abs=0.1)
    x, y, z = bench.arm.pose[0]
    assert (x, y, z) == pytest.approx((BOARD.x - 1e-3, BOARD.y - 0.1e-3, BOARD.z + 1e-3), abs=5e-5)


def test_a_path_of_one_point_is_a_peck() -> None:
    felt = Bench(CAPACITOR).slide((1e-3, 0.0))
    assert (felt.outcome, felt.reason, felt.travelled) == (Outcome.BLOCKED, "", 0.0)


def test_pins_that_sink_into_the_chamfer_only_are_not_seated() -> None:
    """Turned by 3 degrees the tips fit, the pins behind them do not."""
    bench = Bench(IGBT, part_yaw=math.radians(3.0))
    lowest: list[float] = []
    bench.watch = lambda arm: lowest.append(arm.pose[0][2])
    felt = bench.slide((-1e-3, 0.0), (1e-3, 0.0))
    assert min(lowest) < BOARD.z - SkillSettings().drop_depth
    assert felt.outcome is Outcome.BLOCKED
    assert bench.arm.stops == 0


def test_after_a_false_drop_the_slide_goes_on() -> None:
    """A drop depth within the noise of the height makes false ones; the true one is at the end."""
    bench = Bench(CAPACITOR, settings=SkillSettings(drop_depth=14e-6))
    pushes: list[bool] = []

    def watch(arm: SimulatedArm) -> None:
        compliance = arm.controller.compliance
        pushing = compliance is not None and len(compliance.axes) == 3
        if pushing and not (pushes and pushes[-1]):
            pushes.append(True)
        elif not pushing and pushes and pushes[-1]:
            pushes.append(False)

    bench.watch = watch
    felt = bench.slide((-1.5e-3, 0.0), (1.5e-3, 0.0))
    assert sum(pushes) > 1
    assert felt.outcome is Outcome.SEATED
    assert felt.depth > 0.9 * CAPACITOR.depth


@pytest.mark.parametrize(("hole", "outcome"), [((0.0, 0.0), Outcome.SEATED), ((3e-3, 3e-3), Outcome.BLOCKED)])
def test_a_safeguard_stop_only_makes_a_slide_longer(hole: tuple[float, float], outcome: Outcome) -> None:
    begun: list[int] = []
    still: list[float] = []

    def gate(time: int) -> bool:
        return not (begun and begun[0] + 50 * CYCLE_NS <= time < begun[0] + 1500 * CYCLE_NS)

    bench = Bench(CAPACITOR, hole, gate=gate)

    def watch(arm: SimulatedArm) -> None:
        if bench.sliding and not begun:
            begun.append(arm.time)
        if begun and begun[0] + 150 * CYCLE_NS <= arm.time < begun[0] + 1500 * CYCLE_NS:
            still.append(max(map(abs, arm.controller.qd)))

    bench.watch = watch
    felt = bench.slide((-1e-3, 0.0), (1e-3, 0.0))
    assert (felt.outcome, felt.reason) == (outcome, "")
    assert felt.duration > 2.9
    assert max(still) == 0.0


def test_a_protective_stop_ends_the_slide_with_its_reason() -> None:
    bench = Bench(CAPACITOR, (3e-3, 3e-3))

    def watch(arm: SimulatedArm) -> None:
        if bench.sliding and arm.pose[0][0] > BOARD.x:
            arm.protective_stop("a test")

    bench.watch = watch
    felt = bench.slide((-1e-3, 0.0), (1e-3, 0.0))
    assert felt.outcome is Outcome.ABORTED
    assert felt.reason == "protective stop (safety mode 3)"
    assert 0.9e-3 < felt.travelled < 1.2e-3
    assert felt.x == pytest.approx(felt.travelled - 1e-3)
    assert math.dist(felt.tcp_position, (BOARD.x + felt.x, 0.0, BOARD.z)) < 0.3e-3


class Closing(Exception):  # noqa: N818 - no error
    """The cell closes."""


def test_force_mode_and_motion_end_when_the_cell_closes_in_the_middle() -> None:
    bench = Bench(CAPACITOR, (3e-3, 3e-3))

    def watch(arm: SimulatedArm) -> None:
        if bench.sliding and arm.pose[0][0] > BOARD.x:
            raise Closing

    bench.watch = watch
    with pytest.raises(Closing):
        bench.skill.slide(HOLE, [(-1e-3, 0.0), (1e-3, 0.0)])
    assert not bench.sliding
    bench.watch = None
    for _ in range(25):
        bench.arm.cycle()
    assert bench.arm.isSteady()


def test_a_slide_that_presses_harder_than_the_push_home_is_refused() -> None:
    with pytest.raises(ValidationError, match="home_force is 5 N and must be above slide_force, 6 N"):
        TypeAdapter(SkillSettings).validate_python({"slide_force": "6 N"})
    assert TypeAdapter(SkillSettings).validate_python({"slide_speed": "5 mm/s"}).slide_speed == 5e-3


def test_the_same_seed_gives_the_same_slide() -> None:
    one, other = (Bench(IGBT, (0.2e-3, 0.0)).slide((-1e-3, 0.1e-3), (1e-3, 0.1e-3)) for _ in range(2))
    assert one == other
