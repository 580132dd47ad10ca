"""How the matched worlds, settings and clock were found: anyone can find them again."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from runtime.experiment.match_model import ABNORMAL_FACTOR, Spread
from runtime.experiment.matched import MATCHED, REPULSION
from runtime.experiment.matching import BOUNDS, FIRST_SEED, PARTS, Match, match
from runtime.experiment.paper import TABLE_1, TABLE_2, CycleTimes
from runtime.experiment.study import Assumption, Choices, Findings, Results, Table, Value

TABLES = {table.component: table for table in (TABLE_1, TABLE_2)}
GENERATIONS = 25  # of differential evolution


@dataclass(frozen=True)
class Matching:
    """The fit to one table."""

    table: CycleTimes
    seeds: int
    generations: int = GENERATIONS

    @property
    def content(self) -> Mapping[str, Any]:
        """The printed cells and how hard is tried."""
        return {"table": self.table, "seeds": self.seeds, "generations": self.generations}

    @property
    def code(self) -> tuple[str, ...]:
        """The fit, and the strategies whose candidates it tries."""
        return (match.__module__, "strategies.linear", "strategies.spiral", "strategies.hybrid")

    def run(self) -> Match:
        """Some minutes."""
        return match(self.table, self.seeds, self.generations)


class MatchStudy:
    """The fits to Tables 1 and 2, beside what the worlds and tables use."""

    name = "match"
    summary = "fits tolerances, settings and clock to the paper's Tables 1 and 2 (minutes on one core for each)"
    defaults = Choices(seeds=24, components=tuple(TABLES))

    def work(self, chosen: Choices) -> Sequence[Matching]:
        """One fit for each component; it takes no others than those of the tables."""
        return [Matching(TABLES[name], chosen.seeds) for name in chosen.components]

    def findings(self, chosen: Choices, results: Results) -> Findings:
        """The parameters found, and those in use."""
        fits = {name: results[Matching(TABLES[name], chosen.seeds)] for name in chosen.components}
        return Findings(
            tables=(_table(fits),),
            verdict=tuple(
                f"{name}: {fit.rmse:.2g} s root mean square from the cells of Table {TABLES[name].number}, on the "
                f"seeds fitted to and with a lattice in place of meta's covers; `table{TABLES[name].number}` tells it "
                "of other seeds and of meta itself."
                for name, fit in fits.items()
            ),
            assumptions=ASSUMPTIONS,
        )


def _table(fits: Mapping[str, Match]) -> Table:
    rows: list[tuple[Value, ...]] = []
    for component, fit in fits.items():
        used = MATCHED[component]
        tolerances, settings = used.world.tolerances, used.settings
        for name, bounds in BOUNDS.items():
            found = getattr(fit.spread if hasattr(fit.spread, name) else fit.settings, name)
            kept = getattr(tolerances if name in Spread.__dataclass_fields__ else settings, name)
            scale, unit = _readable(name)
            rows.append((component, name, *(scale * float(x) for x in (found, kept, *bounds)), unit))
        for name, bounds in zip(("part", "attempt", "spiral_attempt"), PARTS, strict=True):
            rows.append((component, name, getattr(fit.clock, name), getattr(used.clock, name), *bounds, "s"))
    return Table(
        "",
        "What was found now, and what worlds and tables use",
        ("component", "parameter", "found", "in use", "from", "to", "unit"),
        tuple(rows),
    )


def _readable(name: str) -> tuple[float, str]:
    if name == "step":
        return 180 / math.pi, "deg"
    return (1.0, "") if name == "cycles" or name.endswith("count") else (1e3, "mm")


ASSUMPTIONS = (
    Assumption("seeds", f"from {FIRST_SEED}", "others than those that the tables are told about"),
    Assumption(
        "loss",
        "root mean square over the 40 cells of a table; the clock by bounded least squares inside",
        "chosen: the paper gives no errors to weigh cells by",
    ),
    Assumption(
        "hole 7",
        f"parts scatter {ABNORMAL_FACTOR:g} times as far, and part scatter has a lower bound",
        "chosen: tables of whole boards do not determine it, and without the bound the fit makes it vanish",
    ),
    Assumption(
        "meta",
        "a triangular lattice of 1.5 feasible radii in order of probability, in place of covers by gradient ascent",
        f"chosen for speed; {1e-6 * REPULSION:g} per mm² of repulsion comes near it",
    ),
)

STUDY = MatchStudy()
