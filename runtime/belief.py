"""Mathematics of what is believed about a hole: normal distributions of its offset from nominal, and nothing else.

Equation numbers are those of the paper this project reproduces. Lengths are metres, in `base_link`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache
from itertools import product

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import erf

from runtime.errors import InputError
from runtime.messages import Gaussian, Seat

Array = NDArray[np.float64]

FEWEST_FOR_COVARIANCE = 3  # two points span a line: Eq. 27 is singular below three
_NODES = 96  # of Gauss-Legendre quadrature: disc masses to 1e-6 while both widths exceed a tenth of the radius
_TAIL = 9.0  # standard deviations beyond which a normal density is zero in double precision
_ALTERNATIONS = 1000  # between mean and covariance: a hundred reach 1e-12 unless a stationary point is about to vanish
_COLLAPSED = 1e-12  # [prior variances] below which a variance is on its way to zero
_RECENT = 120  # seats that `belief_about` weighs: the cost grows with the cube, older boards say little more

# Standard deviations that `belief_about` tries, in multiples of the prior width.
_BOARD_SHIFTS = (0.15, 0.5, 1.2)
_HOLE_BIASES = (0.15, 0.5, 1.0)
_SCATTERS = (0.1, 0.2, 0.4, 0.8)
_FACTOR_DOUBT = 4.0  # seats that "this hole's parts scatter like the others'" is worth
_FACTOR_LIMIT = 36.0  # a hole's scatter is believed at most six times the others', squared


def gaussian(mean: ArrayLike, covariance: ArrayLike) -> Gaussian:
    """A belief with mean (2,) [m] and covariance (2, 2) [m^2]. InputError unless finite and positive semidefinite."""
    m, c = np.asarray(mean, dtype=float), np.asarray(covariance, dtype=float)
    if m.shape != (2,) or c.shape != (2, 2):
        raise InputError(f"a belief needs a mean (2,) and a covariance (2, 2), not {m.shape} and {c.shape}")
    if not (np.isfinite(m).all() and np.isfinite(c).all()):
        raise InputError(f"a belief needs finite numbers, not mean {m.tolist()} and covariance {c.tolist()}")
    if np.linalg.eigvalsh(c)[0] < -1e-9 * max(np.trace(c), 0.0):
        raise InputError(f"a covariance needs eigenvalues of zero or more: {c.tolist()} has a negative one")
    return Gaussian(
        x=float(m[0]), y=float(m[1]), xx=float(c[0, 0]), xy=float((c[0, 1] + c[1, 0]) / 2), yy=float(c[1, 1])
    )


def isotropic(mean: ArrayLike, width: float) -> Gaussian:
    """A round belief: standard deviation `width` [m] along every direction."""
    return gaussian(mean, width**2 * np.eye(2))


def mean_of(belief: Gaussian) -> Array:
    """Mean (2,) [m]."""
    return np.array([belief.x, belief.y])


def covariance_of(belief: Gaussian) -> Array:
    """Covariance (2, 2) [m^2]. InputError if the belief claims none."""
    if not belief.known:
        raise InputError("this belief claims no distribution: its covariance is not a number")
    return np.array([[belief.xx, belief.xy], [belief.xy, belief.yy]])


def floored(belief: Gaussian, width: float) -> Gaussian:
    """The same belief, but no direction with a standard deviation below `width` [m]."""
    variances, axes = np.linalg.eigh(covariance_of(belief))
    return gaussian(mean_of(belief), axes @ np.diag(np.maximum(variances, width**2)) @ axes.T)


def maximum_likelihood(points: ArrayLike, prior: Gaussian) -> Gaussian:
    """Maximum likelihood from points (m, 2) [m], Eqs. 26-27; the prior as it is until m >= 3.

    The covariance divides by m, as printed, so it is low by 1/m; identical points make it zero. Eqs. 26-27 are right
    though the gradients they are said to follow from are not: Eq. 24 should read +S^-1 (x - mu), and Eq. 25
    +S/2 - (x - mu)(x - mu)^T / 2, whose zero as printed is a covariance with negative variances.
    """
    p = _points(points)
    if len(p) < FEWEST_FOR_COVARIANCE:
        return prior
    centred = p - p.mean(axis=0)
    return gaussian(p.mean(axis=0), centred.T @ centred / len(p))


def maximum_a_posteriori(points: ArrayLike, prior: Gaussian, mean_count: float, covariance_count: float) -> Gaussian:
    """Joint mode of mean and covariance under a normal-inverse-Wishart prior, from points (m, 2) [m].

    Stands in for Eqs. 28-30, whose objective grows without bound as the covariance shrinks on one point, so that no
    maximum exists. The prior counts as `mean_count` points at its mean and `covariance_count` points with its
    covariance (Gelman et al., Bayesian Data Analysis, 3rd ed., section 3.6, with nu0 + d + 2 = covariance_count):

        mean       = (k0 m0 + m xbar) / (k0 + m)
        covariance = (n0 S0 + S + k0 m / (k0 + m) (xbar - m0)(xbar - m0)^T) / (n0 + m)
    """
    p = _points(points)
    m = len(p)
    if m == 0:
        return prior
    average = p.mean(axis=0)
    centred, shift = p - average, average - mean_of(prior)
    total = mean_count + m
    scatter = (
        covariance_count * covariance_of(prior) + centred.T @ centred + mean_count * m / total * np.outer(shift, shift)
    )
    return gaussian((mean_count * mean_of(prior) + m * average) / total, scatter / (covariance_count + m))


def maximum_a_posteriori_as_printed(
    points: ArrayLike, prior: Gaussian, mean_penalty: float, covariance_penalty: float
) -> Gaussian:
    """A stationary point of Eq. 28, summed over points (m, 2) [m]; where it has none, `maximum_likelihood`.

    In the unit in which the prior is N(0, I), with penalties l1 on the mean and l2 on the covariance S:

        -m/2 log|S| - 1/2 sum_i (x_i - mu)^T S^-1 (x_i - mu) - l1/2 |mu|^2 - l2/4 |S - I|^2   (Frobenius norm)

    Unit normal priors on each element, of which the text speaks, are l1 = 1, l2 = 2. Eqs. 29-30 as printed are not
    its gradients (the sign of Eq. 24; in Eq. 30 also the chain rule, which makes the penalty's part
    +l2/2 S (S - I) S). Set to zero, its true gradients say

        (m I + l1 S) mu = m xbar     and, for each eigenvalue s of sum_i (x_i - mu)(x_i - mu)^T along the same axis,
        l2 v^3 - l2 v^2 + m v - s = 0     for the eigenvalue v of S,

    which are solved in turn from S = I; of up to three roots the greatest is the one that ascent from I comes to.
    The objective has no maximum for one point or for points on a line: it grows without bound as the variance across
    them goes to zero. Then a local maximum beside that exists only if the penalties are strong (l2 >= 4 m is enough);
    where there is none Eqs. 26-27 stand in, which are the limit of that ascent, and the prior below three points.
    """
    p = _points(points)
    m = len(p)
    if m == 0:
        return prior
    unit = np.linalg.cholesky(covariance_of(prior))
    y = np.linalg.solve(unit, (p - mean_of(prior)).T).T
    average = y.mean(axis=0)
    scatter = (y - average).T @ (y - average)
    covariance = np.eye(2)
    for _ in range(_ALTERNATIONS):
        mean = np.linalg.solve(m * np.eye(2) + mean_penalty * covariance, m * average)
        about, axes = np.linalg.eigh(scatter + m * np.outer(average - mean, average - mean))
        variances = np.array([_greatest_root(max(float(s), 0.0), m, covariance_penalty) for s in about])
        if variances.min() < _COLLAPSED:
            break
        before, covariance = covariance, (axes * variances) @ axes.T
        if np.abs(covariance - before).max() <= 1e-12 * variances.min():
            return gaussian(mean_of(prior) + unit @ mean, unit @ covariance @ unit.T)
    return maximum_likelihood(p, prior)


def _greatest_root(scatter: float, count: int, penalty: float) -> float:
    """Greatest v >= 0 with penalty v^3 - penalty v^2 + count v - scatter = 0."""
    from scipy.optimize import brentq

    def cubic(v: float) -> float:
        return ((penalty * v - penalty) * v + count) * v - scatter

    low, high = 0.0, 1.0 + scatter / count  # the cubic is at most 0 here, and at least `count` there
    turning = penalty**2 - 3 * count * penalty
    if turning > 0:
        dip = (penalty + math.sqrt(turning)) / (3 * penalty)  # its local minimum
        if cubic(dip) <= 0:
            low = dip
        else:
            high = (penalty - math.sqrt(turning)) / (3 * penalty)  # its local maximum: the only root lies below
    return float(brentq(cubic, low, high, xtol=1e-18))


def disc_mass(belief: Gaussian, centres: ArrayLike, radius: float) -> Array:
    """Probability that the hole lies within `radius` [m] of each centre (n, 2) [m]: phi of Eq. 44, shape (n,).

    In the covariance's own axes one integral is an error function; the other is done by Gauss-Legendre quadrature
    along the wider axis. Two things in the paper are not offered as printed, because they are no probability: the
    unnumbered density with 1 / sqrt(2 pi |S|), whose constant is Eq. 34's 1 / (2 pi sqrt|S|) in two dimensions, and
    Eqs. 35-40, whose Lambda is at once the eigenvalues of the covariance and those of its inverse.
    """
    wide, narrow, axes = _principal(belief, radius)
    from_mean = (np.atleast_2d(np.asarray(centres, dtype=float)) - mean_of(belief)) @ axes  # (n, 2)
    a, b = -from_mean[:, :1], -from_mean[:, 1:]  # the mean as seen from each centre
    low = np.arcsin(np.clip((a - _TAIL * wide) / radius, -1.0, 1.0))
    high = np.arcsin(np.clip((a + _TAIL * wide) / radius, -1.0, 1.0))
    nodes, weights = _gauss_legendre()
    angle = (low + high) / 2 + (high - low) / 2 * nodes  # (n, nodes); u = radius sin(angle) is smooth at the rim
    u, half_chord = radius * np.sin(angle), radius * np.cos(angle)
    density = np.exp(-0.5 * ((u - a) / wide) ** 2) / (math.sqrt(2 * math.pi) * wide)
    root = math.sqrt(2) * narrow
    chord = 0.5 * (erf((half_chord - b) / root) - erf((-half_chord - b) / root))
    mass = ((high - low) / 2 * weights * density * chord * half_chord).sum(axis=1)
    return np.asarray(np.clip(mass, 0.0, 1.0))


def disc_mass_gradient(belief: Gaussian, centres: ArrayLike, radius: float) -> Array:
    """Gradient of `disc_mass` with respect to each centre, shape (n, 2) [1/m].

    By the divergence theorem it is the density times the outward normal, summed along the rim. Eqs. 24, 31 and 41-43
    as printed have the opposite sign, for the gradient with respect to mu: ascent along Eq. 31 walks away from the
    mean until the density is zero, so it is not offered. The trapezoidal rule on a circle converges faster than any
    power; its nodes grow with radius over width, up to 512 (width below radius / 50 is not resolved).
    """
    return disc_mass_slope(belief, radius)(np.atleast_2d(np.asarray(centres, dtype=float)))


def disc_mass_slope(belief: Gaussian, radius: float) -> Callable[[Array], Array]:
    """`disc_mass_gradient` for one belief and radius, prepared for many calls: centres (n, 2) [m] to (n, 2) [1/m]."""
    wide, narrow, axes = _principal(belief, radius)
    count = int(min(512, max(24, 4 * math.ceil(3 * radius / narrow))))
    normal = _circle(count)  # (count, 2)
    rim_x, rim_y = radius * normal[:, 0], radius * normal[:, 1]
    mean, peak = mean_of(belief), 2 * math.pi * wide * narrow

    def gradient(centres: Array) -> Array:
        from_mean = (centres - mean) @ axes
        u = (from_mean[:, :1] + rim_x) / wide  # (n, count)
        v = (from_mean[:, 1:] + rim_y) / narrow
        density = np.exp(-0.5 * (u * u + v * v)) / peak
        return np.asarray(radius * 2 * math.pi / count * (density @ normal) @ axes.T)

    return gradient


def ellipse(belief: Gaussian, sigmas: float = 2.0, points: int = 64) -> Array:
    """Closed outline (points, 2) [m] at `sigmas` standard deviations about the mean, last point equal to the first."""
    variances, axes = np.linalg.eigh(covariance_of(belief))
    angle = np.linspace(0.0, 2 * math.pi, points)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    outline = mean_of(belief) + sigmas * (circle * np.sqrt(np.maximum(variances, 0.0))) @ axes.T
    outline[-1] = outline[0]
    return np.asarray(outline)


def seat_points(seats: Sequence[Seat], *, seated: bool = True) -> Array:
    """Positions (n, 2) [m] of insertions: where the TCP came to rest, or the candidates that succeeded.

    A seat without a finite resting position counts with its candidate; one without either is left out.
    """
    rows = []
    for seat in seats:
        pose = (seat.seated_x, seat.seated_y) if seated else (math.nan, math.nan)
        rows.append(pose if all(map(math.isfinite, pose)) else (seat.x, seat.y))
    points = np.array(rows, dtype=float).reshape(-1, 2)
    return np.asarray(points[np.isfinite(points).all(axis=1)])


def belief_about(
    hole: str, seats: Sequence[Seat], prior_width: float, *, session: str = "", board: int = 0
) -> tuple[Gaussian, int]:
    """What earlier insertions say about where the next part goes into `hole`, and how many of them were weighed.

    A random-effects model: offset = common error + shift of the board + bias of the hole + scatter of the part, all
    normal, independent, round. So the other holes of the board under work (`session`, `board`) tell this board's
    shift, this hole on other boards tells its bias, and a hole without a seat of its own starts from the common
    error plus the shift of the board. With `board` 0 the board under work is unknown and counts as a new one.

    How far boards shift, holes stray and parts scatter is not known either: each is tried at three or four multiples
    of `prior_width` [m], and the answer has the mean and covariance of all cases, weighted by how well each explains
    the seats. A hole whose seats spread more than those of the median hole counts as one whose parts scatter more.
    No seats: normal about nominal with standard deviation `prior_width`. Only the newest 120 seats are weighed.
    """
    if not (math.isfinite(prior_width) and prior_width > 0):
        raise InputError(f"a prior width must be a positive length, not {prior_width} m")
    recent = [seat for seat in seats if math.isfinite(seat.x + seat.y)][-_RECENT:]
    if not recent:
        return isotropic((0.0, 0.0), prior_width), 0
    y = seat_points(recent) / prior_width  # (n, 2)
    boards = [(seat.session, seat.board) for seat in recent]
    numbers = {key: number for number, key in enumerate(dict.fromkeys(boards))}
    on_board = np.array([numbers[key] for key in boards])
    holes = [seat.hole for seat in recent]
    names = {name: number for number, name in enumerate(dict.fromkeys(holes))}
    of_hole = np.array([names[name] for name in holes])
    same_board = (on_board[:, None] == on_board).astype(float)
    same_hole = (of_hole[:, None] == of_hole).astype(float)
    this_board = np.array([key == (session, board) and board > 0 for key in boards], dtype=float)
    this_hole = np.array([name == hole for name in holes], dtype=float)

    factors = _scatter_factors(y, on_board, of_hole)  # (holes,)
    factor = float(factors[names[hole]]) if hole in names else 1.0

    cases = np.array(list(product(_BOARD_SHIFTS, _HOLE_BIASES, _SCATTERS))) ** 2
    shift, bias, scatter = cases.T  # (cases,) variances
    between = 1.0 + shift[:, None, None] * same_board + bias[:, None, None] * same_hole
    covariance = between + scatter[:, None, None] * np.diag(factors[of_hole])
    to_next = 1.0 + shift[:, None] * this_board + bias[:, None] * this_hole  # (cases, n)
    lower, whitened = _whiten(
        covariance, np.concatenate([np.broadcast_to(y, (len(cases), *y.shape)), to_next[..., None]], 2)
    )
    means = np.einsum("cni,cn->ci", whitened[:, :, :2], whitened[:, :, 2])
    variances = 1.0 + shift + bias + scatter * factor - (whitened[:, :, 2] ** 2).sum(axis=1)
    # Both axes share one covariance, so its determinant counts twice: 2 * log sqrt(det).
    weight = -0.5 * (whitened[:, :, :2] ** 2).sum(axis=(1, 2))
    weight -= 2 * np.log(np.diagonal(lower, axis1=1, axis2=2)).sum(axis=1)
    share = np.exp(weight - weight.max())
    share /= share.sum()
    mean = share @ means
    apart = means - mean
    spread = (share @ variances) * np.eye(2) + (share[:, None] * apart).T @ apart
    return gaussian(mean * prior_width, spread * prior_width**2), len(recent)


def _scatter_factors(y: Array, on_board: NDArray[np.intp], of_hole: NDArray[np.intp]) -> Array:
    """By how much the variance of each hole's parts exceeds the median hole's, (holes,), from positions y (n, 2)."""

    def means(groups: NDArray[np.intp], values: Array) -> Array:
        sums = np.stack([np.bincount(groups, weights=column) for column in values.T], axis=1)
        return np.asarray((sums / np.bincount(groups)[:, None])[groups])

    rest = y - means(on_board, y)
    rest = rest - means(of_hole, rest)
    freedom = np.bincount(of_hole) - 1.0
    spread = np.bincount(of_hole, weights=(rest**2).sum(axis=1)) / np.maximum(freedom, 1.0)
    seen = freedom >= FEWEST_FOR_COVARIANCE - 1
    if seen.sum() < 3:  # no median to speak of
        return np.ones(len(freedom))
    ratio = spread / max(float(np.median(spread[seen])), 1e-12)
    return np.asarray(np.clip((_FACTOR_DOUBT + freedom * ratio) / (_FACTOR_DOUBT + freedom), 1.0, _FACTOR_LIMIT))


def _whiten(covariance: Array, right: Array) -> tuple[Array, Array]:
    """Cholesky factors L (cases, n, n) of covariances, and L^-1 right (cases, n, k).

    Rows appended to a matrix come out of its factorisation solved, which saves a solver that knows no triangles.
    """
    cases, n, k = right.shape
    bordered = np.zeros((cases, n + k, n + k))
    bordered[:, :n, :n] = covariance
    bordered[:, n:, :n] = right.transpose(0, 2, 1)
    bordered[:, range(n, n + k), range(n, n + k)] = 1e30  # any number that keeps the border positive definite
    lower = np.linalg.cholesky(bordered)
    return lower[:, :n, :n], lower[:, n:, :n].transpose(0, 2, 1)


def _points(points: ArrayLike) -> Array:
    p = np.asarray(points, dtype=float).reshape(-1, 2)
    if not np.isfinite(p).all():
        raise InputError("positions to learn from must be finite numbers")
    return p


def _principal(belief: Gaussian, radius: float) -> tuple[float, float, Array]:
    """Wider and narrower standard deviation [m] and their axes as columns (2, 2)."""
    if not radius > 0:
        raise InputError(f"a disc needs a positive radius, not {radius} m")
    variances, axes = np.linalg.eigh(covariance_of(belief))
    narrow, wide = np.sqrt(np.maximum(variances, (1e-6 * radius) ** 2))  # a point mass is a very narrow one
    return float(wide), float(narrow), axes[:, ::-1]


@cache
def _gauss_legendre() -> tuple[Array, Array]:
    return np.polynomial.legendre.leggauss(_NODES)


@cache
def _circle(count: int) -> Array:
    angle = 2 * math.pi * np.arange(count) / count
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)
