"""The hierarchical belief against sampling, and what it makes of moved holes, loose boards and scattering parts."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from runtime.hierarchy import BoardBelief, Expectations, unlearned
from runtime.messages import Place

MM = 1e-3
LAYOUT = [Place("a", 0.27, -0.03), Place("b", 0.33, -0.03), Place("c", 0.30, 0.03)]
PLAIN = Expectations(
    common=0.4 * MM,
    shifts=(0.3 * MM,),
    shift_weights=(1.0,),
    rotations=(5e-3,),
    rotation_weights=(1.0,),
    biases=(0.2 * MM,),
    bias_weights=(1.0,),
    scatters=(0.1 * MM,),
    scatter_weights=(1.0,),
    factors=(1.0,),
    factor_weights=(1.0,),
    moved=0.0,
    changed=0.0,
    drift=0.0,
)
FULL = Expectations()


@dataclasses.dataclass
class Samples:
    """The same hierarchy, drawn: what a particle filter would hold."""

    expectations: Expectations
    count: int = 400_000

    def __post_init__(self) -> None:
        e, draw = self.expectations, np.random.default_rng(5)
        n, holes = self.count, len(LAYOUT)
        self.draw = draw
        self.common = e.common * draw.standard_normal((n, 2))
        self.bias = e.biases[0] * draw.standard_normal((n, holes, 2))
        self.weights = np.ones(n)
        self.fresh_board()

    def fresh_board(self) -> None:
        e = self.expectations
        self.shift = e.shifts[0] * self.draw.standard_normal((self.count, 2))
        self.rotation = e.rotations[0] * self.draw.standard_normal(self.count)

    def offset(self, hole: int) -> np.ndarray:
        places = np.array([(place.x, place.y) for place in LAYOUT])
        x, y = places[hole] - places.mean(axis=0)
        lever = self.rotation[:, None] * np.array([-y, x])
        scatter = self.expectations.scatters[0] * self.draw.standard_normal((self.count, 2))
        return self.common + self.shift + lever + self.bias[:, hole] + scatter

    def moments(self, offset: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        share = self.weights / self.weights.sum()
        mean = share @ offset
        return mean, np.einsum("n,ni,nj->ij", share, offset - mean, offset - mean), float(1 / (share**2).sum())


def agree(belief: BoardBelief, samples: Samples, hole: int) -> None:
    mixture = belief.offset(LAYOUT[hole].hole)
    mean, covariance, effective = samples.moments(samples.offset(hole))
    assert effective > 1000
    error = 5 / np.sqrt(effective)
    width = np.sqrt(np.trace(covariance))
    assert mixture.mean == pytest.approx(mean, abs=error * width)
    assert mixture.covariance == pytest.approx(covariance, abs=2 * error * width**2)


def test_seats_and_failures_teach_what_a_particle_filter_learns() -> None:
    belief, samples = unlearned(LAYOUT, PLAIN).on_board(1), Samples(PLAIN)
    agree(belief, samples, 0)

    seat, noise = np.array([0.5 * MM, -0.3 * MM]), 0.1 * MM
    apart = samples.offset(0) - seat
    samples.weights *= np.exp(-0.5 * (apart**2).sum(axis=1) / noise**2)
    belief = belief.learned("a", seat, noise)
    for hole in range(3):
        agree(belief, samples, hole)

    tried, radius = np.array([[0.5 * MM, -0.3 * MM], [0.2 * MM, 0.1 * MM]]), 0.3 * MM
    offsets = samples.offset(1)
    missed = (np.linalg.norm(offsets[:, None] - tried, axis=2) > radius).all(axis=1)
    samples.weights *= missed
    along = np.linspace(-3 * MM, 3 * MM, 241)
    points = np.stack(np.meshgrid(along, along, indexing="ij"), axis=-1).reshape(-1, 2)
    belief = belief.learned_by(
        "b", points, (np.linalg.norm(points[:, None] - tried, axis=2) > radius).all(axis=1).astype(float)
    )
    for hole in (0, 1, 2):
        agree(belief, samples, hole)

    samples.fresh_board()
    belief = belief.on_board(2)
    for hole in range(3):
        agree(belief, samples, hole)


def test_a_board_once_known_is_shared_by_its_holes() -> None:
    loose = dataclasses.replace(PLAIN, shifts=(2 * MM,), rotations=(0.02,))
    belief = unlearned(LAYOUT, loose).on_board(1)
    before = np.sqrt(belief.offset("c").covariance[0, 0])
    belief = belief.learned("a", (1 * MM, 2 * MM), 0.02 * MM).learned("b", (1 * MM, 2 * MM), 0.02 * MM)
    after = belief.offset("c")
    assert np.sqrt(after.covariance[0, 0]) < 0.3 * before
    assert after.mean == pytest.approx([1 * MM, 2 * MM], abs=0.1 * MM)
    # A fresh board may lie elsewhere: of this one's shift nothing is left but what it says of the common error.
    assert np.sqrt(belief.on_board(2).offset("c").covariance[0, 0]) > 0.8 * before


def many(belief: BoardBelief, boards: range, scatter: dict[str, float], seed: int = 2) -> BoardBelief:
    draw = np.random.default_rng(seed)
    for board in boards:
        belief = belief.on_board(board)
        shift = 0.1 * MM * draw.standard_normal(2)
        for place in LAYOUT:
            offset = shift + scatter[place.hole] * draw.standard_normal(2)
            belief = belief.learned(place.hole, offset, 0.04 * MM)
    return belief


def test_widths_are_learned_from_the_seats() -> None:
    fresh = unlearned(LAYOUT, FULL)
    belief = many(fresh, range(1, 9), {"a": 0.1 * MM, "b": 0.1 * MM, "c": 0.5 * MM}).on_board(9)
    width = {hole: float(np.linalg.det(belief.offset(hole).covariance)) ** 0.25 for hole in "abc"}
    assert 0.1 * MM < width["a"] < 0.35 * MM
    assert width["c"] > 1.5 * width["a"]
    shares = np.exp(belief.log_weights) / np.exp(belief.log_weights).sum()
    assert shares @ belief.spread[:, 0] < 0.35  # [mm] boards lie well, whatever was expected


def test_a_hole_that_moved_is_found_out() -> None:
    """The change detector: 1.2 mm elsewhere is believed after two parts, the other holes stay where they are."""
    belief = many(unlearned(LAYOUT, FULL), range(1, 9), dict.fromkeys("abc", 0.08 * MM))
    kept = belief.on_board(9).offset("a").mean
    for board in (9, 10):
        belief = belief.on_board(board)
        for hole, moved in (("a", 0.0), ("b", 1.2 * MM), ("c", 0.0)):
            belief = belief.learned(hole, (moved, 0.0), 0.04 * MM)
    belief = belief.on_board(11)
    assert belief.offset("b").mean == pytest.approx([1.2 * MM, 0.0], abs=0.3 * MM)
    assert belief.offset("a").mean == pytest.approx(kept, abs=0.15 * MM)


def test_another_fixture_is_found_out() -> None:
    belief = many(unlearned(LAYOUT, FULL), range(1, 9), dict.fromkeys("abc", 0.08 * MM)).on_board(9)
    narrow = np.sqrt(belief.offset("b").covariance[0, 0])
    for hole in ("a", "c"):
        belief = belief.learned(hole, (2 * MM, -1 * MM), 0.04 * MM)
    assert belief.offset("b").mean == pytest.approx([2 * MM, -1 * MM], abs=0.3 * MM)
    belief = belief.learned("b", (2 * MM, -1 * MM), 0.04 * MM)
    later = belief.on_board(10).offset("b")
    assert later.mean == pytest.approx([2 * MM, -1 * MM], abs=1.0 * MM)
    assert np.sqrt(later.covariance[0, 0]) > narrow  # whether it stays there nobody knows yet


offsets = st.tuples(st.floats(-3, 3), st.floats(-3, 3)).map(lambda p: (p[0] * MM, p[1] * MM))
lessons = st.lists(st.tuples(st.integers(0, 2), st.sampled_from("abc"), offsets), max_size=12)


@settings(max_examples=40, deadline=None)
@given(lessons)
def test_belief_stays_a_distribution_whatever_is_learned(taught: list[tuple[int, str, tuple[float, float]]]) -> None:
    belief, board = unlearned(LAYOUT, FULL), 1
    for step, hole, offset in taught:
        board += step
        belief = belief.on_board(board).learned(hole, offset, 0.05 * MM)
    for hole in "abc":
        mixture = belief.on_board(board).offset(hole)
        assert mixture.weights.sum() == pytest.approx(1.0)
        assert (np.linalg.eigvalsh(mixture.covariances) > 0).all()
        assert np.isfinite(mixture.mean).all()
        assert np.abs(mixture.mean).max() < 4 * MM


def test_evidence_that_nothing_explains_changes_nothing() -> None:
    belief = unlearned(LAYOUT, PLAIN).on_board(1)
    points = np.zeros((4, 2))
    assert belief.learned_by("a", points, np.zeros(4)) is belief
