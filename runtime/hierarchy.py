"""What is believed about all holes of a board type together: a hierarchy of errors, learned from insertions.

    offset = common error + shift of the board + rotation of the board x lever + bias of the hole + scatter of the part

Common error and biases last from board to board, shift and rotation belong to one board, scatter to one part. How far
each strays is not known either: a bank of hypotheses, each a Gaussian filter over the whole state, is weighted by how
well it foretells the insertions (a multiple-model filter: Bar-Shalom, Li, Kirubarajan, Estimation with Applications
to Tracking and Navigation, 2001, section 11.6). For each hole a discrete belief says by how much its parts scatter
more than others', and every part may be an outlier, its hole may have moved, or everything may have: that is the change
detector. Lengths are millimetres within this file, metres at its interface.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import ArrayLike, NDArray

from runtime.messages import Place

Array = NDArray[np.float64]

MM = 1e-3  # [m]
_COMMON, _SHIFT, _ROTATION, _BIASES = slice(0, 2), slice(2, 4), 4, 5  # of the state; shift and rotation last a board
_LEAST = 1e-250
_NEGLIGIBLE = 3e-4  # weight of a case over that of the likeliest, below which it is left out


@dataclass(frozen=True)
class Expectations:
    """What is expected before anything is known: standard deviations to weigh, and how often the model is wrong."""

    common: float = 0.6e-3  # [m] of the common error
    shifts: tuple[float, ...] = (0.08e-3, 0.25e-3, 0.6e-3, 1.5e-3)  # [m]
    shift_weights: tuple[float, ...] = (0.25, 0.35, 0.3, 0.1)
    rotations: tuple[float, ...] = (1e-3, 4e-3)  # [rad]
    rotation_weights: tuple[float, ...] = (0.5, 0.5)
    biases: tuple[float, ...] = (0.08e-3, 0.25e-3, 0.6e-3)  # [m]
    bias_weights: tuple[float, ...] = (0.25, 0.5, 0.25)
    scatters: tuple[float, ...] = (0.04e-3, 0.07e-3, 0.12e-3, 0.19e-3, 0.3e-3)  # [m]
    scatter_weights: tuple[float, ...] = (0.12, 0.22, 0.3, 0.24, 0.12)
    factors: tuple[float, ...] = (1.0, 1.9, 3.6, 9.0)  # by which the parts of one hole scatter more
    factor_weights: tuple[float, ...] = (0.8, 0.1, 0.09, 0.01)
    factor_floor: float = 0.004  # share that every factor keeps: any part may be an outlier
    moved: float = 0.001  # probability that a hole has moved since its last part
    moved_by: float = 1.0e-3  # [m]
    changed: float = 0.003  # probability that with a fresh board everything has: another fixture, another teaching
    changed_by: float = 1.5e-3  # [m]
    drift: float = 0.02e-3  # [m] of the common error and of each hole's bias from board to board


@dataclass(frozen=True, eq=False)
class Mixture:
    """A weighted sum of normal densities of one offset, in metres unless its owner says otherwise."""

    weights: Array  # (n,) sum to 1
    means: Array  # (n, 2) [m]
    covariances: Array  # (n, 2, 2) [m^2]

    @cached_property
    def mean(self) -> Array:
        """Mean (2,) [m] of the whole."""
        return np.asarray(self.weights @ self.means)

    @cached_property
    def covariance(self) -> Array:
        """Covariance (2, 2) [m^2] of the whole."""
        apart = self.means - self.mean
        within = np.einsum("n,nij->ij", self.weights, self.covariances)
        return np.asarray(within + np.einsum("n,ni,nj->ij", self.weights, apart, apart))


@dataclass(frozen=True, eq=False)
class _Cases:
    """The next offset at one hole, case by case: hypotheses (k) x what may have happened to the part or hole (j)."""

    weights: Array  # (k, j) sum to 1
    means: Array  # (k, 2) [mm]
    covariances: Array  # (k, j, 2, 2) [mm^2]
    to_state: Array  # (k, j, n, 2) [mm^2] covariance of the state with the offset
    gained: Array  # (j, 2) variance [mm^2] that the case adds to the common error and to the hole's bias


@dataclass(frozen=True, eq=False)
class BoardBelief:
    """The whole belief at one moment. Values do not change: what is learned is a new belief."""

    expectations: Expectations
    places: tuple[str, ...]  # names of the holes
    levers: Array  # (holes, 2) [mm] from the board's centre
    spread: Array  # (k, 4) standard deviations of each hypothesis: shift [mm], rotation [rad], bias, scatter [mm]
    log_weights: Array  # (k,)
    state: Array  # (k, n) [mm], [rad]
    covariance: Array  # (k, n, n)
    log_factors: Array  # (k, holes, factors)
    board: int = 0  # number of the board that shift and rotation belong to; 0: none yet
    touched: bool = False  # whether anything was learned on it

    def on_board(self, board: int) -> BoardBelief:
        """The belief once a board is in place: a new number means a fresh one, of which nothing is known."""
        if board == self.board:
            return self
        state, covariance = self.state.copy(), self.covariance.copy()
        fresh = slice(2, 5)
        state[:, fresh] = 0.0
        covariance[:, fresh, :] = covariance[:, :, fresh] = 0.0
        covariance[:, [2, 3], [2, 3]] = self.spread[:, :1] ** 2
        covariance[:, 4, 4] = self.spread[:, 1] ** 2
        if self.board:
            lasting = [0, 1, *range(_BIASES, state.shape[1])]
            covariance[:, lasting, lasting] += (self.expectations.drift / MM) ** 2
        return replace(self, state=state, covariance=covariance, board=board, touched=False)

    def offset(self, hole: str) -> Mixture:
        """Where the next part goes in at a hole of the present board."""
        cases = self._cases(self.places.index(hole))
        keep = cases.weights > _NEGLIGIBLE * cases.weights.max()
        weights = cases.weights[keep]
        means = np.broadcast_to(cases.means[:, None], (*cases.weights.shape, 2))[keep]
        return Mixture(weights / weights.sum(), means * MM, cases.covariances[keep] * MM**2)

    def learned(self, hole: str, position: ArrayLike, noise: float) -> BoardBelief:
        """The belief after a part went in at `position` (2,) [m], known to `noise` [m] per axis."""
        at = np.asarray(position, dtype=float) / MM
        error = (noise / MM) ** 2 * np.eye(2)
        number = self.places.index(hole)
        cases = self._cases(number)
        total = cases.covariances + error
        apart = (at - cases.means)[:, None]  # (k, 1, 2)
        inverse = _inverse(total)
        scaled = np.einsum("kjab,kjb->kja", inverse, np.broadcast_to(apart, (*total.shape[:2], 2)))
        log_density = -0.5 * (apart * scaled).sum(axis=2) - 0.5 * np.log(_determinant(total))
        # What the offset was: its mean and covariance in each case, given where the part was found.
        means = cases.means[:, None] + np.einsum("kjab,kjb->kja", cases.covariances, scaled)
        covariances = cases.covariances - cases.covariances @ inverse @ cases.covariances
        return self._updated(number, cases, log_density, means, covariances)

    def learned_by(self, hole: str, points: Array, likelihood: Array) -> BoardBelief:
        """The belief after evidence of which each offset of `points` (m, 2) [m] has the `likelihood` (m,).

        The points must cover evenly, and finely enough, wherever the likelihood is not zero.
        """
        number = self.places.index(hole)
        cases = self._cases(number)
        chosen = np.nonzero(cases.weights > _NEGLIGIBLE * cases.weights.max())
        centre = points.mean(axis=0) / MM  # near it numbers stay small
        at = points / MM - centre
        products = np.stack(
            [np.ones(len(at)), at[:, 0], at[:, 1], at[:, 0] ** 2, at[:, 0] * at[:, 1], at[:, 1] ** 2], axis=1
        )
        mean, inverse = cases.means[chosen[0]] - centre, _inverse(cases.covariances[chosen])
        slope = np.einsum("nab,nb->na", inverse, mean)
        exponent = np.stack(
            [
                -0.5 * (mean * slope).sum(axis=1),
                slope[:, 0],
                slope[:, 1],
                -0.5 * inverse[:, 0, 0],
                -inverse[:, 0, 1],
                -0.5 * inverse[:, 1, 1],
            ],
            axis=1,
        )
        density = np.exp(exponent @ products.T) * likelihood  # (n, m)
        moments = density @ products  # (n, 6)
        mass = moments[:, 0]
        if not (mass > _LEAST).any():
            return self  # nothing that was thought possible explains it
        known = mass > _LEAST
        moments = moments / np.where(known, mass, 1.0)[:, None]
        found = np.where(known[:, None], moments[:, 1:3], mean)
        square = moments[:, [3, 4, 4, 5]].reshape(-1, 2, 2) - found[:, :, None] * found[:, None]
        log_density = np.full(cases.weights.shape, -math.inf)
        with np.errstate(divide="ignore"):
            log_density[chosen] = np.log(mass) - 0.5 * np.log(_determinant(cases.covariances[chosen]))
        log_density[chosen] = np.where(known, log_density[chosen], -math.inf)
        means = np.broadcast_to(cases.means[:, None], (*cases.weights.shape, 2)).copy()
        means[chosen] = found + centre
        covariances = cases.covariances.copy()
        covariances[chosen] = np.where(known[:, None, None], square, covariances[chosen])
        return self._updated(number, cases, log_density, means, covariances)

    def _cases(self, number: int) -> _Cases:
        e = self.expectations
        factors, count = np.array(e.factors), len(e.factors)
        rows = self._rows(number)
        to_state = self.covariance @ rows.T  # (k, n, 2)
        covariance = rows @ to_state  # (k, 2, 2)
        gained = np.zeros((count + 2, 2))
        gained[count, 1] = (e.moved_by / MM) ** 2
        gained[count + 1, 0] = (e.changed_by / MM) ** 2
        scatter = (self.spread[:, 3:] * np.append(factors, [1.0, 1.0])) ** 2  # (k, j)
        share = np.exp(self.log_factors[:, number])
        changed = 0.0 if self.touched else e.changed
        share *= (1 - e.moved - changed) / share.sum(axis=1, keepdims=True)
        share = np.concatenate([share, np.tile([e.moved, changed], (len(share), 1))], axis=1)
        weights = np.exp(self.log_weights - self.log_weights.max())[:, None] * share
        whole = np.repeat(to_state[:, None], count + 2, axis=1)
        bias = _BIASES + 2 * number
        whole[:, :, [0, 1], [0, 1]] += gained[:, :1]
        whole[:, :, [bias, bias + 1], [0, 1]] += gained[:, 1:]
        total = covariance[:, None] + (scatter + gained.sum(axis=1))[..., None, None] * np.eye(2)
        return _Cases(weights / weights.sum(), self.state @ rows.T, total, whole, gained)

    def _updated(self, number: int, cases: _Cases, log_density: Array, means: Array, covariances: Array) -> BoardBelief:
        """Bayes' rule over the cases, and each hypothesis' cases gathered into one normal again by their moments."""
        with np.errstate(divide="ignore"):
            log_joint = np.log(cases.weights) + log_density  # (k, j)
        peak = log_joint.max(axis=1, keepdims=True)
        alive = np.isfinite(peak[:, 0])
        share = np.exp(log_joint - np.where(np.isfinite(peak), peak, 0.0))
        total = share.sum(axis=1, keepdims=True)
        with np.errstate(divide="ignore"):
            log_weights = np.where(alive, peak[:, 0] + np.log(total[:, 0]), -math.inf)
        share = np.where(alive[:, None], share / np.where(total > 0, total, 1.0), cases.weights)
        share /= share.sum(axis=1, keepdims=True)

        inverse = _inverse(cases.covariances)
        gain = cases.to_state @ inverse  # (k, j, n, 2)
        step = np.einsum("kjna,kja->kjn", gain, means - cases.means[:, None])
        moved = np.einsum("kj,kjn->kn", share, step)
        apart = step - moved[:, None]
        hypotheses, size = self.state.shape
        drop = gain @ (share[..., None, None] * (cases.covariances - covariances))  # (k, j, n, 2)
        left, right = (m.transpose(0, 2, 1, 3).reshape(hypotheses, size, -1) for m in (drop, gain))
        covariance = self.covariance - left @ right.transpose(0, 2, 1)
        covariance += (share[..., None] * apart).transpose(0, 2, 1) @ apart
        bias = _BIASES + 2 * number
        for first, added in ((0, share @ cases.gained[:, 0]), (bias, share @ cases.gained[:, 1])):
            covariance[:, first, first] += added
            covariance[:, first + 1, first + 1] += added
        e = self.expectations
        kept = np.maximum(share[:, : len(e.factors)], e.factor_floor)
        factors = self.log_factors.copy()
        factors[:, number] = np.log(kept / kept.sum(axis=1, keepdims=True))
        return replace(
            self,
            log_weights=np.maximum(log_weights - log_weights.max(), -60.0),
            state=self.state + moved,
            covariance=(covariance + covariance.transpose(0, 2, 1)) / 2,
            log_factors=factors,
            touched=True,
        )

    def _rows(self, number: int) -> Array:
        """The offset at a hole as rows (2, n) over the state."""
        rows = np.zeros((2, self.state.shape[1]))
        x, y = self.levers[number]
        rows[:, _COMMON] = rows[:, _SHIFT] = np.eye(2)
        rows[:, _ROTATION] = (-y, x)
        rows[:, _BIASES + 2 * number : _BIASES + 2 * number + 2] = np.eye(2)
        return rows


def unlearned(layout: Sequence[Place], expectations: Expectations) -> BoardBelief:
    """The belief about a board type of which nothing is known yet."""
    e = expectations
    options = [
        list(zip(values, weights, strict=True))
        for values, weights in (
            ([value / MM for value in e.shifts], e.shift_weights),
            (e.rotations, e.rotation_weights),
            ([value / MM for value in e.biases], e.bias_weights),
            ([value / MM for value in e.scatters], e.scatter_weights),
        )
    ]
    bank = list(product(*options))
    spread = np.array([[value for value, _ in hypothesis] for hypothesis in bank])  # (k, 4)
    log_weights = np.array([sum(math.log(weight) for _, weight in hypothesis) for hypothesis in bank])
    size = _BIASES + 2 * len(layout)
    variances = np.empty((len(bank), size))
    variances[:, _COMMON] = (e.common / MM) ** 2
    variances[:, _SHIFT] = spread[:, :1] ** 2
    variances[:, _ROTATION] = spread[:, 1] ** 2
    variances[:, _BIASES:] = spread[:, 2:3] ** 2
    covariance = np.zeros((len(bank), size, size))
    covariance[:, range(size), range(size)] = variances
    positions = np.array([(place.x, place.y) for place in layout]) / MM
    factors = np.log(np.array(e.factor_weights) / sum(e.factor_weights))
    return BoardBelief(
        expectations=e,
        places=tuple(place.hole for place in layout),
        levers=positions - positions.mean(axis=0),
        spread=spread,
        log_weights=log_weights,
        state=np.zeros((len(bank), size)),
        covariance=covariance,
        log_factors=np.tile(factors, (len(bank), len(layout), 1)),
    )


def _determinant(matrices: Array) -> Array:
    """Of symmetric (..., 2, 2)."""
    return np.asarray(matrices[..., 0, 0] * matrices[..., 1, 1] - matrices[..., 0, 1] ** 2)


def _inverse(matrices: Array) -> Array:
    """Of symmetric (..., 2, 2)."""
    inverse = np.empty_like(matrices)
    inverse[..., 0, 0], inverse[..., 1, 1] = matrices[..., 1, 1], matrices[..., 0, 0]
    inverse[..., 0, 1] = inverse[..., 1, 0] = -matrices[..., 0, 1]
    return np.asarray(inverse / _determinant(matrices)[..., None, None])
