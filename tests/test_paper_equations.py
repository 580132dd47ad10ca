"""The paper's equations, point by point: as printed against hand-computed values, corrected against other mathematics.

Numbers are those that LaTeX gives them. What is wrong with an equation as printed is shown by a test of its own.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from itertools import islice

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.integrate import dblquad
from scipy.optimize import minimize
from search_world import goal_for

from runtime.belief import (
    Array,
    covariance_of,
    disc_mass,
    disc_mass_gradient,
    gaussian,
    isotropic,
    maximum_a_posteriori,
    maximum_a_posteriori_as_printed,
    maximum_likelihood,
    mean_of,
)
from runtime.errors import InputError
from runtime.messages import Gaussian, Proposal, SearchGoal, Seat
from runtime.plugin import Strategy
from strategies.covers import Force, plan_covers, repulsion_gradient
from strategies.hybrid import Hybrid
from strategies.linear import Linear
from strategies.meta import Meta
from strategies.patterns import line, line_as_printed, spiral_as_printed, spiral_by_angle, spiral_by_arc
from strategies.spiral import Spiral

MM = 1e-3
UNIT_PRIOR = isotropic((0, 0), 1.0)
SLANTED = gaussian((0.1, -0.2), [[0.3, 0.1], [0.1, 0.2]])
CENTRE = np.array([0.5, 0.3])
RADIUS = 0.25
coordinates = st.tuples(st.floats(-1, 1), st.floats(-1, 1))
clouds = st.lists(coordinates, min_size=3, max_size=7)


def tried(strategy: Strategy, goal: SearchGoal) -> np.ndarray:
    """Proposals (n, 2) [mm] while nothing is found, as many as the goal allows."""
    proposals: list[Proposal] = list(islice(strategy.search(goal), goal.max_attempts))
    return np.array([(p.x, p.y) for p in proposals]) / MM


def slope(function: Callable[[Array], float], at: Array, step: float = 1e-5) -> Array:
    """Gradient of a function of an array, by central differences."""
    result = np.zeros_like(at)
    for index in np.ndindex(at.shape):
        side = np.zeros_like(at)
        side[index] = step
        result[index] = (function(at + side) - function(at - side)) / (2 * step)
    return result


# Line and spiral.


def test_line_is_eqs_10_and_11() -> None:
    assert [p[0] for p in line(1.0, 0.0, 5)] == pytest.approx([0, -1, 1, -2, 2, -3])
    slanted = list(line(2.0, math.pi / 6, 2))
    assert slanted[1] == pytest.approx((-2 * math.sqrt(3) / 2, -2 * 0.5))
    assert slanted[2] == pytest.approx((2 * math.sqrt(3) / 2, 2 * 0.5))
    successive = np.linalg.norm(np.diff(list(line(0.3, 1.0, 6)), axis=0), axis=1)
    assert successive == pytest.approx(0.3 * np.arange(1, 7))  # the text says 0.3 throughout


def test_linear_tries_m_cycles_and_caps_its_stride_only_if_corrected() -> None:
    goal = goal_for(feasible_radius=0.2 * MM)
    wide = Linear(stride=0.5 * MM, angle=0.0, cycles=3)
    assert tried(wide, goal)[:, 0] == pytest.approx([0, -0.32, 0.32, -0.64])
    assert tried(dataclasses.replace(wide, variant="literal"), goal)[:, 0] == pytest.approx([0, -0.5, 0.5, -1.0])


QUARTERS = [(0, 0), (0, 0.125), (-0.25, 0), (0, -0.375), (0.5, 0), (0, 0.625)]


def test_spiral_is_eqs_12_to_17() -> None:
    """r = 2 in t = 4 turns, theta_d = 90 deg: r_d = 2 / 1440 per degree, so 0.125 further out at each quarter turn."""
    points = list(spiral_by_angle(math.pi / 2, pitch=2 / 4, radius=2.0))
    assert len(points) == 17
    assert points[:6] == pytest.approx(np.array(QUARTERS), abs=1e-12)
    assert points[-1] == pytest.approx((2.0, 0.0), abs=1e-12)


def test_spiral_takes_the_papers_r_t_and_theta_d() -> None:
    spiral = Spiral(radius=2 * MM, turns=4.0, step=math.pi / 2, variant="literal")
    points = tried(spiral, goal_for())
    assert len(points) == 17
    assert points[:6] == pytest.approx(np.array(QUARTERS), abs=1e-9)
    same = Spiral(radius=2 * MM, pitch=0.5 / 0.2, step=math.pi / 2, variant="literal")
    assert tried(same, goal_for(feasible_radius=0.2 * MM)) == pytest.approx(points)


@given(st.integers(1, 60), st.integers(1, 9), st.floats(0.3, 3.0))
def test_spiral_ends_at_its_last_turn(per_turn: int, turns: int, radius: float) -> None:
    """theta_mx = t * 360 deg is part of the search, whatever rounding says."""
    points = list(spiral_by_angle(2 * math.pi / per_turn, radius / turns, radius))
    assert len(points) == turns * per_turn + 1
    assert math.hypot(*points[-1]) == pytest.approx(radius)


# Hybrid: three descriptions, as printed and corrected.


def test_eq_18_oscillates_and_eqs_19_to_22_drift() -> None:
    assert [p[0] for p in line_as_printed(1.0, 0.0, 5)] == pytest.approx([0, -1, 0, -1, 0, -1])
    points = list(spiral_as_printed(math.pi / 2, pitch=4.0, radius=4.0))  # r_i = i
    assert points == pytest.approx(np.array([(0, 0), (0, 1), (-2, 1), (-2, -2), (2, -2)]), abs=1e-12)


HYBRID = Hybrid(stride=0.4 * MM, angle=0.0, cycles=2, radius=0.5 * MM, pitch=2.5, step=math.pi / 2)
ALONG = [(0, 0), (-0.4, 0), (0.4, 0)]  # Eqs. 10-11
AROUND = QUARTERS[1:5]  # 0.5 mm a turn, 90 deg a step, to 0.5 mm
DRIFT = [(0, 0.125), (-0.25, 0.125), (-0.25, -0.25), (0.25, -0.25)]  # the same radii and angles, added up
CAPPED = [(0, 0), (-0.32, 0), (0.32, 0)]  # 1.6 feasible radii


@pytest.mark.parametrize(
    ("description", "expected"),
    [
        ("experiments", [ALONG[0], ALONG[1], AROUND[0], ALONG[2], *AROUND[1:]]),
        ("algorithm", 2 * [*ALONG, *AROUND] + [*ALONG, *AROUND][:6]),  # it loops until 20 attempts are spent
        ("equations", [(0, 0), (-0.4, 0), (0, 0), *DRIFT]),
    ],
)
def test_hybrid_as_printed(description: str, expected: list[tuple[float, float]]) -> None:
    literal = dataclasses.replace(HYBRID, description=description, variant="literal")
    goal = goal_for(feasible_radius=0.2 * MM, max_attempts=20)
    assert tried(literal, goal) == pytest.approx(np.array(expected), abs=1e-9)


def test_hybrid_corrected() -> None:
    goal = goal_for(feasible_radius=0.2 * MM, max_attempts=2000)
    even = list(spiral_by_arc(0.3, 0.5, 0.5))[1:]
    expected = {
        "experiments": [CAPPED[0], CAPPED[1], even[0], CAPPED[2], *even[1:]],
        "algorithm": [*CAPPED, *even],
        "equations": [*CAPPED, *AROUND],
    }
    for description, points in expected.items():
        hybrid = dataclasses.replace(HYBRID, description=description)
        assert tried(hybrid, goal) == pytest.approx(np.array(points), abs=1e-9), description


def test_hybrid_is_made_of_linear_and_spiral() -> None:
    goal = goal_for()
    along, around = tried(Linear(), goal), tried(Spiral(), goal)
    mixed = tried(Hybrid(), goal)
    assert mixed[1:11:2] == pytest.approx(along[1:6])
    assert mixed[2:12:2] == pytest.approx(around[1:6])
    sequence = tried(Hybrid(description="algorithm"), goal)
    assert sequence == pytest.approx(np.concatenate([along, around[1:]])[: len(sequence)])


# Gaussian, likelihood (Eqs. 23-27).


def density(belief: Gaussian, x: Array) -> Array:
    """Eq. 34's integrand at x (..., 2)."""
    d, precision = x - mean_of(belief), np.linalg.inv(covariance_of(belief))
    constant = 2 * math.pi * math.sqrt(np.linalg.det(covariance_of(belief)))
    return np.asarray(np.exp(-0.5 * np.einsum("...i,ij,...j", d, precision, d)) / constant)


