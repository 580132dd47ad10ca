"""Meta search: learn the distribution of a hole's offset, then try where most of it lies (the paper's Algorithm 2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field

from runtime.belief import floored, isotropic, maximum_a_posteriori, maximum_likelihood, mean_of, seat_points
from runtime.messages import Gaussian, Proposal, SearchGoal
from runtime.plugin import Search
from runtime.quantity import InverseArea, Length, NotNegative, Positive
from strategies.covers import plan_covers, sweep
from strategies.start import Start, Variant, check, propose, reach_of


@dataclass(frozen=True)
class Meta:
    """Covers a learnt normal distribution with discs of the feasible radius and tries the most probable first.

    Algorithm 2: begin from a normal about nominal (`prior_width`), learn from earlier insertions by Eqs. 26-27
    (`mle`, the prior until three are there) or with the prior as pseudo-counts (`map`, for Eqs. 28-30, which have no
    maximum as printed), place `covers` discs by gradient ascent on Eq. 45, and try them by probability.

    `start` says whose insertions count, which the paper leaves open: this hole's, all (`pooled`), none (`nominal`), or
    it takes the posterior store's belief as it is (`posterior`).

    literal: Eq. 45 with its sign as printed, under which covers collapse or flee; insertions count with the candidate
    that succeeded; the search ends with its covers. corrected: covers repel while they overlap; insertions count with
    the seated position; no direction is believed narrower than half the feasible radius, as a success shows no more;
    when the covers have run out a bounded sweep searches what is left of the search radius.
    """

    start: Start = "hole"
    update: Literal["map", "mle"] = "map"
    prior_width: Annotated[Length, Positive] = 0.5e-3  # [m] standard deviation before anything is known
    mean_count: Annotated[float, Positive] = 0.3  # insertions that the prior mean is worth (map)
    covariance_count: Annotated[float, Positive] = 4.0  # insertions that the prior covariance is worth (map)
    covers: Annotated[int, Field(ge=1, le=200)] = 30  # n
    repulsion: Annotated[InverseArea, NotNegative] = 2e7  # [1/m^2] lambda
    variant: Variant = "corrected"

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
        centres, probabilities = plan_covers(belief, radius, self.covers, self.repulsion, reach, literal=literal)
        covers = [(float(x), float(y)) for x, y in centres]
        for (x, y), probability in zip(covers, probabilities, strict=True):
            yield Proposal(x, y, probability=float(probability), belief=belief)
        if literal:
            return
        for x, y in sweep(centre, covers, radius, reach):
            yield propose(goal, x, y, belief)
