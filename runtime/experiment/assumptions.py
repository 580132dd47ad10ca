"""What the paper leaves out, and what stands in for it: for the reports of its experiments."""

from __future__ import annotations

import math

from runtime.component import COMPONENTS, feasible_radius
from runtime.experiment.matched import MAX_ATTEMPTS, REPULSION, SEARCH, Matched
from runtime.experiment.study import Assumption


def assumptions(matched: Matched, table: int) -> tuple[Assumption, ...]:
    """Every parameter of the paper's experiments that it does not state, with its value here."""
    world, settings, clock = matched.world.tolerances, matched.settings, matched.clock
    fitted = f"fitted to Table {table} (`palpate experiment match`)"
    chosen = "chosen; the table does not determine it"
    radius = feasible_radius(COMPONENTS[matched.component])
    return (
        Assumption(
            "tolerances",
            f"taught {_mm(world.common_error)} off in a random direction; per axis and standard deviation: boards "
            f"{_mm(world.board_shift)}, holes {_mm(world.hole_bias)}, parts {_mm(world.part_scatter)}",
            fitted,
        ),
        Assumption("rotation of boards and parts", "none", chosen),
        Assumption(
            "hole 7",
            f"its parts scatter {world.abnormal_factor:g} times as far as the others'",
            'chosen: the paper says "more scattered", no more, and its tables give whole boards',
        ),
        Assumption(
            "feasible area",
            f"the component's own, as large as a disc of {_mm(radius)}; radius of the holes ± {_mm(world.hole_radius)}",
            "chosen: the drawing's pins and holes; a tenth of variation for plating",
        ),
        Assumption(
            "line",
            f"stride {_mm(settings.stride)} (its distances grow by it, Eqs. 10-11), ends after {settings.cycles + 1} "
            "attempts; 45 degrees",
            f"{fitted}; the direction of the line is chosen, that of the taught error being random",
        ),
        Assumption(
            "spiral",
            f"{math.degrees(settings.step):.3g} degrees from attempt to attempt, {_mm(settings.pitch)} from turn to "
            "turn",
            fitted,
        ),
        Assumption("hybrid", "line and spiral as above, one step of each by turns", "the paper's list of strategies"),
        Assumption(
            "starting points",
            "the mean of the same hole's earlier successful candidates; nominal before there are any",
            '"mean of all preceding positions": per hole is chosen, pooled over holes would be a reading too',
        ),
        Assumption(
            "meta: what it believes first, and how fast it learns",
            f"standard deviation {_mm(settings.prior_width)}; its mean counts as {settings.mean_count:.2g} insertions, "
            f"its covariance as {settings.covariance_count:.2g}; per hole",
            f"{fitted}; a normal-inverse-Wishart prior stands in for Eqs. 28-30, which have no solution",
        ),
        Assumption(
            "meta: covers",
            f"{MAX_ATTEMPTS}, kept apart by lambda = {1e-6 * REPULSION:.3g} per mm² with the sign of Eq. 45 mended "
            "(`pairs`)",
            "chosen: as many as attempts, side by side; with the sign as printed covers gather or flee, see `table3`",
        ),
        Assumption(
            "the longest search",
            f"{MAX_ATTEMPTS} attempts, anywhere within {_mm(SEARCH.radius)} of nominal",
            'chosen: "the maximum allotted search time", whose length is not stated',
        ),
        Assumption(
            "seconds",
            f"{clock.part:.3g} s for each part and {clock.attempt:.3g} s for each attempt; of the spiral's "
            f"{clock.spiral_attempt:.3g} s, of hybrid the mean of both",
            f"{fitted} by least squares; the paper's cell is another than the simulated one",
        ),
    )


def _mm(length: float) -> str:
    return f"{1e3 * length:.3g} mm"