def test_the_density_of_eq_34_is_one_in_all_and_the_unnumbered_one_is_not() -> None:
    total, _ = dblquad(lambda y, x: float(density(SLANTED, np.array([x, y]))), -5, 5, -5, 5, epsabs=1e-7)
    assert total == pytest.approx(1, abs=1e-5)
    determinant = np.linalg.det(covariance_of(SLANTED))
    unnumbered = total * (2 * math.pi * math.sqrt(determinant)) / math.sqrt(2 * math.pi * determinant)
    assert unnumbered == pytest.approx(math.sqrt(2 * math.pi), abs=1e-4)
    assert disc_mass(SLANTED, (0.1, -0.2), 5.0)[0] == pytest.approx(1, abs=1e-6)


def log_likelihood(points: Array, mean: Array, covariance: Array) -> float:
    """Eq. 23, summed."""
    d = points - mean
    quadratic = np.einsum("ni,ij,nj", d, np.linalg.inv(covariance), d)
    return float(-0.5 * len(points) * np.linalg.slogdet(covariance)[1] - 0.5 * quadratic)


def test_eqs_24_and_25_have_wrong_signs() -> None:
    x, mean, covariance = np.array([[0.7, 0.4]]), mean_of(SLANTED), covariance_of(SLANTED)
    precision, d = np.linalg.inv(covariance), x[0] - mean
    true = slope(lambda m: log_likelihood(x, m, covariance), mean)
    assert true == pytest.approx(precision @ d, rel=1e-6)  # Eq. 24: minus
    true = slope(lambda p: log_likelihood(x, mean, np.linalg.inv((p + p.T) / 2)), precision)
    assert true == pytest.approx(covariance / 2 - np.outer(d, d) / 2, abs=1e-6)  # Eq. 25: -S/2 - d d^T / 2
    zero_of_eq_25 = -np.outer(d, d)
    assert np.linalg.eigvalsh(zero_of_eq_25)[0] < 0


