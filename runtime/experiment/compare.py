"""Every strategy in every world: attempts, seconds, failures, and how far each is from what is possible at all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from runtime.experiment import compare_figures
from runtime.experiment.compare_verdict import verdict
from runtime.experiment.contenders import CONTENDERS, contender
from runtime.experiment.estimates import Estimate, mean_over_seeds
from runtime.experiment.limit import Limits
from runtime.experiment.limit_work import LimitWork
from runtime.experiment.score import Records, Row, attempts, rows_of
from runtime.experiment.study import Assumption, Choices, Findings, Results, Table, Work
from runtime.experiment.trial import trials
from runtime.experiment.worlds import world

COLUMNS = (
    "world",
    "component",
    "strategy",
    "attempts_mean",
    "attempts_se",
    "attempts_p95",
    "search_s_mean",
    "board_s_mean",
    "success_rate",
    "ratio_to_oracle",
    "ratio_to_limit",
)
LATE = 6  # the first board that counts as late


@dataclass(frozen=True)
class Compared(Row):
    """A row beside what is possible."""

    limits: Limits


class Compare:
    """Strategies x worlds x components."""

    name = "compare"
    summary = "every strategy in several worlds, beside the oracle and the limit of what is possible"
    defaults = Choices(
        seeds=60,
        boards=10,
        physics=False,
        strategies=tuple(CONTENDERS),
        worlds=("realistic", "located", "paper-igbt", "paper-capacitor"),
        components=("igbt", "capacitor"),
    )

    def work(self, chosen: Choices) -> Sequence[Work[Any]]:
        """Trials of all, and the limits."""
        found: list[Work[Any]] = []
        for name in chosen.worlds:
            for component in chosen.components:
                found.append(LimitWork(world(name), component, chosen.boards))
                for strategy in chosen.strategies:
                    found += trials(chosen, world(name), component, contender(strategy))
        return found

    def findings(self, chosen: Choices, results: Results) -> Findings:
        """Tables, figures, verdict."""
        rows = [
            Compared(**vars(row), limits=results[LimitWork(world(row.world), row.component, chosen.boards)])
            for row in rows_of(chosen, results, chosen.strategies)
        ]
        return Findings(
            tables=(_exact(rows), _readable(rows, chosen.boards), _limits(rows)),
            figures=compare_figures.pictures(rows, chosen),
            verdict=verdict(rows, chosen),
            assumptions=ASSUMPTIONS,
        )


def _exact(rows: Sequence[Compared]) -> Table:
    return Table(
        "",
        "Strategies compared",
        COLUMNS,
        tuple(
            (
                row.world,
                row.component,
                row.strategy,
                row.score.attempts.value,
                row.score.attempts.error,
                row.score.attempts_p95,
                row.score.search_time.value,
                row.score.board_time.value,
                row.score.success_rate,
                row.score.attempts.value / row.limits.oracle,
                row.score.attempts.value / row.limits.estimate,
            )
            for row in rows
        ),
        shown=False,
    )


def _readable(rows: Sequence[Compared], boards: int) -> Table:
    late = (f"on boards {LATE}-{boards}",) if boards >= LATE else ()
    return Table(
        "details",
        "Attempts and seconds for each search, ± standard error over seeds. A search that failed counts with the "
        "attempts it used",
        (
            "world",
            "component",
            "strategy",
            "attempts",
            *late,
            "p95",
            "x limit",
            "attempts per part inserted",
            "s at the hole",
            "s per board",
            "inserted",
        ),
        tuple(
            (
                row.world,
                row.component,
                row.strategy,
                row.score.attempts,
                *((_late(row.records),) if late else ()),
                row.score.attempts_p95,
                row.score.attempts.value / row.limits.estimate,
                row.score.attempts_per_part,
                row.score.search_time,
                row.score.board_time,
                f"{row.score.success_rate:.2%}",
            )
            for row in rows
        ),
    )


def _late(records: Records) -> Estimate:
    return mean_over_seeds(attempts([[search for search in seed if search.board >= LATE] for seed in records]))


def _limits(rows: Sequence[Compared]) -> Table:
    places = {(row.world, row.component): row.limits for row in rows}
    return Table(
        "limits",
        "What is possible: mean attempts for each insertion",
        ("world", "component", "oracle", "no strategy can do with less than", "estimated limit"),
        tuple((*place, limits.oracle, limits.bound, limits.estimate) for place, limits in places.items()),
    )


ASSUMPTIONS = (
    Assumption(
        "world realistic",
        "boards 0.5 mm and 4 mrad, holes 0.3 mm, parts 0.15 mm and 2 mrad, hole 7 three times that, taught 0.5 mm off",
        "chosen: a bare board loose on its carrier, parts in a printed clamp",
    ),
    Assumption("world located", "boards 0.1 mm and 1 mrad", "chosen: the same, with the board on locating pins"),
    Assumption(
        "worlds paper-igbt, paper-capacitor",
        "as `runtime/experiment/worlds.py` lists them",
        "fitted to the paper's Tables 1 and 2, which state no tolerance at all",
    ),
    Assumption("size of the holes", "0.025 mm standard deviation of the radius", "chosen: plating of drilled holes"),
    Assumption("search", "2.5 mm about nominal, 400 attempts at most", "chosen: the same for all strategies"),
)

STUDY = Compare()
