"""The mathematics of beliefs against independent answers: other formulas, quadrature, random draws."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import dblquad
from scipy.special import chndtr

from runtime.belief import (
    belief_about,
    covariance_of,
    disc_mass,
    disc_mass_gradient,
    ellipse,
    floored,
    gaussian,
    isotropic,
    maximum_a_posteriori,
    maximum_likelihood,
    mean_of,
    seat_points,
)
from runtime.errors import InputError
from runtime.messages import Gaussian, Seat

MM = 1e-3
lengths = st.floats(-1.0, 1.0)
widths = st.floats(0.15, 1.0)
radii = st.floats(0.1, 0.5)


@st.composite
def beliefs(draw: st.DrawFn) -> Gaussian:
    """Any orientation, widths 0.15-1 mm, mean within 1 mm."""
    angle, wide, narrow = draw(st.floats(0, math.pi)), draw(widths), draw(widths)
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    spread = turn @ np.diag([wide**2, narrow**2]) @ turn.T
    return gaussian(MM * np.array([draw(lengths), draw(lengths)]), MM**2 * spread)


def seat(
    hole: str, x: float, y: float, *, board: int = 1, session: str = "old", read: tuple[float, float] | None = None
) -> Seat:
    return Seat(session, board, hole, x, y, *(read or (math.nan, math.nan)))


@given(beliefs())
def test_a_belief_survives_conversion(belief: Gaussian) -> None:
    again = gaussian(mean_of(belief), covariance_of(belief))
    assert again == belief
    assert covariance_of(belief) == pytest.approx(covariance_of(belief).T)


@pytest.mark.parametrize(
    ("mean", "covariance", "words"),
    [
        ([0, 0, 0], np.eye(2), r"mean \(2,\)"),
        ([0, math.nan], np.eye(2), "finite numbers"),
        ([0, 0], [[1, 2], [2, 1]], "a negative one"),
    ],
)
def test_impossible_beliefs_are_refused(mean: list[float], covariance: list[list[float]], words: str) -> None:
    with pytest.raises(InputError, match=words):
        gaussian(mean, covariance)


def test_a_belief_without_distribution_has_no_covariance() -> None:
    with pytest.raises(InputError, match="claims no distribution"):
        covariance_of(Gaussian())


def test_maximum_likelihood_is_eqs_26_and_27() -> None:
    prior = isotropic((0, 0), 0.5 * MM)
    points = np.array([[1, 0], [3, 0], [2, 3]]) * MM
    assert maximum_likelihood(points[:0], prior) == prior
    assert maximum_likelihood(points[:2], prior) == prior  # the paper's covariance is singular here
    belief = maximum_likelihood(points, prior)
    assert mean_of(belief) == pytest.approx([2 * MM, 1 * MM])
    assert covariance_of(belief) == pytest.approx(np.array([[2 / 3, 0], [0, 2]]) * MM**2)  # divided by m, not m - 1


def test_maximum_a_posteriori_by_hand() -> None:
    prior = gaussian((0, 0), np.diag([4.0, 4.0]) * MM**2)
    belief = maximum_a_posteriori(np.array([[3, 0]]) * MM, prior, mean_count=2, covariance_count=3)
    assert mean_of(belief) == pytest.approx([MM, 0])  # (2 * 0 + 1 * 3) / 3
    assert covariance_of(belief) == pytest.approx(np.diag([(3 * 4 + 2 / 3 * 9) / 4, 3 * 4 / 4]) * MM**2)
    assert maximum_a_posteriori([], prior, 2, 3) == prior


@given(beliefs(), st.lists(st.tuples(lengths, lengths), min_size=1, max_size=6), st.data())
def test_maximum_a_posteriori_is_the_mode_of_its_density(
    prior: Gaussian, points: list[tuple[float, float]], data: st.DataObject
) -> None:
    mean_count, covariance_count = data.draw(st.floats(0.1, 5)), data.draw(st.floats(1, 8))
    p = np.array(points) * MM
    best = maximum_a_posteriori(p, prior, mean_count, covariance_count)

    def log_density(mean: np.ndarray, covariance: np.ndarray) -> float:
        precision = np.linalg.inv(covariance)
        logdet = np.linalg.slogdet(covariance / MM**2)[1]
        data_part = -0.5 * len(p) * logdet - 0.5 * sum(d @ precision @ d for d in p - mean)
        shift = mean - mean_of(prior)
        mean_part = -0.5 * mean_count * shift @ precision @ shift  # beside -logdet / 2, counted below
        scale_part = -0.5 * covariance_count * np.trace(covariance_of(prior) @ precision)
        return float(data_part + mean_part + scale_part - 0.5 * covariance_count * logdet)

    top = log_density(mean_of(best), covariance_of(best))
    nudge = np.array([data.draw(st.floats(-0.05, 0.05)), data.draw(st.floats(-0.05, 0.05))]) * MM
    scale = data.draw(st.floats(0.9, 1.1))
    assert log_density(mean_of(best) + nudge, scale * covariance_of(best)) <= top + 1e-9 * (1 + abs(top))


@given(st.tuples(lengths, lengths), widths, radii)
def test_disc_mass_of_a_round_belief_is_noncentral_chi_square(
    centre: tuple[float, float], width: float, radius: float
) -> None:
    belief = isotropic((0.2 * MM, -0.1 * MM), width * MM)
    away = math.hypot(centre[0] - 0.2, centre[1] + 0.1) / width
    expected = chndtr((radius / width) ** 2, 2, away**2)
    assert disc_mass(belief, np.array(centre) * MM, radius * MM)[0] == pytest.approx(expected, abs=1e-7)


def test_disc_mass_of_a_slanted_belief_by_double_quadrature() -> None:
    belief = gaussian((0.1 * MM, 0.2 * MM), np.array([[0.09, 0.05], [0.05, 0.16]]) * MM**2)
    covariance, mean = covariance_of(belief) / MM**2, mean_of(belief) / MM
    precision, norm = np.linalg.inv(covariance), 2 * math.pi * math.sqrt(np.linalg.det(covariance))
    for x, y, radius in ((0.0, 0.0, 0.25), (0.5, -0.3, 0.4), (0.1, 0.2, 0.15)):

        def density(v: float, u: float, x: float = x, y: float = y) -> float:
            d = np.array([x + u, y + v]) - mean
            return float(math.exp(-0.5 * d @ precision @ d) / norm)

        def rim(u: float, radius: float = radius) -> float:
            return math.sqrt(max(radius**2 - u * u, 0.0))

        expected, _ = dblquad(density, -radius, radius, lambda u, f=rim: -f(u), rim, epsabs=1e-9)
        assert disc_mass(belief, (x * MM, y * MM), radius * MM)[0] == pytest.approx(expected, abs=1e-7)


@given(beliefs(), radii, st.lists(st.tuples(lengths, lengths), min_size=1, max_size=4))
def test_gradient_is_the_slope_of_the_mass(belief: Gaussian, radius: float, centres: list[tuple[float, float]]) -> None:
    c, step = np.array(centres) * MM, 1e-3 * MM
    gradient = disc_mass_gradient(belief, c, radius * MM)
    for axis in range(2):
        side = step * np.eye(2)[axis]
        slope = (disc_mass(belief, c + side, radius * MM) - disc_mass(belief, c - side, radius * MM)) / (2 * step)
        assert gradient[:, axis] * MM == pytest.approx(slope * MM, abs=2e-4)


@given(beliefs(), radii, st.tuples(lengths, lengths))
def test_gradient_points_to_the_mean_of_a_round_belief(
    belief: Gaussian, radius: float, centre: tuple[float, float]
) -> None:
    """Eq. 31 as printed has the other sign and would walk away."""
    round_one = isotropic(mean_of(belief), 0.4 * MM)
    c = np.array(centre) * MM
    to_mean = mean_of(belief) - c
    rounding = 1e-12 * float(np.abs(to_mean).sum())  # the gradient is summed from terms of up to some 1000 per metre
    assert disc_mass_gradient(round_one, c, radius * MM)[0] @ to_mean >= -rounding


def test_masses_of_points_and_of_nearly_lines() -> None:
    point = gaussian((0, 0), np.zeros((2, 2)))
    assert disc_mass(point, [(0, 0), (0.1 * MM, 0), (0.3 * MM, 0)], 0.2 * MM) == pytest.approx([1, 1, 0], abs=1e-3)
    flat = gaussian((0, 0), np.diag([0.25, 0.0]) * MM**2)
    assert disc_mass(flat, (0, 0), 0.2 * MM)[0] == pytest.approx(math.erf(0.2 / 0.5 / math.sqrt(2)), abs=1e-3)
    for value in (*disc_mass(point, [(9, 9)], 1e-4), *disc_mass_gradient(point, [(9, 9)], 1e-4).ravel()):
        assert value == 0


def test_a_floor_widens_only_what_is_too_narrow() -> None:
    turn = np.array([[1, -1], [1, 1]]) / math.sqrt(2)
    belief = gaussian((MM, 0), turn @ np.diag([0.01, 1.0]) @ turn.T * MM**2)
    wider = floored(belief, 0.3 * MM)
    assert np.linalg.eigvalsh(covariance_of(wider)) == pytest.approx(np.array([0.09, 1.0]) * MM**2)
    assert mean_of(wider) == pytest.approx(mean_of(belief))


@given(beliefs(), st.floats(0.5, 3))
def test_every_point_of_the_ellipse_is_as_many_sigmas_away(belief: Gaussian, sigmas: float) -> None:
    outline = ellipse(belief, sigmas, 40) - mean_of(belief)
    distances = np.einsum("ni,ij,nj->n", outline, np.linalg.inv(covariance_of(belief)), outline)
    assert distances == pytest.approx(np.full(40, sigmas**2))
    assert (outline[0] == outline[-1]).all()


def test_positions_of_seats_prefer_the_seated_pose() -> None:
    seats = [
        seat("h1", 1.0, 2.0, read=(1.5, 2.5)),
        seat("h1", 3.0, 4.0, read=(math.nan, 1.0)),
        seat("h1", math.nan, 0.0),
    ]
    assert seat_points(seats).tolist() == [[1.5, 2.5], [3.0, 4.0]]
    assert seat_points(seats, seated=False).tolist() == [[1.0, 2.0], [3.0, 4.0]]
    assert seat_points([]).shape == (0, 2)


def test_nothing_known_is_the_prior() -> None:
    belief, weighed = belief_about("h1", [], 0.5 * MM)
    assert (belief, weighed) == (isotropic((0, 0), 0.5 * MM), 0)
    with pytest.raises(InputError, match="positive length"):
        belief_about("h1", [], 0.0)


def test_own_seats_sharpen_the_belief() -> None:
    spread = []
    for boards in range(1, 8):
        seats = [seat("h1", 0.4 * MM, 0.1 * MM, board=board) for board in range(1, boards + 1)]
        belief, weighed = belief_about("h1", seats, 0.5 * MM)
        assert weighed == boards
        spread.append(np.trace(covariance_of(belief)))
    assert all(later < earlier for earlier, later in pairwise(spread))
    assert mean_of(belief) == pytest.approx([0.4 * MM, 0.1 * MM], abs=0.02 * MM)
    assert math.sqrt(spread[-1] / 2) < 0.15 * MM


def test_other_holes_of_the_board_under_work_tell_its_shift() -> None:
    """Boards shift a lot, holes and parts little: the first two holes say where the third is."""
    draw = np.random.default_rng(3)
    seats = []
    for board, shift in enumerate([(0.6, 0.0), (-0.5, 0.3), (0.1, -0.7), (-0.2, 0.5), (0.5, 0.5)], start=1):
        holes = ("h1", "h2", "h3") if board < 5 else ("h1", "h2")
        seats += [seat(hole, *(np.add(shift, 0.03 * draw.standard_normal(2)) * MM), board=board) for hole in holes]
    here, _ = belief_about("h3", seats, 0.5 * MM, session="old", board=5)
    fresh, _ = belief_about("h3", seats, 0.5 * MM, session="old", board=6)
    other_session, _ = belief_about("h3", seats, 0.5 * MM, session="new", board=5)
    unknown, _ = belief_about("h3", seats, 0.5 * MM)
    assert mean_of(here) == pytest.approx([0.5 * MM, 0.5 * MM], abs=0.08 * MM)
    assert math.sqrt(covariance_of(here)[0, 0]) < 0.15 * MM
    assert math.sqrt(covariance_of(fresh)[0, 0]) > 0.35 * MM
    assert fresh == other_session == unknown


def test_a_hole_without_seats_starts_from_the_others() -> None:
    """All holes share an error of 0.8 mm; a hole never seen is expected there too, with more doubt than a seen one."""
    seats = [seat(f"h{hole}", 0.8 * MM, 0.0, board=board) for board in range(1, 5) for hole in range(1, 5)]
    unseen, _ = belief_about("h9", seats, 0.5 * MM)
    seen, _ = belief_about("h1", seats, 0.5 * MM)
    assert mean_of(unseen)[0] == pytest.approx(0.8 * MM, abs=0.1 * MM)
    assert np.trace(covariance_of(unseen)) > np.trace(covariance_of(seen))


def test_a_hole_whose_parts_scatter_more_is_believed_wider() -> None:
    draw = np.random.default_rng(4)
    seats = [
        seat(hole, *(width * MM * draw.standard_normal(2)), board=board)
        for board in range(1, 9)
        for hole, width in (("h1", 0.1), ("h2", 0.1), ("h3", 0.1), ("h4", 0.1), ("h7", 0.3))
    ]
    usual, _ = belief_about("h1", seats, 0.5 * MM)
    abnormal, _ = belief_about("h7", seats, 0.5 * MM)
    assert np.trace(covariance_of(abnormal)) > 3 * np.trace(covariance_of(usual))


def test_beliefs_are_calibrated_where_the_model_holds() -> None:
    """Over worlds drawn from the model the squared Mahalanobis distance of the next offset averages two dimensions."""
    distances = []
    for seed in range(30):
        draw = np.random.default_rng(seed)
        common, bias = 0.5 * draw.standard_normal(2), 0.25 * draw.standard_normal((4, 2))
        seats: list[Seat] = []
        for board in range(1, 6):
            shift = 0.25 * draw.standard_normal(2)
            for hole in range(4):
                offset = (common + shift + bias[hole] + 0.15 * draw.standard_normal(2)) * MM
                belief, _ = belief_about(f"h{hole}", seats, 0.5 * MM, session="now", board=board)
                d = offset - mean_of(belief)
                distances.append(d @ np.linalg.solve(covariance_of(belief), d))
                seats.append(seat(f"h{hole}", *offset, board=board, session="now"))
    assert 1.5 < np.mean(distances) < 2.5
    assert 0.85 < np.mean(np.array(distances) < -2 * math.log(0.1)) < 0.97  # nine in ten within the 90 % ellipse


@given(
    st.lists(st.tuples(st.integers(1, 4), st.integers(1, 4), lengths, lengths), max_size=30),
    st.floats(0.05, 2.0),
    st.integers(0, 5),
)
def test_any_evidence_gives_a_proper_belief(
    rows: list[tuple[int, int, float, float]], prior_width: float, board: int
) -> None:
    seats = [seat(f"h{hole}", x * MM, y * MM, board=b) for b, hole, x, y in rows]
    belief, weighed = belief_about("h1", seats, prior_width * MM, session="old", board=board)
    assert weighed == len(seats)
    assert np.linalg.eigvalsh(covariance_of(belief))[0] > 0
    assert belief_about("h1", seats, prior_width * MM, session="old", board=board)[0] == belief


def test_only_the_newest_seats_are_weighed() -> None:
    old = [seat("h1", 1.5 * MM, 0.0, board=board) for board in range(1, 100)]
    new = [seat("h1", -0.5 * MM, 0.0, board=board) for board in range(100, 220)]
    assert belief_about("h1", old + new, 0.5 * MM) == belief_about("h1", new, 0.5 * MM)