@given(clouds, coordinates, st.floats(0.8, 1.25))
@example([(0, 0), (1, 0), (0, 1)], (0.1, 0), 1.0)
def test_eqs_26_and_27_are_the_maximum_all_the_same(
    points: list[tuple[float, float]], nudge: tuple[float, float], scale: float
) -> None:
    p = np.array(points)
    best = maximum_likelihood(p, UNIT_PRIOR)
    mean, covariance = mean_of(best), covariance_of(best) + 1e-9 * np.eye(2)  # points may lie on a line
    top = log_likelihood(p, mean, covariance)
    assert log_likelihood(p, mean + 0.1 * np.array(nudge), covariance) <= top + 1e-6
    if np.linalg.eigvalsh(covariance)[0] > 1e-3:
        assert log_likelihood(p, mean, scale * covariance) <= top + 1e-6


# Maximum a posteriori (Eqs. 28-30).


def eq_28(points: Array, mean: Array, covariance: Array, mean_penalty: float, covariance_penalty: float) -> float:
    """Eq. 28 summed over points, prior mean 0."""
    return (
        log_likelihood(points, mean, covariance)
        - mean_penalty / 2 * float(mean @ mean)
        - covariance_penalty / 4 * float(((covariance - np.eye(2)) ** 2).sum())
    )


