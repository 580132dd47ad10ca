"""Meta search: learn the distribution of a hole's offset, then try where most of it lies (the paper's Algorithm 2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field

from runtime.belief import (
    floored,
    isotropic,
    maximum_a_posteriori,
    maximum_a_posteriori_as_printed,
    maximum_likelihood,
    mean_of,
    seat_points,
)
from runtime.errors import InputError
from runtime.messages import Gaussian, Proposal, SearchGoal
from runtime.plugin import Search
from runtime.quantity import InverseArea, Length, NotNegative, Positive
from strategies.covers import MILLIMETRE, STEPS, Force, plan_covers, sweep
from strategies.start import Start, Variant, check, propose, reach_of


@dataclass(frozen=True)
class Meta:
    """Covers a learnt normal distribution with discs of the feasible radius and tries the most probable first.

    Algorithm 2: begin from a normal about nominal, N(m0, I) in units of `prior_width`; learn from earlier insertions
    by maximum likelihood (`mle`, Eqs. 26-27, the prior until three are there) or a posteriori (`map`, Eqs. 28-30);
    place `covers` discs by gradient ascent on Eqs. 44-47 and try them by probability. The paper leaves open:

    whose insertions count: `start` says this hole's, all (`pooled`), none (`nominal`), or it takes the posterior
    store's belief as it is (`posterior`); how many covers (`covers`); how far to ascend (`steps`, `step`); what
    follows when the covers have run out.

    Insertions. literal: they count with the candidate that succeeded. corrected: with the seated position, and no
    direction is believed narrower than half the feasible radius, as a success shows no more.
    Eqs. 28-30. literal: a stationary point of Eq. 28 with `mean_penalty` and `covariance_penalty` in units of
    `prior_width`, and Eqs. 26-27 where it has none, as for one insertion. corrected: the mode under a
    normal-inverse-Wishart prior worth `mean_count` and `covariance_count` insertions.
    Eqs. 45-46 (`repel`, see `strategies.covers`). literal: the signs as printed, under which covers gather or flee:
    `pairs` is Eq. 45, whose eps is taken from a square in units of `unit`, `centre` is Eq. 46. corrected: covers repel
    while they overlap: `pairs` most where they coincide, `hinge` by Eq. 45 with no more than its sign and unit mended.
    Eq. 46 has no corrected form and is refused.
    The end. literal: with the covers. corrected: a bounded sweep searches what is left of the search radius.

    `repulsion` is lambda: the paper's number, which has no unit, over the square of the unit that it is read in.
    Eqs. 24, 31 and 41-43 have a wrong sign, Eqs. 35-40 cannot all hold; neither is offered, see `runtime.belief`.
    """

    start: Start = "hole"
    update: Literal["map", "mle"] = "map"
    prior_width: Annotated[Length, Positive] = 0.5e-3  # [m] standard deviation before anything is known
    mean_count: Annotated[float, Positive] = 0.3  # insertions that the prior mean is worth (map, corrected)
    covariance_count: Annotated[float, Positive] = 4.0  # insertions that the prior covariance is worth (map, corrected)
    mean_penalty: Annotated[float, Positive] = 1.0  # lambda_1 of Eq. 28 (map, literal); N(0, 1) for each element
    covariance_penalty: Annotated[float, Positive] = 2.0  # lambda_2 of Eq. 28 (map, literal); N(0, 1) for each element
    covers: Annotated[int, Field(ge=1, le=200)] = 30  # n
    repel: Literal["pairs", "hinge", "centre"] = "pairs"
    repulsion: Annotated[InverseArea, NotNegative] = 2e7  # [1/m^2] lambda
    unit: Annotated[Length, Positive] = MILLIMETRE  # [m] in which Eq. 45 takes a length from an area (pairs, literal)
    steps: Annotated[int, Field(ge=1, le=10_000)] = STEPS  # of gradient ascent
    step: Annotated[Length, Positive] | None = None  # [m] a cover moves by its square times the gradient; none: stable
    variant: Variant = "corrected"

    def __post_init__(self) -> None:
        """InputError for a force that the variant does not have."""
        if self.repel == "centre" and self.variant == "corrected":
            raise InputError(
                'meta: repel = "centre" (Eq. 46) has no corrected form, since a force from the covers\' centre cannot '
                'part covers that overlap; use "pairs" or "hinge", or variant = "literal"'
            )
        if self.repel == "hinge" and self.variant == "literal":
            raise InputError(
                'meta: repel = "hinge" is a correction of Eq. 45; variant = "literal" has "pairs" (Eq. 45 as printed) '
                'and "centre" (Eq. 46)'
            )

    def belief(self, goal: SearchGoal) -> Gaussian:
        """What the search will believe about the goal's hole."""
        if self.start == "posterior" and goal.prior.known:
            return goal.prior
        prior = isotropic((0.0, 0.0), self.prior_width)
        if self.start in ("nominal", "posterior"):
            return prior
        seats = [seat for seat in goal.seats if self.start == "pooled" or seat.hole == goal.hole]
        points = seat_points(seats, seated=self.variant == "corrected")
        if self.update == "mle":
            return maximum_likelihood(points, prior)
        if self.variant == "literal":
            return maximum_a_posteriori_as_printed(points, prior, self.mean_penalty, self.covariance_penalty)
        return maximum_a_posteriori(points, prior, self.mean_count, self.covariance_count)

    def search(self, goal: SearchGoal) -> Search:
        """Propose the covers by probability, then, if corrected, what they leave of the search radius."""
        check(goal)
        literal = self.variant == "literal"
        radius = goal.feasible_radius
        belief = floored(self.belief(goal), radius * (1e-3 if literal else 0.5))
        mean = mean_of(belief)
        centre = (float(mean[0]), float(mean[1]))
        reach = reach_of(goal, centre)
        centres, probabilities = plan_covers(
            belief,
            radius,
            self.covers,
            self.repulsion,
            reach,
            self._force(),
            unit=self.unit,
            steps=self.steps,
            step=None if self.step is None else self.step**2,
        )
        covers = [(float(x), float(y)) for x, y in centres]
        for (x, y), probability in zip(covers, probabilities, strict=True):
            yield Proposal(x, y, probability=float(probability), belief=belief)
        if not literal:
            yield from propose(goal, sweep(centre, covers, radius, reach), belief)

    def _force(self) -> Force:
        if self.repel == "centre":
            return "eq_46"
        if self.variant == "literal":
            return "eq_45"
        return "hinge" if self.repel == "hinge" else "overlap"
