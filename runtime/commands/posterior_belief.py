"""What the evidence of a board type says about its holes, rebuilt from nothing else, and a picture of it."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from runtime.belief import belief_about, covariance_of, seat_points
from runtime.messages import Gaussian, Miss, Seat


@dataclass(frozen=True)
class HoleBelief:
    """What is known about one hole before the next part goes into a new board."""

    hole: str
    insertions: int
    blocked: int  # attempts
    belief: Gaussian
    seats: tuple[tuple[float, float], ...]  # [m] offsets from nominal of earlier insertions

    @property
    def mean(self) -> tuple[float, float]:
        """[m]."""
        return self.belief.x, self.belief.y

    @property
    def deviations(self) -> tuple[float, float]:
        """Standard deviations along x and y [m]."""
        return math.sqrt(self.belief.xx), math.sqrt(self.belief.yy)


def hole_beliefs(seats: Sequence[Seat], misses: Sequence[Miss], prior_width: float) -> list[HoleBelief]:
    """Every hole that evidence speaks of, by name; `prior_width` [m] is believed before anything is known."""
    inserted = Counter(seat.hole for seat in seats)
    blocked = Counter(miss.hole for miss in misses)
    return [
        HoleBelief(
            hole,
            inserted[hole],
            blocked[hole],
            belief_about(hole, seats, prior_width)[0],
            tuple((float(x), float(y)) for x, y in seat_points([seat for seat in seats if seat.hole == hole])),
        )
        for hole in sorted({*inserted, *blocked}, key=_natural)
    ]


def draw(beliefs: Mapping[str, Sequence[HoleBelief]], path: Path) -> None:
    """Draw each hole's standard ellipse and its insertions, one panel for each title."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.5 * len(beliefs), 5.5), layout="constrained", dpi=120)
    FigureCanvasAgg(figure)
    for axes, (title, holes) in zip(figure.subplots(1, len(beliefs), squeeze=False)[0], beliefs.items(), strict=True):
        for number, hole in enumerate(holes):
            _draw_hole(axes, hole, f"C{number % 10}")
        axes.plot(0, 0, "+", color="black", markersize=14, label="nominal")
        axes.set(title=title, xlabel="x from nominal [mm]", ylabel="y from nominal [mm]", aspect="equal")
        axes.margins(0.1)
        axes.grid(alpha=0.3)
        axes.legend(fontsize="small", ncols=1 + len(holes) // 12)
    figure.savefig(path)


def _draw_hole(axes: Any, hole: HoleBelief, colour: str) -> None:
    import numpy as np
    from matplotlib.patches import Ellipse

    variances, directions = np.linalg.eigh(covariance_of(hole.belief))
    narrow, wide = 2e3 * np.sqrt(np.maximum(variances, 0.0))
    angle = math.degrees(math.atan2(directions[1, 1], directions[0, 1]))
    centre = hole.mean[0] * 1e3, hole.mean[1] * 1e3
    axes.add_patch(Ellipse(centre, wide, narrow, angle=angle, fill=False, edgecolor=colour, label=hole.hole))
    axes.scatter(*(1e3 * np.array(hole.seats).reshape(-1, 2)).T, s=8, color=colour, alpha=0.6)


def _natural(name: str) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", name)]