@given(clouds, st.floats(0.1, 5), st.floats(0.1, 30))
@settings(deadline=None)
@example([(0.5, 0.5)] * 3, 1.0, 13.0)  # the same point three times
@example([(0.5, 0.1), (0.52, 0.1), (0.51, 0.12)], 1.0, 2.0)
def test_gradient_of_eq_28_vanishes_where_the_literal_update_goes(
    points: list[tuple[float, float]], mean_penalty: float, covariance_penalty: float
) -> None:
    p = np.array(points)
    belief = maximum_a_posteriori_as_printed(p, UNIT_PRIOR, mean_penalty, covariance_penalty)
    mean, covariance = mean_of(belief), covariance_of(belief)
    narrow = np.linalg.eigvalsh(covariance)[0]
    if belief == maximum_likelihood(p, UNIT_PRIOR):
        assert narrow < 1e-6  # only points on a line have no stationary point
        return
    d, precision, m = p - mean, np.linalg.inv(covariance), len(p)
    by_mean = precision @ d.sum(axis=0) - mean_penalty * mean
    by_covariance = (
        -m * precision + precision @ (d.T @ d) @ precision - covariance_penalty * (covariance - np.eye(2))
    ) / 2
    assert by_mean * narrow == pytest.approx([0, 0], abs=1e-8)
    assert by_covariance * narrow == pytest.approx(np.zeros((2, 2)), abs=1e-7)
    if narrow > 0.01:  # and these are its gradients
        step = 1e-6
        assert slope(lambda u: eq_28(p, u, covariance, mean_penalty, covariance_penalty), mean, step) == pytest.approx(
            by_mean, abs=1e-4
        )
        found = slope(lambda c: eq_28(p, mean, c, mean_penalty, covariance_penalty), covariance, step)
        assert found == pytest.approx(by_covariance, abs=1e-3)
        side = 0.01 * narrow
        top = eq_28(p, mean, covariance, mean_penalty, covariance_penalty)
        for nudge in (np.diag([side, 0]), np.diag([0, side]), side * np.array([[0, 1], [1, 0]])):
            for sign in (-1, 1):
                assert eq_28(p, mean, covariance + sign * nudge, mean_penalty, covariance_penalty) < top


def test_eq_28_by_hand() -> None:
    """Four points +-a on each axis: mean 0, s = 2 a^2 = 1/2 on both axes, and v^3 - v^2 + 2 v - 1/4 = 0 for l2 = 2."""
    p = np.array([(0.5, 0), (-0.5, 0), (0, 0.5), (0, -0.5)])
    belief = maximum_a_posteriori_as_printed(p, UNIT_PRIOR, 1.0, 2.0)
    assert mean_of(belief) == pytest.approx([0, 0], abs=1e-12)
    assert covariance_of(belief) == pytest.approx(0.13263 * np.eye(2), abs=5e-6)
    assert belief.xx**3 - belief.xx**2 + 2 * belief.xx == pytest.approx(1 / 4, rel=1e-12)


def test_eq_28_has_no_maximum_for_one_point() -> None:
    x = np.array([[0.7, 0.4]])
    values = [eq_28(x, x[0], width**2 * np.eye(2), 1.0, 2.0) for width in (1, 1e-1, 1e-2, 1e-3)]
    assert (np.diff(values) > 3).all()  # 2 log 10 a decade, for ever
    assert maximum_a_posteriori_as_printed(x, UNIT_PRIOR, 1.0, 2.0) == UNIT_PRIOR
    same = np.repeat(x, 4, axis=0)
    collapsed = maximum_a_posteriori_as_printed(same, UNIT_PRIOR, 1.0, 2.0)
    assert collapsed == maximum_likelihood(same, UNIT_PRIOR)
    assert mean_of(collapsed) == pytest.approx(x[0])
    assert covariance_of(collapsed) == pytest.approx(np.zeros((2, 2)))


