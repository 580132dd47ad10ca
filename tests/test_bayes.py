"""bayes and bayes-slide: the belief within a search, the guard that outlives a wrong belief, and the worth of both."""

from __future__ import annotations

import dataclasses
import math
import subprocess
import sys
import textwrap

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from search_world import attempt_at, goal_for

from runtime.component import COMPONENTS, feasible_radius
from runtime.experiment.model import StatisticalBench
from runtime.experiment.worlds import world
from runtime.feasible_area import area_of
from runtime.hierarchy import Mixture
from runtime.messages import Miss, Outcome, Place, Point, Pose, Proposal, Quaternion, SearchGoal, Seat, Waypoint
from runtime.plain_job import PlainJob
from runtime.plugin import SearchRecord, Strategy
from runtime.world import Gap
from strategies.bayes import Bayes
from strategies.bayes_slide import BayesSlide
from strategies.guard import sweep
from strategies.offset_grid import OffsetGrid

MM = 1e-3
components = st.sampled_from(["igbt", "capacitor"])
turns = st.floats(-math.pi, math.pi)


def goal_of(component: str, yaw: float = 0.0, **changes: object) -> SearchGoal:
    turned = Quaternion(x=math.cos(yaw / 2), y=math.sin(yaw / 2), z=0.0, w=0.0)
    nominal = Pose(position=Point(x=0.3, y=0.0, z=0.05), orientation=turned)
    radius = feasible_radius(COMPONENTS[component])
    layout = [Place("h1", 0.3, 0.0), Place("h2", 0.33, 0.0), Place("h3", 0.3, 0.03)]
    plain = goal_for(component=component, nominal=nominal, feasible_radius=radius, layout=layout)
    return dataclasses.replace(plain, **changes)


@settings(max_examples=30, deadline=None)
@given(components, turns, st.integers(0, 2**32))
def test_area_is_the_component_s_own(component: str, yaw: float, seed: int) -> None:
    area, gap = area_of(goal_of(component, yaw)), Gap(COMPONENTS[component], 0.0, 0.0, yaw, 0.0, 0.0)
    errors = np.random.default_rng(seed).uniform(-0.45 * MM, 0.45 * MM, (300, 2))
    gauge = area.gauge(area.to_own(errors))
    clear = np.abs(gauge - 1) > 0.01
    assert [gap.feasible(*error) for error in errors[clear]] == (gauge[clear] < 1).tolist()
    assert area.to_metres(area.to_own(errors)) == pytest.approx(errors)


def test_an_unknown_part_has_a_disc() -> None:
    area = area_of(goal_for(component="something else", feasible_radius=0.2 * MM))
    assert area.gauge(area.to_own(np.array([[0.2 * MM, 0.0], [0.0, -0.1 * MM]]))) == pytest.approx([1.0, 0.5])


@pytest.mark.parametrize("component", ["igbt", "capacitor"])
def test_masses_are_those_of_quadrature(component: str) -> None:
    """Probability of insertion at a point, also after failures, against a fine sum over the part's exact geometry."""
    yaw, part = 0.4, COMPONENTS[component]
    area = area_of(goal_of(component, yaw))
    mean, covariance = np.array([0.1 * MM, -0.05 * MM]), np.array([[0.09, 0.03], [0.03, 0.05]]) * MM**2
    grid = OffsetGrid(area, Mixture(np.ones(1), mean[None], covariance[None]), 0.02)
    along = np.arange(-1.5 * MM, 1.5 * MM, 0.01 * MM)
    fine = mean + np.stack(np.meshgrid(along, along, indexing="ij"), axis=-1).reshape(-1, 2)
    density = np.exp(-0.5 * np.einsum("ni,ij,nj->n", fine - mean, np.linalg.inv(covariance), fine - mean))

    def fits(point: np.ndarray) -> np.ndarray:
        near = np.hypot(*(fine - point).T) < 0.5 * MM
        inside = np.zeros(len(fine), dtype=bool)
        inside[near] = [Gap(part, x, y, yaw, 0.0, 0.0).feasible(*point) for x, y in fine[near]]
        return inside

    for near in (np.array([0.1, 0.0]) * MM, np.array([-0.2, 0.2]) * MM, np.array([0.3, 0.3]) * MM):
        row, column = grid.cell_of(area.to_own(near))
        tried = area.to_metres(grid.points()[row, column])
        expected = density[fits(tried)].sum() / density.sum()
        assert grid.masses()[row, column] == pytest.approx(expected, abs=0.02)
        grid.miss(area.to_own(tried))
        density[fits(tried)] = 0.0
    assert grid.left == pytest.approx(
        density.sum() / (2 * math.pi * math.sqrt(np.linalg.det(covariance)) / 1e-10), abs=0.02
    )


