"""The aims of palpate's search, against what was measured."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from runtime.experiment.estimates import Estimate
from runtime.experiment.score import GIVES_UP, Row, attempts_ratio, seconds_ratio
from runtime.experiment.study import Choices, aim, listed

if TYPE_CHECKING:
    from runtime.experiment.compare import Compared

AIMED_AT = "realistic"  # the world of the aims
OF_META = 0.40  # of the paper's meta's attempts, for bayes
OF_LIMIT = 1.25  # times the estimated limit, for bayes
OF_META_SECONDS = 0.7  # of the paper's meta's seconds at the hole, for bayes-slide in full physics
SEARCHES = 10_000  # none of them unsolved within the search radius


def verdict(rows: Sequence[Compared], chosen: Choices) -> tuple[str, ...]:
    """One sentence for each aim that these rows can tell about, the order of the strategies, and what to beware of."""
    return (*_aims(rows, chosen), *_orders(rows), *_sliders(rows), *_quitters(rows))


def _aims(rows: Sequence[Compared], chosen: Choices) -> Iterator[str]:
    for component in chosen.components:
        there = {row.strategy: row for row in rows if row.world == AIMED_AT and row.component == component}
        where = f"{AIMED_AT}, {component}"
        if bayes := there.get("bayes"):
            if "meta" in there:
                yield aim(f"{where}: bayes' share of meta's attempts", attempts_ratio(bayes, there["meta"]), OF_META)
            others = [row for name, row in there.items() if name.startswith("meta-")]
            if others:
                best = min(others, key=lambda row: row.score.attempts_per_part.value)
                yield f"{where}: bayes' share of {best.strategy}'s attempts: {attempts_ratio(bayes, best)}."
            found, limit = bayes.score.attempts, bayes.limits.estimate
            ratio = Estimate(found.value / limit, found.error / limit)
            yield aim(f"{where}: bayes' attempts in multiples of the estimated limit", ratio, OF_LIMIT)
            yield _unsolved(where, bayes)
        if "bayes-slide" in there and "meta" in there:
            slide, meta = there["bayes-slide"], there["meta"]
            seconds = seconds_ratio(slide, meta)
            what = f"{where}: bayes-slide's share of meta's seconds at the hole"
            if chosen.physics:
                yield aim(what, seconds, OF_META_SECONDS)
            else:
                yield f"{what}: {seconds} on the statistical model; the aim of {OF_META_SECONDS:g} is about --physics."


def _unsolved(where: str, row: Row) -> str:
    found = row.score
    outside = found.searches - found.within
    told = f"{where}: {row.strategy} left {found.unsolved} of {found.within} searches within R unsolved"
    if outside:
        told += f" ({outside} lay outside)"
    if found.unsolved:
        outcome = "does not hold"
    elif found.within >= SEARCHES:
        outcome = "holds"
    else:
        outcome = (
            f"not decided by so few; --seeds {math.ceil(SEARCHES / max(1, found.within / len(row.records)))} would"
        )
    return f"{told}; aim none in {SEARCHES}: {outcome}."


def _orders(rows: Sequence[Compared]) -> Iterator[str]:
    for place in dict.fromkeys((row.world, row.component) for row in rows):
        there = sorted(
            (row for row in rows if (row.world, row.component) == place),
            key=lambda row: row.score.attempts_per_part.value if row.score.success_rate else math.inf,
        )
        if len(there) > 1:
            told = listed(
                f"{row.strategy} {row.score.attempts_per_part.value:.3g}" for row in there if row.score.success_rate
            )
            yield f"{', '.join(place)}: attempts for each part that was inserted: {told}."


def _sliders(rows: Sequence[Compared]) -> Iterator[str]:
    below = [row for row in rows if row.score.attempts.value < row.limits.bound and row.score.success_rate >= GIVES_UP]
    for strategy in dict.fromkeys(row.strategy for row in below):
        yield (
            f"{strategy} does with less than the limit because that is about pecks, and one slide tries many places "
            "at once: its seconds compare with the others', its attempts do not."
        )


def _quitters(rows: Sequence[Compared]) -> Iterator[str]:
    for strategy in dict.fromkeys(row.strategy for row in rows):
        gave_up = [row for row in rows if row.strategy == strategy and row.score.success_rate < GIVES_UP]
        if gave_up:
            told = listed(f"{1 - row.score.success_rate:.0%} ({row.world}, {row.component})" for row in gave_up)
            yield f"{strategy} leaves many parts out, {told}: its attempts and seconds are few where it gives up early."