def test_strong_penalties_keep_a_stationary_point_for_one_point() -> None:
    """Across x no scatter: 8 v^2 - 8 v + 1 = 0, the greater root (2 + sqrt 2) / 4 is a maximum, the other is not."""
    x = np.array([[0.6, 0.0]])
    belief = maximum_a_posteriori_as_printed(x, UNIT_PRIOR, 1.0, 8.0)
    across = (2 + math.sqrt(2)) / 4
    assert belief.yy == pytest.approx(across)
    assert belief.xy == pytest.approx(0, abs=1e-12)
    along = belief.xx
    assert (1 + along) * belief.x == pytest.approx(0.6)  # (m I + l1 S) mu = m x
    assert 8 * along**3 - 8 * along**2 + along - (0.6 - belief.x) ** 2 == pytest.approx(0, abs=1e-12)
    assert (belief.x, belief.y) == pytest.approx((0.6 / (1 + along), 0))
    assert maximum_a_posteriori_as_printed(x, UNIT_PRIOR, 1.0, 3.9) == UNIT_PRIOR  # l2 < 4 m: no root across


@given(clouds, st.floats(0.2, 2), st.floats(0.5, 20))
@settings(max_examples=20, deadline=None)
@example([(0.9, 0.8), (0.7, 0.9), (0.8, 0.6)], 1.0, 2.0)
def test_ascent_on_eq_28_ends_where_the_literal_update_goes(
    points: list[tuple[float, float]], mean_penalty: float, covariance_penalty: float
) -> None:
    p = np.array(points)
    belief = maximum_a_posteriori_as_printed(p, UNIT_PRIOR, mean_penalty, covariance_penalty)
    if np.linalg.eigvalsh(covariance_of(belief))[0] < 0.01:
        return

    def unpacked(z: Array) -> tuple[Array, Array]:
        lower = np.array([[math.exp(z[2]), 0], [z[3], math.exp(z[4])]])
        return z[:2], lower @ lower.T

    def descent(z: Array) -> float:
        return -eq_28(p, *unpacked(z), mean_penalty, covariance_penalty)

    lower = np.linalg.cholesky(covariance_of(belief))
    near = np.array([*mean_of(belief), math.log(lower[0, 0]), lower[1, 0], math.log(lower[1, 1])]) + 0.02
    mean, covariance = unpacked(minimize(descent, near, method="BFGS").x)
    assert mean == pytest.approx(mean_of(belief), abs=1e-3)
    assert covariance == pytest.approx(covariance_of(belief), abs=1e-3)


def test_the_literal_update_is_in_units_of_the_prior() -> None:
    p = np.array([(0.4, 0.1), (0.6, -0.3), (0.2, 0.5), (0.9, 0.2)])
    plain = maximum_a_posteriori_as_printed(p, UNIT_PRIOR, 1.0, 2.0)
    prior = isotropic((2 * MM, -MM), 0.5 * MM)
    scaled = maximum_a_posteriori_as_printed(mean_of(prior) + 0.5 * MM * p, prior, 1.0, 2.0)
    assert mean_of(scaled) == pytest.approx(mean_of(prior) + 0.5 * MM * mean_of(plain))
    assert covariance_of(scaled) == pytest.approx((0.5 * MM) ** 2 * covariance_of(plain))


def test_eqs_29_and_30_are_not_the_gradients_of_eq_28() -> None:
    x, mean, covariance = np.array([[0.7, 0.4]]), mean_of(SLANTED), covariance_of(SLANTED)
    precision, d, one = np.linalg.inv(covariance), x[0] - mean, np.eye(2)
    true = slope(lambda m: eq_28(x, m, covariance, 1.0, 2.0), mean)
    assert true == pytest.approx(precision @ d - mean, rel=1e-6)
    printed = -precision @ d - mean
    assert np.abs(true - printed).max() > 1
    true = slope(lambda p: eq_28(x, mean, np.linalg.inv((p + p.T) / 2), 1.0, 2.0), precision)
    chain = covariance @ (covariance - one) @ covariance
    assert true == pytest.approx((covariance - np.outer(d, d)) / 2 + chain, abs=1e-6)  # l2 / 2 = 1
    printed = -(covariance + np.outer(d, d)) / 2 - (covariance - one)
    assert np.abs(true - printed).max() > 0.5


