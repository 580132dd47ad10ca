"""How well a strategy did: what its search records say, over all seeds.

A search that failed counts with the attempts and the time that it used, so a strategy that gives up early looks cheap:
the share of parts inserted, and all attempts for each part inserted, stand beside.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from runtime.experiment.contenders import contender
from runtime.experiment.estimates import Estimate, mean_over_seeds, percentile_95, ratio_over_seeds
from runtime.experiment.study import Choices, Results
from runtime.experiment.trial import trials
from runtime.experiment.worlds import world
from runtime.plugin import SearchRecord

GIVES_UP = 0.95  # share of parts inserted below which few attempts say little

Records = Sequence[Sequence[SearchRecord]]  # of one strategy in one world: for each seed, every search in order


@dataclass(frozen=True)
class Score:
    """Figures of one strategy in one world."""

    searches: int
    attempts: Estimate  # for each search
    attempts_p95: float
    attempts_per_part: Estimate  # all attempts for each part that was inserted
    search_time: Estimate  # [s] at the hole for each search
    board_time: Estimate  # [s] for each board, with fetching the parts
    inserted: Estimate  # share of the searches
    failed: int  # searches that did not
    within: int  # searches whose hole was within the search radius of nominal
    unsolved: int  # of those, not inserted

    @property
    def success_rate(self) -> float:
        """Share of the searches that inserted their part."""
        return self.inserted.value


def score(records: Records, radius: float) -> Score:
    """Figures of a strategy. `radius` [m] is the search radius."""
    within = [search for seed in records for search in seed if math.hypot(*search.offset) <= radius]
    return Score(
        searches=sum(len(seed) for seed in records),
        attempts=mean_over_seeds(attempts(records)),
        attempts_p95=percentile_95(attempts(records)),
        attempts_per_part=ratio_over_seeds(
            attempts(records), [[float(search.seated) for search in seed] for seed in records]
        ),
        search_time=mean_over_seeds(search_times(records)),
        board_time=mean_over_seeds([_board_times(seed) for seed in records]),
        inserted=mean_over_seeds([[float(search.seated) for search in seed] for seed in records]),
        failed=sum(not search.seated for seed in records for search in seed),
        within=len(within),
        unsolved=sum(not search.seated for search in within),
    )


@dataclass(frozen=True)
class Row:
    """One strategy in one world with one component."""

    world: str
    component: str
    strategy: str
    records: Records
    score: Score


def rows_of(chosen: Choices, results: Results, strategies: Sequence[str]) -> list[Row]:
    """A row for each world, component and strategy, in this order."""
    rows = []
    for name in chosen.worlds:
        place = world(name)
        for component in chosen.components:
            for strategy in strategies:
                records = [results[trial] for trial in trials(chosen, place, component, contender(strategy))]
                rows.append(Row(name, component, strategy, records, score(records, place.search.radius)))
    return rows


def attempts_ratio(above: Row, below: Row) -> Estimate:
    """Attempts of one row over those of another in the same world, seeds paired."""
    return ratio_over_seeds(attempts(above.records), attempts(below.records))


def seconds_ratio(above: Row, below: Row) -> Estimate:
    """The same for the seconds at the hole."""
    return ratio_over_seeds(search_times(above.records), search_times(below.records))


def attempts(records: Records) -> list[list[float]]:
    """Attempts of each search, by seed."""
    return [[float(search.attempts) for search in seed] for seed in records]


def search_times(records: Records) -> list[list[float]]:
    """Time at the hole [s] of each search, by seed."""
    return [[search.search_time for search in seed] for seed in records]


def by_board(records: Records) -> dict[int, Estimate]:
    """Attempts for each search, board by board."""
    boards = sorted({search.board for seed in records for search in seed})
    return {
        board: mean_over_seeds(
            [[float(search.attempts) for search in seed if search.board == board] for seed in records]
        )
        for board in boards
    }


def solved_within(records: Records, counts: Sequence[int]) -> list[float]:
    """Share of the searches that inserted their part with at most so many attempts, for each count."""
    needed = np.array([search.attempts if search.seated else math.inf for seed in records for search in seed])
    return [float(np.mean(needed <= count)) for count in counts]


def _board_times(seed: Sequence[SearchRecord]) -> list[float]:
    times: defaultdict[int, float] = defaultdict(float)
    for search in seed:
        times[search.board] += search.part_time
    return list(times.values())
