"""What the paper prints about its experiments, as it prints it.

Source: `meta-search-paper.tex`, Tables 1-3 and the text around them. All times are seconds of the paper's cell.
"""

from __future__ import annotations

from dataclasses import dataclass

BOARDS, HOLES = 10, 9
ABNORMAL_HOLE = 7

METHODS = ("linear", "spiral", "hybrid", "meta")
"""Line, spiral, hybrid and meta search, by the names of the strategies here; the slowest first."""


@dataclass(frozen=True)
class CycleTimes:
    """A table of assembly cycle times [s]: boards C1 to C10 of each method, and the average printed beside."""

    number: int
    component: str
    cycles: dict[str, tuple[float, ...]]
    averages: dict[str, float]

    def row_mean(self, method: str) -> float:
        """Mean [s] of a method's printed row, which is not the average that is printed beside it."""
        return sum(self.cycles[method]) / len(self.cycles[method])


TABLE_1 = CycleTimes(
    1,
    "igbt",
    {
        "linear": (106.2, 105.2, 106.0, 106.9, 107.7, 104.8, 109.2, 108.5, 105.6, 109.1),
        "spiral": (102.7, 72.1, 64.6, 58.3, 62.8, 60.4, 63.8, 59.9, 57.3, 61.1),
        "hybrid": (78.1, 64.8, 62.6, 63.6, 60.8, 61.5, 59.2, 57.7, 56.8, 58.5),
        "meta": (73.5, 48.8, 40.9, 40.3, 42.0, 38.7, 36.4, 36.6, 37.7, 35.6),
    },
    {"linear": 106.6, "spiral": 66.0, "hybrid": 62.3, "meta": 42.6},
)
TABLE_2 = CycleTimes(
    2,
    "capacitor",
    {
        "linear": (120.5, 118.7, 119.3, 121.1, 122.4, 117.9, 120.6, 120.8, 119.2, 124.0),
        "spiral": (98.3, 85.6, 82.1, 79.4, 81.2, 78.9, 79.5, 77.3, 76.1, 79.7),
        "hybrid": (92.4, 80.7, 77.6, 78.2, 76.5, 75.8, 74.9, 73.1, 72.3, 74.4),
        "meta": (65.2, 54.3, 49.8, 48.7, 47.9, 46.2, 45.1, 44.3, 43.9, 43.5),
    },
    {"linear": 120.3, "spiral": 81.6, "hybrid": 76.3, "meta": 47.1},
)
TABLE_3 = {1e-2: 89.4, 1e-3: 85.2, 1e-4: 42.5, 1e-5: 56.9, 1e-6: 72.5}
"""Average assembly time [s] of meta search by the regularisation factor lambda, whose unit is not stated."""