@given(clouds, st.floats(0.2, 3), st.floats(1, 6))
@settings(max_examples=20, deadline=None)
def test_the_corrected_update_is_what_numerical_maximisation_finds(
    points: list[tuple[float, float]], mean_count: float, covariance_count: float
) -> None:
    """Log density of mean and covariance, normal-inverse-Wishart, written with pseudo-counts."""
    p, prior = np.array(points), SLANTED
    best = maximum_a_posteriori(p, prior, mean_count, covariance_count)

    def descent(z: Array) -> float:
        lower = np.array([[math.exp(z[2]), 0], [z[3], math.exp(z[4])]])
        covariance, shift = lower @ lower.T, z[:2] - mean_of(prior)
        precision = np.linalg.inv(covariance)
        prior_part = covariance_count * np.trace(covariance_of(prior) @ precision)
        prior_part += covariance_count * np.linalg.slogdet(covariance)[1] + mean_count * shift @ precision @ shift
        return float(0.5 * prior_part - log_likelihood(p, z[:2], covariance))

    z = minimize(descent, np.array([0.0, 0.0, -0.5, 0.0, -0.5]), method="BFGS").x
    lower = np.array([[math.exp(z[2]), 0], [z[3], math.exp(z[4])]])
    assert z[:2] == pytest.approx(mean_of(best), abs=1e-3)
    assert lower @ lower.T == pytest.approx(covariance_of(best), abs=1e-3)


# Mass of a disc and its gradient (Eqs. 31-43).


def disc() -> tuple[Array, float]:
    """Points (n, 2) spread evenly over a disc about 0, and the area for each."""
    index = np.arange(100_000) + 0.5
    away, angle = RADIUS * np.sqrt(index / len(index)), index * math.pi * (3 - math.sqrt(5))
    return np.stack([away * np.cos(angle), away * np.sin(angle)], axis=1), math.pi * RADIUS**2 / len(index)


def test_eq_31_has_the_wrong_sign() -> None:
    z, area = disc()
    x = CENTRE + z
    weighted = (x - mean_of(SLANTED)) * density(SLANTED, x)[:, None]
    eq_31 = np.linalg.inv(covariance_of(SLANTED)) @ weighted.sum(axis=0) * area
    true = slope(lambda c: float(disc_mass(SLANTED, c, RADIUS)[0]), CENTRE)
    assert eq_31 / true == pytest.approx([-1, -1], abs=1e-3)
    assert disc_mass_gradient(SLANTED, CENTRE, RADIUS)[0] == pytest.approx(true, rel=1e-6)


def test_ascent_along_eq_31_walks_away_from_the_mean() -> None:
    """Why its literal sign is not offered: it can only lose what it climbs for."""
    walker, climber = CENTRE.copy(), CENTRE.copy()
    for _ in range(400):
        walker -= disc_mass_gradient(SLANTED, walker, RADIUS)[0]
        climber += disc_mass_gradient(SLANTED, climber, RADIUS)[0]
    assert disc_mass(SLANTED, walker, RADIUS)[0] < 0.02 * disc_mass(SLANTED, CENTRE, RADIUS)[0]
    assert climber == pytest.approx(mean_of(SLANTED), abs=1e-4)


@pytest.mark.parametrize("of", ["covariance", "precision"])
def test_eq_40_holds_for_no_single_meaning_of_lambda(of: str) -> None:
    z, area = disc()
    variances, axes = np.linalg.eigh(covariance_of(SLANTED))
    eigenvalues = variances if of == "covariance" else 1 / variances
    y = (CENTRE + z - mean_of(SLANTED)) @ axes
    integral = (y * np.exp(-0.5 * (y**2 * eigenvalues).sum(axis=1))[:, None]).sum(axis=0) * area
    printed = axes @ np.diag(eigenvalues) @ integral / (2 * math.pi * math.sqrt(eigenvalues.prod()))
    true = disc_mass_gradient(SLANTED, CENTRE, RADIUS)[0]
    assert np.abs(printed / true - 1).max() > 0.5
    assert np.abs(printed / true + 1).max() > 0.5  # nor is it the sign alone