def test_a_slide_rules_out_what_it_passed_but_not_for_good() -> None:
    area = area_of(goal_of("capacitor"))
    grid = OffsetGrid(area, Mixture(np.ones(1), np.zeros((1, 2)), 0.04 * MM**2 * np.eye(2)[None]), 0.1)
    before = grid.survival()
    assert before == pytest.approx(np.ones_like(before), abs=1e-6)
    grid.passed(np.array([[-1.0, 0.0], [1.0, 0.0]]), 0.8, 0.9)
    survival = grid.survival()

    def at(x: float, y: float) -> float:
        return float(survival[grid.cell_of(np.array([x, y]))])

    assert at(0.0, 0.0) == pytest.approx(0.1, abs=0.01)
    assert at(0.9, -0.2) == pytest.approx(0.1, abs=0.02)
    assert at(0.0, 1.5) > 0.95
    assert at(-2.4, 0.0) > 0.95


@settings(max_examples=25, deadline=None)
@given(
    components,
    turns,
    st.tuples(st.floats(0, 1), turns),
    st.tuples(st.floats(0, 1), turns),
    st.lists(st.tuples(st.floats(-2, 2), st.floats(-2, 2)), max_size=60),
    st.sampled_from([1.0, 0.8, 0.55]),
)
def test_guard_leaves_no_gap(
    component: str,
    yaw: float,
    hole: tuple[float, float],
    centre: tuple[float, float],
    earlier: list[tuple[float, float]],
    size: float,
) -> None:
    """Whatever was tried and wherever it begins, the sweep finds any hole within reach, and it ends."""
    reach, area = 2 * MM, area_of(goal_of(component, yaw))
    place = reach * math.sqrt(hole[0]) * np.array([math.cos(hole[1]), math.sin(hole[1])])
    middle = reach * math.sqrt(centre[0]) * np.array([math.cos(centre[1]), math.sin(centre[1])])
    known = [np.array(point) * MM for point in earlier]
    errors = area.gauge(area.to_own(np.array(known).reshape(-1, 2) - place))
    found = bool((errors < size).any())
    count = 0
    for point in sweep(area, middle, reach, lambda: np.array(known).reshape(-1, 2)):
        assert np.hypot(*point) <= reach
        known.append(point)
        count += 1
        found = found or float(area.gauge(area.to_own(point - place))) < size
    assert found
    assert count < 1000


def proposals(strategy: Strategy, goal: SearchGoal, limit: int) -> list[Proposal]:
    search, found = strategy.search(goal), []
    for proposal in search if limit == 1 else [next(search)]:
        found.append(proposal)
        break
    while len(found) < limit:
        last = found[-1]
        try:
            found.append(search.send(attempt_at(goal, len(found), last.x, last.y, Outcome.BLOCKED)))
        except StopIteration:
            break
    return found


@pytest.mark.parametrize("make", [Bayes, BayesSlide])
def test_a_confidently_wrong_belief_is_outlived(make: type[Bayes] | type[BayesSlide]) -> None:
    """Forty boards said 0; the hole is 1.9 mm away. It is found, within a bounded number of attempts."""
    seats = [Seat("s", board, "h1", 0.0, 0.0, 0.0, 0.0) for board in range(1, 41)]
    goal = goal_of("capacitor", board=41, seats=seats, max_attempts=2000)
    for angle in (0.3, 2.0, 4.1):
        gap = Gap(COMPONENTS["capacitor"], 1.9 * MM * math.cos(angle), 1.9 * MM * math.sin(angle), 0.0, 0.0, 0.0)
        tried = proposals(make(), goal, 2000)
        hits = [
            number
            for number, proposal in enumerate(tried, 1)
            if any(gap.feasible(x, y) for x, y in [(proposal.x, proposal.y), *((p.x, p.y) for p in proposal.path)])
        ]
        assert hits, "never found"
        assert hits[0] < 400


@pytest.mark.parametrize("make", [Bayes, BayesSlide])
def test_what_earlier_searches_did_not_find_counts(make: type[Bayes] | type[BayesSlide]) -> None:
    """A search that found nothing about nominal moves the next search of this board elsewhere."""
    ring = [(0.25 * i * MM, 0.25 * j * MM) for i in range(-3, 4) for j in range(-3, 4)]
    misses = [Miss(1, "h2", [Waypoint(x, y)]) for x, y in ring]
    fresh = proposals(make(), goal_of("capacitor"), 1)[0]
    warned = proposals(make(), goal_of("capacitor", misses=misses), 1)[0]
    assert fresh.probability > 1.3 * warned.probability
    slid = [Miss(1, "h2", [Waypoint(-0.75 * MM, y * MM), Waypoint(0.75 * MM, y * MM)]) for y in (-0.5, 0.0, 0.5)]
    assert fresh.probability > 1.1 * proposals(make(), goal_of("capacitor", misses=slid), 1)[0].probability


