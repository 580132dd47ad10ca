"""The paper's own experiments: its numbers as printed, and what the studies make of them."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from runtime.cell import Tolerances
from runtime.component import COMPONENTS, feasible
from runtime.experiment import covers, table3
from runtime.experiment.cache import Cache
from runtime.experiment.contenders import contender
from runtime.experiment.estimates import Estimate
from runtime.experiment.match import Matching
from runtime.experiment.match_model import Spread, Worlds, draw, pattern, simulate
from runtime.experiment.matched import CAPACITOR, IGBT, MATCHED, MAX_ATTEMPTS, Clock, Matched
from runtime.experiment.matching import BOUNDS, fit_clock
from runtime.experiment.paper import BOARDS, METHODS, TABLE_1, TABLE_2, TABLE_3, CycleTimes
from runtime.experiment.report import write
from runtime.experiment.studies import study
from runtime.experiment.study import Choices, Findings
from runtime.experiment.sweep import Swept, sweep
from runtime.experiment.tables import TABLE1, Row, rows_of, scatter_about_line, trials_of
from runtime.experiment.trial import Trial

FEW = Choices(seeds=3, boards=10, physics=False, worlds=("paper-igbt",), components=("igbt",))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def igbt(folder: Path) -> Swept:
    return sweep(trials_of(IGBT, FEW), Cache(folder), jobs=1)


# What the paper prints


@pytest.mark.parametrize(
    ("table", "means"),
    [
        (TABLE_1, {"linear": 106.92, "spiral": 66.30, "hybrid": 62.36, "meta": 43.05}),
        (TABLE_2, {"linear": 120.45, "spiral": 81.81, "hybrid": 77.59, "meta": 48.89}),
    ],
    ids=["table 1", "table 2"],
)
def test_the_printed_averages_are_not_the_means_of_their_rows(table: CycleTimes, means: dict[str, float]) -> None:
    assert list(table.cycles) == list(METHODS)
    for method in METHODS:
        assert len(table.cycles[method]) == BOARDS
        assert table.row_mean(method) == pytest.approx(means[method], abs=0.006)
        assert round(table.row_mean(method), 1) != table.averages[method]


def test_tables_1_and_3_do_not_agree_on_meta_at_the_best_lambda() -> None:
    assert min(TABLE_3, key=lambda factor: TABLE_3[factor]) == 1e-4
    assert (TABLE_3[1e-4], TABLE_1.averages["meta"]) == (42.5, 42.6)


# Matching


@pytest.mark.parametrize("matched", MATCHED.values(), ids=list(MATCHED))
def test_the_matched_parameters_lie_within_the_bounds_of_the_fit(matched: Matched) -> None:
    for name, (low, high) in BOUNDS.items():
        value = getattr(matched.settings, name, None)
        value = getattr(matched.world.tolerances, name) if value is None else value
        assert low <= value <= high, name


def test_many_seeds_at_once_are_the_trials_one_by_one() -> None:
    seeds = (3,)
    for matched in MATCHED.values():
        tolerances = matched.world.tolerances
        spread = Spread(**{name: getattr(tolerances, name) for name in Spread.__dataclass_fields__})
        assert spread.tolerances == tolerances
        at_once = simulate(draw(matched.component, seeds), spread, matched.settings)
        for one in matched.methods[:3]:
            records = [Trial(matched.world, matched.component, one, seed).run() for seed in seeds]
            attempts = np.array([[search.attempts for search in record] for record in records])
            assert (at_once[one.name].attempts.reshape(len(seeds), -1) == attempts).all()
            seated = np.array([[search.seated for search in record] for record in records])
            assert (at_once[one.name].seated.reshape(len(seeds), -1) == seated).all()


def test_the_approximation_of_meta_is_near_meta(igbt: Swept) -> None:
    tolerances = IGBT.world.tolerances
    spread = Spread(**{name: getattr(tolerances, name) for name in Spread.__dataclass_fields__})
    near = simulate(draw("igbt", FEW.seed_numbers), spread, IGBT.settings)["meta"].attempts.mean()
    meta = next(row for row in rows_of(IGBT, FEW, igbt) if row.method == "meta")
    real = np.mean([search.attempts for seed in meta.records for search in seed])
    assert near == pytest.approx(float(real), rel=0.4)


@pytest.mark.parametrize("component", list(MATCHED))
def test_feasible_errors_are_those_of_the_component(component: str) -> None:
    none = np.zeros((1, BOARDS, 9, 2))
    wider = np.full((1, BOARDS, 9), 0.02e-3)
    worlds = Worlds(component, none, none, none, none, wider)
    errors = np.random.default_rng(1).uniform(-0.4e-3, 0.4e-3, (1, 9, 200, 2))
    found = worlds.feasible(errors, 0)
    expected = [feasible(COMPONENTS[component], x, y, 0.0, 0.02e-3) for x, y in errors.reshape(-1, 2)]
    assert found.ravel().tolist() == expected
    assert 0 < found.sum() < found.size


def test_a_pattern_is_what_the_strategy_proposes_while_nothing_goes_in() -> None:
    points = pattern(IGBT.methods[0], "igbt")
    stride = IGBT.settings.stride
    assert np.hypot(*points[1]) == pytest.approx(stride)
    assert np.hypot(*(points[2] - points[1])) == pytest.approx(2 * stride)
    assert len(points) == min(MAX_ATTEMPTS, IGBT.settings.cycles + 1)


def test_the_clock_is_found_again_from_the_times_it_makes() -> None:
    clock = Clock(part=3.0, attempt=0.3, spiral_attempt=0.5)
    attempts = {name: np.linspace(20.0 + 50 * index, 9.0 + index, BOARDS) for index, name in enumerate(METHODS)}
    cells = {name: tuple(clock.board(name, float(count)) for count in attempts[name]) for name in METHODS}
    found, rmse = fit_clock(CycleTimes(1, "igbt", cells, {}), attempts)
    assert rmse < 1e-9
    assert (found.part, found.attempt, found.spiral_attempt) == pytest.approx((3.0, 0.3, 0.5))


def test_a_short_fit_comes_near_the_table_within_its_bounds() -> None:
    fit = Matching(TABLE_1, seeds=1, generations=0).run()
    assert fit.rmse < 20.0
    for name, (low, high) in BOUNDS.items():
        value = getattr(fit.spread if hasattr(fit.spread, name) else fit.settings, name)
        assert low <= value <= high


# Tables 1 and 2


def by_method(results: Swept) -> dict[str, Row]:
    return {row.method: row for row in rows_of(IGBT, FEW, results)}


def test_the_pattern_of_table_1_on_seeds_that_were_not_fitted(igbt: Swept) -> None:
    rows = by_method(igbt)
    means = [rows[method].mean.value for method in METHODS]
    assert means == sorted(means, reverse=True)
    meta, line = rows["meta"], rows["linear"]
    assert meta.board(9).value < 0.7 * meta.board(0).value
    assert line.times[:, 5:].mean() == pytest.approx(line.times[:, :5].mean(), rel=0.05)
    assert line.share.value < 0.6
    assert meta.share.value > 0.9


def test_a_board_takes_its_parts_and_its_attempts(igbt: Swept) -> None:
    row = by_method(igbt)["hybrid"]
    attempts = sum(search.attempts for search in row.records[1] if search.board == 3)
    clock = IGBT.clock
    seconds = 9 * clock.part + attempts * (clock.attempt + clock.spiral_attempt) / 2
    assert row.times[1, 2] == pytest.approx(seconds)


def test_scatter_is_about_a_straight_line() -> None:
    boards = np.arange(7.0)
    assert scatter_about_line(3.0 * boards + 2.0) == pytest.approx(0.0, abs=1e-9)
    noise = np.array([1.0, -1.0, 0.5, 2.0, -0.5, 0.0, 1.0])
    residuals = noise - np.polyval(np.polyfit(boards, noise, 1), boards)
    assert scatter_about_line(noise - boards) == pytest.approx(math.sqrt((residuals**2).sum() / 5))


def test_the_report_of_table_1_says_who_gives_up_and_what_is_misprinted(igbt: Swept, tmp_path: Path) -> None:
    findings = TABLE1.findings(FEW, igbt)
    verdict = "\n".join(findings.verdict)
    assert "Reproduced: line search does not get faster" in verdict
    assert "linear inserts" in verdict
    assert "gives up" in verdict
    assert "linear 106.6 for 106.92" in verdict
    assert "Cannot be decided" in verdict
    names = {path.name for path in write(TABLE1, FEW, findings, tmp_path)}
    assert names == {"table1.csv", "table1-methods.csv", "table1-cycles.png", "table1-cycles.svg", "table1.md"}
    heading, *lines = (tmp_path / "table1.csv").read_text().splitlines()
    assert heading.startswith("method,from,C1,C1_se,C2,C2_se")
    assert lines[0].startswith("linear,paper,106.2,,105.2,,")
    assert len(lines) == 2 * len(METHODS)
    assert "What the paper leaves out" in (tmp_path / "table1.md").read_text()


def test_one_board_and_one_seed_are_enough_for_a_report(folder: Path) -> None:
    one = replace(FEW, seeds=1, boards=1)
    findings = TABLE1.findings(one, sweep(trials_of(IGBT, one), Cache(folder), jobs=1))
    assert any("order of the four methods" in sentence for sentence in findings.verdict)
    assert len(findings.tables[0].columns) == 4


# The seventh hole


def test_the_seventh_hole_is_told_apart(igbt: Swept, tmp_path: Path) -> None:
    anomaly = study("anomaly")
    findings = anomaly.findings(FEW, igbt)
    rows = {(row[1], row[2]): row for row in findings.tables[0].rows}
    attempts = [search.attempts for seed in by_method(igbt)["meta"].records for search in seed if search.hole == "7"]
    seventh = rows["meta", "hole 7"][6]
    assert isinstance(seventh, Estimate)
    assert seventh.value == pytest.approx(float(np.mean(attempts)))
    assert len(findings.tables[1].rows) == 2 * len(METHODS) * BOARDS
    names = {path.name for path in write(anomaly, FEW, findings, tmp_path)}
    assert {"anomaly.csv", "anomaly-boards.csv", "anomaly-holes.png", "anomaly-holes.svg"} <= names


def test_the_seventh_hole_is_harder_once_nearly_all_holes_are_found() -> None:
    tolerances = CAPACITOR.world.tolerances
    spread = Spread(**{name: getattr(tolerances, name) for name in Spread.__dataclass_fields__})
    late = simulate(draw("capacitor", range(1, 31)), spread, CAPACITOR.settings)["meta"].attempts[:, 5:]
    assert late[..., 6].mean() > 1.5 * np.delete(late, 6, axis=2).mean()


def test_anomaly_runs_the_trials_of_the_tables() -> None:
    both = replace(FEW, components=("igbt", "capacitor"))
    assert list(study("anomaly").work(both)) == [*trials_of(IGBT, both), *trials_of(CAPACITOR, both)]


# Table 3


def test_lambda_is_over_the_square_of_its_unit() -> None:
    line = table3.Line(table3.PAIRS, 10e-6, "stable")
    settings = line.contender(1e-4).settings
    assert settings["repulsion"] == "1e+06 m^-2"
    assert "unit" not in settings
    assert table3.Line(table3.EQ_45, 30e-6, "stable").contender(1e-4).settings["unit"] == "30 um"
    for one in table3.LINES:
        assert one.contender(1e-2).make() is not None


def test_a_sweet_spot_is_an_inner_lambda_better_than_both_ends() -> None:
    def cells(*times: float, scatter: float = 1.0) -> list[table3.Cell]:
        signs = [(1, -1, 0), (-1, 1, 0), (0, 1, -1), (1, 0, -1), (-1, 0, 1)]
        seconds = [tuple(time + sign * scatter for sign in three) for time, three in zip(times, signs, strict=True)]
        return [table3.Cell(one, Estimate(1.0, 0.0)) for one in seconds]

    assert table3.sweet_spot(cells(60.0, 50.0, 40.0, 70.0, 80.0))
    assert not table3.sweet_spot(cells(60.0, 61.0, 60.0, 70.0, 80.0))
    assert not table3.sweet_spot(cells(60.0, 50.0, 40.0, 41.0, 40.5))
    assert not table3.sweet_spot(cells(60.0, 50.0, 40.0, 70.0, 80.0, scatter=40.0))


def test_table_3_reports_every_reading(folder: Path, tmp_path: Path) -> None:
    lines = [table3.Line(rule, 30e-6, "stable") for rule in table3.RULES]
    one = Choices(seeds=1, boards=1, physics=False, worlds=("paper-igbt",))
    lambdas = table3.Lambda(lines)
    findings = lambdas.findings(one, sweep(lambdas.work(one), Cache(folder), jobs=1))
    assert [row[1] for row in findings.tables[0].rows] == ["the paper", *(line.rule.name for line in lines)]
    assert findings.tables[0].rows[0][4:] == (72.5, 56.9, 42.5, 85.2, 89.4)
    assert sum("Cannot be decided" in sentence for sentence in findings.verdict) == 1
    names = {path.name for path in write(lambdas, one, findings, tmp_path)}
    assert {"table3.csv", "table3-inserted.csv", "table3-paper-igbt.png", "table3-paper-igbt.svg"} <= names


# Fig. 12


@pytest.fixture(scope="module")
def layouts() -> dict[str, covers.Layout]:
    return {rule.key: covers.layout(rule) for rule in covers.RULES}


def test_covers_collapse_without_repulsion_and_not_with_it(layouts: dict[str, covers.Layout]) -> None:
    without, repelled = layouts["none"], layouts["pairs"]
    assert without.nearest < 1e-9
    assert without.different == 1
    assert without.masses.sum() > 1
    assert without.union < 0.2
    assert repelled.different == covers.COUNT
    assert repelled.nearest > repelled.radius
    assert repelled.union > 5 * without.union
    assert layouts["hinge"].union > 4 * without.union


def test_the_equations_as_printed_gather_covers_or_drive_them_off(layouts: dict[str, covers.Layout]) -> None:
    for equation in ("eq45", "eq46"):
        assert layouts[f"{equation}-weak"].different == 1
        assert layouts[f"{equation}-strong"].union < 0.01
        assert layouts[f"{equation}-strong"].farthest == pytest.approx(covers.REACH, rel=1e-3)


def test_the_union_of_one_place_is_the_mass_of_one_disc(layouts: dict[str, covers.Layout]) -> None:
    one = layouts["none"]
    assert one.union == pytest.approx(float(one.masses[0]), rel=2e-3)
    hinge = layouts["hinge"]
    assert float(hinge.masses.max()) < hinge.union < float(hinge.masses.sum())


def test_the_covers_study_needs_no_trials_and_draws_two_figures(tmp_path: Path) -> None:
    fig12 = study("covers")
    assert list(fig12.work(fig12.defaults)) == []
    findings: Findings = fig12.findings(fig12.defaults, Swept({}, 0))
    assert sum(sentence.startswith("Reproduced") for sentence in findings.verdict) == 2
    names = {path.name for path in write(fig12, fig12.defaults, findings, tmp_path)}
    assert {"covers.csv", "covers-fig12.png", "covers-fig12.svg", "covers-rules.png", "covers.md"} <= names


@pytest.mark.parametrize("name", ["table1", "table2", "table3", "anomaly", "covers", "match"])
def test_the_studies_are_found_by_name(name: str) -> None:
    assert study(name).name == name


def test_the_matched_worlds_have_no_radius_that_ends_a_search() -> None:
    assert IGBT.world.search.max_attempts == MAX_ATTEMPTS
    assert isinstance(IGBT.world.tolerances, Tolerances)
    assert contender("meta").strategy == IGBT.methods[3].strategy