# Covers (Eqs. 44-47).


def penalty(force: Force, centres: Array, radius: float, repulsion: float, unit: float) -> float:
    """The part of F that Eq. 47 sums over covers beside their masses, from the equations."""
    n, total = len(centres), 0.0
    for i in range(n):
        for j in range(n):
            squared = float(((centres[i] - centres[j]) ** 2).sum())
            if force == "eq_45" and i != j:
                total += repulsion / (n - 1) * max(squared - radius * unit, 0.0)
            if force == "hinge" and i != j:
                total -= repulsion / (n - 1) * max((2 * radius) ** 2 - squared, 0.0)
            if force == "overlap" and i != j:
                total -= repulsion / (n - 1) * max(2 * radius - math.sqrt(squared), 0.0) ** 2
        if force == "eq_46":
            total += repulsion * float(((centres[i] - centres.mean(axis=0)) ** 2).sum())
    return total


@pytest.mark.parametrize("force", ["overlap", "hinge", "eq_45", "eq_46"])
def test_forces_are_the_slopes_of_what_they_maximise(force: Force) -> None:
    centres = np.random.default_rng(3).normal(0, 0.4, (6, 2))
    radius, repulsion, unit = 0.3, 0.7, 0.5
    found = repulsion_gradient(force, centres, radius, repulsion, unit)
    assert np.abs(found).max() > 0.1
    assert found == pytest.approx(slope(lambda c: penalty(force, c, radius, repulsion, unit), centres), abs=1e-6)


def test_eq_45_by_hand() -> None:
    """Three covers on a line at 0, 1 and 3, lambda 0.5: pairs with d^2 > eps = 2 flee, twice 0.5 / 2 * 2 d each."""
    centres = np.array([(0.0, 0.0), (1.0, 0.0), (3.0, 0.0)])
    assert repulsion_gradient("eq_45", centres, 2.0, 0.5, 1.0)[:, 0] == pytest.approx([-3, -2, 5])
    # In a unit of half the size the same eps is 4, and 4 of the new units squared are 1 of the old: d = 1 is at rest.
    assert repulsion_gradient("eq_45", centres, 2.0, 0.5, 0.45)[:, 0] == pytest.approx([-4, -1, 5])
    # What overlaps is left alone, what is apart flees: the hinge does the opposite.
    assert repulsion_gradient("hinge", centres, 0.6, 0.5, 1.0)[:, 0] == pytest.approx([-1, 1, 0])
    assert repulsion_gradient("overlap", centres, 0.6, 0.5, 1.0)[:, 0] == pytest.approx([-0.2, 0.2, 0])
    # Eq. 46: 2 lambda (m_i - 4/3).
    assert repulsion_gradient("eq_46", centres, 9.0, 0.5, 1.0)[:, 0] == pytest.approx([-4 / 3, -1 / 3, 5 / 3])


def test_eq_46_has_only_an_unstable_equilibrium() -> None:
    """A ring of covers: inside one radius all are drawn together, outside of it all are driven off."""
    belief, repulsion = isotropic((0, 0), 1.0), 0.01
    angles = 2 * math.pi * np.arange(6) / 6
    ring = np.stack([np.cos(angles), np.sin(angles)], axis=1)

    def outward(size: float) -> float:
        centres = size * ring
        force = disc_mass_gradient(belief, centres, 0.5) + repulsion_gradient("eq_46", centres, 0.5, repulsion, 1.0)
        return float((force * ring).sum() / len(ring))

    signs = np.sign([outward(size) for size in np.arange(0.1, 6, 0.1)])
    assert (signs[0], signs[-1]) == (-1, 1)
    assert np.count_nonzero(np.diff(signs)) == 1


