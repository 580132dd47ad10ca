"""What any strategy can reach at best: covers of one hole, and the limits of whole worlds."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from runtime.cell import Board, Hole, Tolerances
from runtime.component import component, feasible_radius
from runtime.experiment.cover import (
    ONE_SIZE,
    Cover,
    Shape,
    bound,
    bound_of,
    fewest,
    normal_density,
    reduced,
    ring_density,
)
from runtime.experiment.cover_table import CoverTable
from runtime.experiment.limit import limits_of, predicted
from runtime.experiment.worlds import WORLDS, NamedWorld
from runtime.world import World

DISC = Shape(np.ones(360))
MM = 1e-3
SKEWED = Board("skewed", (Hole("a", -0.03, 0.01), Hole("b", 0.02, 0.03), Hole("c", 0.01, -0.04)))
EVERYTHING = Tolerances(
    common_error=0.6 * MM,
    board_shift=0.3 * MM,
    board_rotation=8e-3,
    hole_bias=0.2 * MM,
    part_scatter=0.1 * MM,
    abnormal_hole=2,
    abnormal_factor=3.0,
    drift=0.4 * MM,
    jump=0.7 * MM,
    jump_hole=3,
    jump_board=2,
)


@pytest.fixture(scope="module")
def table() -> CoverTable:
    return CoverTable(DISC, ONE_SIZE)


def attempts_by_playing(
    shape: Shape, places: list[tuple[float, float]], holes: np.ndarray, sizes: np.ndarray
) -> np.ndarray:
    """How many attempts each hole (n, 2) of its size (n,) takes; one more than there are places if none finds it."""
    needed = np.full(len(holes), len(places) + 1)
    for number, (x, y) in reversed(list(enumerate(places, 1))):
        needed[shape.depth(holes[:, 0] - x, holes[:, 1] - y, sizes) > 0] = number
    return needed


@pytest.mark.parametrize(("width", "known"), [(0.5, 1.29), (1.0, 3.23), (2.0, 10.45), (3.0, 22.58)])
def test_no_cover_of_one_hole_is_worse_than_the_best_ones_found_by_random_search(
    table: CoverTable, width: float, known: float
) -> None:
    found = table.fewest((width, width))
    assert 0.95 * known < found < 1.01 * known


@pytest.mark.parametrize(("wide", "narrow"), [(0.6, 0.6), (1.3, 0.8)])
def test_a_cover_played_against_draws_takes_as_many_attempts_as_it_says(wide: float, narrow: float) -> None:
    squashed = Shape(1.0 + 0.1 * np.cos(4 * np.linspace(0.0, 2 * math.pi, 360, endpoint=False)))
    for shape in (DISC, squashed):
        cover = fewest(shape, normal_density(wide, narrow))
        holes = np.random.default_rng(1).standard_normal((40_000, 2)) * [wide, narrow]
        needed = attempts_by_playing(shape, cover.places, holes, np.ones(len(holes)))
        assert abs(needed.mean() - cover.expected) < 3 * needed.std() / math.sqrt(len(needed)) + 2e-3 * cover.expected


@pytest.mark.parametrize(
    ("wide", "narrow", "sizes"),
    [
        (0.9, 0.9, {0.88: 0.5, 1.12: 0.5}),
        (0.7, 0.5, {0.7: 0.2, 1.0: 0.6, 1.2: 0.2}),
        (1.2, 1.0, {0.88: 0.5, 1.12: 0.5}),
    ],
)
def test_not_to_know_the_size_costs_attempts_but_less_than_to_guess_it(
    wide: float, narrow: float, sizes: dict[float, float]
) -> None:
    density = normal_density(wide, narrow)
    found = fewest(DISC, density, sizes)
    known = {size: fewest(DISC, density, {size: 1.0}) for size in sizes}
    assert found.expected > sum(share * known[size].expected for size, share in sizes.items())
    assert found.expected > sum(share * bound(math.sqrt(wide * narrow) / size) for size, share in sizes.items())
    for guess in known.values():
        played = Cover(DISC, density, sizes)
        for place in guess.places:
            played.lay(*place)
        assert found.expected <= 1.005 * played.finish().expected  # both come from local searches
    random = np.random.default_rng(2)
    holes = random.standard_normal((40_000, 2)) * [wide, narrow]
    needed = attempts_by_playing(DISC, found.places, holes, random.choice(list(sizes), 40_000, p=list(sizes.values())))
    assert abs(needed.mean() - found.expected) < 3 * needed.std() / math.sqrt(len(needed)) + 2e-3 * found.expected


@given(st.dictionaries(st.floats(0.3, 1.8).map(lambda size: round(size, 2)), st.floats(0.05, 1.0), min_size=5))
def test_fewer_sizes_have_the_moments_of_many(weights: dict[float, float]) -> None:
    sizes = {size: weight / sum(weights.values()) for size, weight in weights.items()}
    few = reduced(sizes, 3)
    assert len(few) == 3
    for power in range(6):
        moments = [sum(share * size**power for size, share in some.items()) for some in (sizes, few)]
        assert moments[1] == pytest.approx(moments[0], rel=1e-6)


@settings(deadline=None)
@given(st.floats(0.02, 12.0), st.floats(1.0, 1.6))
def test_the_bound_is_never_above_the_best_cover(table: CoverTable, width: float, ratio: float) -> None:
    least, found = bound(width), table.fewest((width * math.sqrt(ratio), width / math.sqrt(ratio)))
    assert 1.0 <= least <= found <= 1.35 * least


@settings(max_examples=8, deadline=None)
@given(st.floats(0.25, 1.8), st.floats(1.0, 1.6))
def test_the_table_interpolates_what_it_stands_for(table: CoverTable, width: float, ratio: float) -> None:
    wide, narrow = width * math.sqrt(ratio), width / math.sqrt(ratio)
    assert table.fewest((wide, narrow)) <= 1.02 * Cover(DISC, normal_density(wide, narrow)).finish().expected


@given(st.floats(0.3, 2.0), st.floats(0.3, 2.0))
@settings(max_examples=15, deadline=None)
def test_the_bound_of_any_density_is_that_of_a_normal_one_for_a_normal_one(wide: float, narrow: float) -> None:
    density = normal_density(wide, narrow)
    assert bound_of(density, math.pi) == pytest.approx(bound(math.sqrt(wide * narrow)), rel=0.01)


def test_a_ring_has_the_moments_of_its_parts() -> None:
    circle, covariance = np.array([[2.0, 0.3], [0.0, 1.0]]), np.array([[0.5, 0.1], [0.1, 0.3]])
    density = ring_density(circle, covariance)
    x, y = np.meshgrid(density.x, density.y, indexing="ij")
    points = np.stack([x, y])
    moments = np.einsum("inm,jnm,nm->ij", points, points, density.mass)
    assert moments == pytest.approx(circle @ circle.T / 2 + covariance, rel=2e-3)


def joint_covariance(board: Board, tolerances: Tolerances, boards: int) -> np.ndarray:
    """Of all offsets in their order, (2 n, 2 n), written down error by error."""
    places = [(b, h) for b in range(1, boards + 1) for h in range(len(board.holes))]
    joint = np.zeros((2 * len(places), 2 * len(places)))
    for i, (b, h) in enumerate(places):
        for j, (c, k) in enumerate(places):
            lever, other = (np.array([-board.holes[n].y, board.holes[n].x]) for n in (h, k))
            jumped = h == k == tolerances.jump_hole - 1 and min(b, c) >= tolerances.jump_board
            round_ = (
                tolerances.common_error**2 + (b - 1) * (c - 1) * tolerances.drift**2 + jumped * tolerances.jump**2
            ) / 2
            round_ += (b == c) * tolerances.board_shift**2 + (h == k) * tolerances.hole_bias**2
            factor = tolerances.abnormal_factor if h + 1 == tolerances.abnormal_hole else 1.0
            round_ += (i == j) * (factor * tolerances.part_scatter) ** 2
            block = round_ * np.eye(2) + (b == c) * tolerances.board_rotation**2 * np.outer(lever, other)
            joint[2 * i : 2 * i + 2, 2 * j : 2 * j + 2] = block
    return joint


def given_the_earlier(joint: np.ndarray, index: int) -> tuple[np.ndarray, np.ndarray]:
    """Weights (2, 2 index) of the earlier offsets in the mean of the next one, and its covariance (2, 2)."""
    past, now = slice(0, 2 * index), slice(2 * index, 2 * index + 2)
    weights = np.linalg.solve(joint[past, past], joint[past, now]).T
    return weights, joint[now, now] - weights @ joint[past, now]


def test_the_filter_is_conditioning_on_everything_earlier() -> None:
    joint = joint_covariance(SKEWED, EVERYTHING, 3)
    covariances = predicted(SKEWED, EVERYTHING, 3).covariance.reshape(-1, 2, 2)
    for index, covariance in enumerate(covariances):
        assert covariance == pytest.approx(given_the_earlier(joint, index)[1], rel=1e-6, abs=1e-14)


def test_the_covariances_are_those_of_the_drawn_worlds() -> None:
    boards, holes, count = 2, len(SKEWED.holes), 4000
    offsets = np.zeros((count, boards * holes, 2))
    for seed in range(count):
        world = World(SKEWED, component("capacitor"), EVERYTHING, seed)
        for index in range(boards * holes):
            offsets[seed, index] = world.offset(index + 1, index // holes + 1, SKEWED.holes[index % holes].name)
    covariances = predicted(SKEWED, EVERYTHING, boards).covariance.reshape(-1, 2, 2)
    ratios = []
    for index, covariance in enumerate(covariances):
        past, now = offsets[:, :index].reshape(count, -1), offsets[:, index]
        rest = now - past @ np.linalg.lstsq(past, now, rcond=None)[0] if index else now
        root = np.linalg.inv(np.linalg.cholesky(covariance))
        ratios.append(root @ (rest.T @ rest / (count - 2 * index)) @ root.T)
    assert np.array(ratios) == pytest.approx(np.broadcast_to(np.eye(2), (boards * holes, 2, 2)), abs=0.09)
    assert np.trace(ratios, axis1=1, axis2=2).mean() / 2 == pytest.approx(1.0, abs=0.02)


@cache
def greedy(wide: float, narrow: float) -> np.ndarray:
    return np.array(Cover(DISC, normal_density(wide, narrow, min(0.1, narrow / 4))).finish().places)


def test_a_strategy_that_knows_the_model_and_all_seats_does_not_beat_the_bound() -> None:
    name, boards, seeds = "capacitor", 2, 120
    known = replace(WORLDS["realistic"].tolerances, hole_radius=0.0, part_rotation=0.0, board_rotation=0.0)
    place = NamedWorld("one size of hole", "", known)
    tolerances, board = place.tolerances, place.cell(name, seed=0).board
    radius = feasible_radius(component(name))
    joint, holes = joint_covariance(board, tolerances, boards), len(board.holes)
    worlds = [World(board, component(name), tolerances, seed) for seed in range(seeds)]
    gaps = [
        [world.gap(i + 1, i // holes + 1, board.holes[i % holes].name) for i in range(boards * holes)]
        for world in worlds
    ]
    seats = np.array([[(gap.x, gap.y) for gap in row] for row in gaps]).reshape(seeds, -1)
    needed = np.zeros((seeds, boards * holes))
    for index in range(boards * holes):
        weights, covariance = given_the_earlier(joint, index)
        variances, axes = np.linalg.eigh(covariance / radius**2)
        steps = radius * greedy(*np.sqrt(variances[::-1])) @ axes[:, ::-1].T
        for seed in range(seeds):
            tried = weights @ seats[seed, : 2 * index] + steps
            hits = (n for n, (x, y) in enumerate(tried, 1) if gaps[seed][index].feasible(float(x), float(y)))
            needed[seed, index] = next(hits, len(tried))
    limits = limits_of(place, name, boards)
    mean, error = needed.mean(), needed.mean(axis=1).std() / math.sqrt(seeds)
    assert mean > limits.bound
    assert abs(mean / limits.estimate - 1.05) < 0.05 + 3 * error / limits.estimate


@pytest.mark.parametrize(("name", "hole_radius"), [("paper-capacitor", 0.025), ("off-wide", 0.0)])
def test_in_every_world_the_bound_lies_between_the_oracle_and_the_estimate(name: str, hole_radius: float) -> None:
    one_turn = replace(WORLDS[name].tolerances, part_rotation=0.0, board_rotation=0.0, hole_radius=hole_radius * MM)
    limits = limits_of(replace(WORLDS[name], tolerances=one_turn), "capacitor", 1)
    assert limits.oracle == 1.0
    assert 1.0 <= limits.bound <= limits.estimate <= 1.7 * limits.bound
    assert np.all(np.array(limits.bounds) <= np.array(limits.estimates))


def test_where_there_is_no_estimate() -> None:
    heavy, board = limits_of(WORLDS["off-heavy-tails"], "capacitor", 1), limits_of(WORLDS["off-board"], "capacitor", 1)
    assert math.isnan(heavy.estimate)
    assert heavy.bound >= 1.0
    assert math.isnan(board.bound)
    assert math.isnan(board.estimate)


def test_looser_worlds_have_higher_limits() -> None:
    tight = NamedWorld("tight", "", Tolerances(board_shift=0.05 * MM, hole_bias=0.05 * MM))
    loose = NamedWorld("loose", "", Tolerances(board_shift=0.1 * MM, hole_bias=0.05 * MM))
    assert limits_of(tight, "capacitor", 1).estimate < limits_of(loose, "capacitor", 1).estimate


def test_holes_too_tight_for_any_part_take_for_ever() -> None:
    blocked = NamedWorld("blocked", "", Tolerances(part_rotation=0.2))
    limits = limits_of(blocked, "capacitor", 1)
    assert math.isfinite(limits.bound)
    assert limits.estimate == math.inf