def test_how_well_slides_catch_counts_in_hindsight_too() -> None:
    slid = [Miss(1, "h2", [Waypoint(-0.75 * MM, y * MM), Waypoint(0.75 * MM, y * MM)]) for y in (-0.5, 0.0, 0.5)]
    goal = goal_of("capacitor", misses=slid)
    sure, unsure = (proposals(BayesSlide(catch=catch), goal, 1)[0].probability for catch in (0.9, 0.2))
    assert unsure > 1.05 * sure


def test_failures_are_not_repeated_and_probability_falls() -> None:
    tried = proposals(Bayes(), goal_of("igbt"), 30)
    points = np.array([(proposal.x, proposal.y) for proposal in tried])
    area = area_of(goal_of("igbt"))
    gaps = [area.gauge(area.to_own(points[i] - points[:i])).min() for i in range(1, len(points))]
    assert min(gaps) > 0.5
    assert tried[0].probability > tried[10].probability > tried[29].probability > 0


def test_a_slide_covers_its_ground_without_going_back() -> None:
    slide = proposals(BayesSlide(), goal_of("capacitor"), 1)[0]
    way = np.array([(slide.x, slide.y), *((point.x, point.y) for point in slide.path)])
    steps = np.hypot(*np.diff(way, axis=0).T)
    assert 12 * MM < steps.sum() <= 20 * MM
    apart = np.linalg.norm(way[:, None] - way, axis=2) + np.eye(len(way))
    assert apart.min() > 0.2 * MM
    assert np.hypot(*way.T).max() < 1.8 * MM  # inside out


def test_pecks_where_slides_do_not_pay() -> None:
    goal = goal_of("capacitor")
    assert proposals(BayesSlide(slide_speed=0.05 * MM), goal, 1)[0].path == []
    assert proposals(BayesSlide(push_time=20.0), goal, 1)[0].path == []


def run(strategy: Strategy, name: str, component: str, seed: int, boards: int = 4) -> list[SearchRecord]:
    cell = world(name).cell(component, seed=seed, boards=boards)
    return list(PlainJob(cell, strategy, StatisticalBench(cell), prior=False).searches())


def test_learning_pays() -> None:
    """Four boards of the realistic world: everything is inserted, later boards take a fraction, slides least time."""
    pecks = [record for seed in (1, 2) for record in run(Bayes(), "realistic", "capacitor", seed)]
    slides = [record for seed in (1, 2) for record in run(BayesSlide(), "realistic", "capacitor", seed)]
    assert all(record.seated for record in [*pecks, *slides])
    first = np.mean([record.attempts for record in pecks if record.board == 1])
    last = np.mean([record.attempts for record in pecks if record.board == 4])
    assert last < 0.75 * first
    assert sum(r.search_time for r in slides) < 0.6 * sum(r.search_time for r in pecks)


def test_same_observations_same_candidates_in_another_process() -> None:
    """Whatever was searched before, and whatever was remembered of it."""
    seats = [Seat("s", 1, "h2", 0.2 * MM, 0.1 * MM, 0.22 * MM, 0.11 * MM), Seat("s", 2, "h1", 0, 0, 0.1 * MM, 0.0)]
    code = textwrap.dedent(
        """
        from test_bayes import *
        seats = [Seat("s", 1, "h2", 0.2 * MM, 0.1 * MM, 0.22 * MM, 0.11 * MM), Seat("s", 2, "h1", 0, 0, 0.1 * MM, 0.0)]
        for make in (Bayes, BayesSlide):
            print(proposals(make(), goal_of("igbt", board=3, seats=seats), 5))
        """
    )
    other = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd="tests")
    for strategy in (Bayes(), BayesSlide()):
        proposals(strategy, goal_of("igbt", board=2, seats=seats[:1]), 3)
    again = "".join(f"{proposals(make(), goal_of('igbt', board=3, seats=seats), 5)}\n" for make in (Bayes, BayesSlide))
    assert other.stdout == again


def test_the_memory_of_a_long_past_is_bounded() -> None:
    """Of 200 boards the last 30 to 59 count: an older one changes nothing."""

    def seats(first: float) -> list[Seat]:
        return [Seat("s", board, "h1", 0, 0, first if board < 100 else 0.1 * MM, 0.0) for board in range(1, 201)]

    one = proposals(Bayes(), goal_of("igbt", board=201, seats=seats(0.0)), 3)
    other = proposals(Bayes(), goal_of("igbt", board=201, seats=seats(1.0 * MM)), 3)
    assert repr(one) == repr(other)