@pytest.mark.parametrize(("repulsion", "gathered"), [(1e4, True), (1e7, False)])
@pytest.mark.parametrize("repel", ["pairs", "centre"])
def test_covers_of_the_literal_variant_gather_or_flee(repel: str, repulsion: float, gathered: bool) -> None:
    meta = Meta(variant="literal", repel=repel, repulsion=repulsion, covers=12)  # type: ignore[arg-type]
    away = np.linalg.norm(tried(meta, goal_for(search_radius=2 * MM)), axis=1)
    assert len(away) == 12
    if gathered:
        assert away.max() < 0.1
    else:
        assert (away > 1.99).sum() >= 11


def test_forces_without_a_sense_are_refused() -> None:
    with pytest.raises(InputError, match=r"Eq\. 46\) has no corrected form"):
        Meta(repel="centre")
    with pytest.raises(InputError, match=r"hinge.*a correction of Eq\. 45"):
        Meta(repel="hinge", variant="literal")


def test_a_force_from_the_centre_cannot_part_covers() -> None:
    """Why Eq. 46 has no corrected form: covers in one place feel the same force, bounded or not."""
    pair = np.array([(0.3, 0.1), (0.3, 0.1), (-0.5, -0.2)])
    force = repulsion_gradient("eq_46", pair, 0.2, 1.0, 1.0)
    assert force[0].tolist() == force[1].tolist()
    near = np.array([(0.3, 0.1), (0.301, 0.1), (-0.5, -0.2)])
    assert np.ptp(repulsion_gradient("overlap", near, 0.2, 1.0, 1.0)[:2, 0]) > 0.3


def test_ascent_climbs_f_of_eq_47() -> None:
    """With the corrected forces and a stable step F only grows; a fixed step is taken as it is."""
    belief, radius, repulsion = isotropic((0.1, 0.0), 0.5), 0.2, 20.0
    for force in ("overlap", "hinge"):
        values = []
        for steps in (1, 5, 20, 80, 320):
            centres, masses = plan_covers(belief, radius, 15, repulsion, 2.0, force, steps=steps)
            values.append(masses.sum() + penalty(force, centres, radius, repulsion, 1.0))
        if force == "overlap":
            assert (np.diff(values) > -1e-9).all()
        assert values[-1] > values[0]
    start, _ = plan_covers(belief, radius, 4, 0.0, 2.0, steps=1, step=0.0)
    moved, _ = plan_covers(belief, radius, 4, 0.0, 2.0, steps=1, step=0.01)
    expected = start + 0.01 * disc_mass_gradient(belief, start, radius)
    assert moved == pytest.approx(expected, abs=1e-12)


# Algorithm 2.


def test_meta_as_printed_learns_from_candidates_and_ends_with_its_covers() -> None:
    """Candidate (x, y), not where the part came to rest; all three updates by hand."""
    seats = [
        Seat("old", b, "h1", x * MM, y * MM, 0.9 * MM, 0.9 * MM)
        for b, (x, y) in enumerate([(0.2, 0), (0.6, 0), (0.4, 0.3)])
    ]
    goal = goal_for(seats=seats, max_attempts=1000)
    mle = Meta(variant="literal", update="mle", covers=7)
    belief = mle.belief(goal)
    assert (belief.x, belief.y) == pytest.approx((0.4 * MM, 0.1 * MM))
    assert (belief.xx, belief.yy) == pytest.approx((0.08 / 3 * MM**2, 0.06 / 3 * MM**2))
    printed = Meta(variant="literal", covers=7, prior_width=0.4 * MM, mean_penalty=2.0, covariance_penalty=3.0)
    points = np.array([(s.x, s.y) for s in seats])
    expected = maximum_a_posteriori_as_printed(points, isotropic((0, 0), 0.4 * MM), 2.0, 3.0)
    assert printed.belief(goal) == expected != belief
    for meta in (mle, printed):
        proposals = list(meta.search(goal))
        assert len(proposals) == 7
        chances = [proposal.probability for proposal in proposals]
        assert chances == sorted(chances, reverse=True)
    assert len(list(dataclasses.replace(mle, variant="corrected").search(goal))) > 50  # and then the sweep
