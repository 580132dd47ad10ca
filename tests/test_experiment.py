"""Experiments: trials in parallel, kept by content, and told as tables, figures and a verdict."""

from __future__ import annotations

import csv
import gzip
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from cells import Palpate

from runtime.errors import InputError, SessionError
from runtime.experiment.cache import Cache, default_folder, key_of
from runtime.experiment.contenders import Contender, contender
from runtime.experiment.estimates import Estimate, mean_over_seeds, percentile_95, ratio_over_seeds
from runtime.experiment.executor import executor
from runtime.experiment.limit import Limits
from runtime.experiment.limit_work import LimitWork
from runtime.experiment.report import text, write
from runtime.experiment.score import by_board, score, solved_within
from runtime.experiment.source import digest, files
from runtime.experiment.studies import STUDIES, study
from runtime.experiment.study import Assumption, Choices, Findings, Picture, Table, aim
from runtime.experiment.sweep import Progress, sweep
from runtime.experiment.trial import Trial, trials
from runtime.experiment.worlds import world
from runtime.plugin import SearchRecord

COMPARE = (
    "world,component,strategy,attempts_mean,attempts_se,attempts_p95,search_s_mean,board_s_mean,"
    "success_rate,ratio_to_oracle,ratio_to_limit"
)
SPIRAL = Trial(world("realistic"), "igbt", contender("spiral"), seed=1, boards=1)
FEW = [
    Trial(world(place), "igbt", contender(name), seed, boards=1)
    for place in ("realistic", "located")
    for name in ("spiral", "linear")
    for seed in (1, 2)
]


@pytest.fixture
def palpate(tmp_path: Path) -> Palpate:
    return Palpate(tmp_path)


def wait_until(holds: Any, what: str, timeout: float = 60.0) -> None:
    end = time.monotonic() + timeout
    while not holds():
        assert time.monotonic() < end, f"not within {timeout:g} s: {what}"
        time.sleep(0.01)


# What a result is kept under


@pytest.mark.parametrize(
    "other",
    [
        replace(SPIRAL, seed=2),
        replace(SPIRAL, boards=2),
        replace(SPIRAL, component="capacitor"),
        replace(SPIRAL, physics=True),
        replace(SPIRAL, world=world("located")),
        replace(SPIRAL, world=replace(SPIRAL.world, search=replace(SPIRAL.world.search, max_attempts=99))),
        replace(SPIRAL, world=replace(SPIRAL.world, tolerances=replace(SPIRAL.world.tolerances, hole_bias=0.2999e-3))),
        replace(SPIRAL, contender=contender("hybrid")),
        replace(SPIRAL, contender=contender("spiral-nominal")),
        replace(SPIRAL, contender=replace(SPIRAL.contender, prior=True)),
    ],
    ids=lambda _trial: "other",
)
def test_other_content_has_another_key(other: Trial) -> None:
    assert key_of(other) != key_of(SPIRAL)


def test_names_descriptions_and_the_order_of_settings_are_not_content() -> None:
    renamed = replace(
        SPIRAL,
        world=replace(SPIRAL.world, name="elsewhere", description="the same"),
        contender=Contender("corkscrew", "spiral", {}, "the same"),
    )
    assert key_of(renamed) == key_of(SPIRAL)
    settings: dict[str, Any] = {"start": "nominal", "pitch": 1.0}
    one = replace(SPIRAL, contender=Contender("a", "spiral", settings))
    two = replace(SPIRAL, contender=Contender("a", "spiral", dict(reversed(settings.items()))))
    assert key_of(one) == key_of(two)
    assert hash(one) == hash(two)


def test_the_code_of_the_strategy_and_of_the_job_is_content() -> None:
    modules = files(SPIRAL.code)
    assert {"strategies.spiral", "strategies.patterns", "runtime.plain_job", "runtime.experiment.model"} <= set(modules)
    assert {"runtime.world", "runtime.component", "runtime.belief", "runtime.strategy_host"} <= set(modules)
    assert not {name for name in modules if name.startswith(("drivers", "runtime.zenoh", "strategies.meta"))}
    physical = files(replace(SPIRAL, physics=True).code)
    assert {"drivers.ur3e.scene", "drivers.ur3e.skill", "drivers.ur3e.bare_run"} <= set(physical)
    assert "runtime.experiment.model" not in physical


def test_a_change_in_what_a_foreign_strategy_imports_changes_its_digest(tmp_path: Path) -> None:
    (tmp_path / "foreign").mkdir()
    (tmp_path / "foreign" / "__init__.py").write_text("")
    (tmp_path / "foreign" / "rings.py").write_text("from .steps import STEP\nfrom runtime.messages import Proposal\n")
    helper = tmp_path / "foreign" / "steps.py"

    def found(text: str) -> list[str]:
        helper.write_text(text)
        program = (
            "from runtime.experiment.source import digest, files;"
            "print(digest(('foreign.rings',)), *files(('foreign.rings',)))"
        )
        done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=True)
        return done.stdout.split()

    before = found("STEP = 0.2e-3\n")
    assert {"foreign", "foreign.rings", "foreign.steps", "runtime.messages"} <= set(before[1:])
    assert found("STEP = 0.3e-3\n")[0] != before[0]
    assert found("STEP = 0.2e-3\n") == before


# What is kept


def test_what_is_kept_comes_back_as_it_was(tmp_path: Path) -> None:
    cache = Cache(tmp_path)
    key, result = key_of(SPIRAL), SPIRAL.run()
    assert cache.load(SPIRAL, key) is None
    cache.store(SPIRAL, key, result)
    assert cache.load(SPIRAL, key) == result
    assert [path.suffix for path in tmp_path.rglob("*") if path.is_file()] == [".gz"]


@pytest.mark.parametrize(
    "harm",
    [
        lambda data: data[: len(data) // 2],
        lambda _data: b"",
        lambda _data: b"nonsense",
        lambda _data: gzip.compress(b"{}"),
        lambda _data: gzip.compress(b'{"key": "another", "result": []}'),
        lambda data: gzip.compress(gzip.decompress(data).replace(b'"seated"', b'"sated"')),
        lambda data: data[:100] + bytes([data[100] ^ 0xFF]) + data[101:],
    ],
    ids=["cut", "empty", "no gzip", "no result", "another key", "another shape", "a flipped byte"],
)
def test_a_damaged_entry_is_computed_again(tmp_path: Path, harm: Any) -> None:
    cache, reports = Cache(tmp_path), []
    result = sweep([SPIRAL], cache, jobs=1)[SPIRAL]
    (path,) = tmp_path.rglob("*.gz")
    path.write_bytes(harm(path.read_bytes()))
    assert sweep([SPIRAL], cache, jobs=1, report=reports.append)[SPIRAL] == result
    assert reports == [Progress(0, 1, 0), Progress(1, 1, 0)]
    assert cache.load(SPIRAL, key_of(SPIRAL)) == result


def test_results_are_kept_where_the_user_keeps_such_things(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert default_folder() == tmp_path / "palpate"
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")  # to be ignored, says the specification
    monkeypatch.setenv("HOME", str(tmp_path))
    assert default_folder() == tmp_path / ".cache" / "palpate"


# Running


@dataclass(frozen=True)
class Square:
    """A small piece of work."""

    number: int
    fails: bool = False

    @property
    def content(self) -> Mapping[str, Any]:
        return {"number": self.number}

    @property
    def code(self) -> tuple[str, ...]:
        return ()

    def run(self) -> tuple[float, ...]:
        if self.fails:
            raise SessionError("this one cannot be done")
        return (float(self.number**2), math.inf)


@dataclass(frozen=True)
class Wanderer(Square):
    """Work whose content is another in every process, as with another version of the code."""

    @property
    def content(self) -> Mapping[str, Any]:
        return {"process": os.getpid()}


def test_in_parallel_and_in_turn_come_to_the_same(tmp_path: Path) -> None:
    turn = sweep(FEW, Cache(tmp_path / "turn"), jobs=1)
    parallel = sweep(FEW, Cache(tmp_path / "parallel"), jobs=2)
    assert [turn[trial] for trial in FEW] == [parallel[trial] for trial in FEW] == [trial.run() for trial in FEW]
    assert len({len(turn[trial]) for trial in FEW}) == 1


def test_only_what_is_missing_is_done(tmp_path: Path) -> None:
    reports: list[Progress] = []
    work = [Square(number) for number in (1, 2, 3, 3)]
    sweep(work[:2], Cache(tmp_path), jobs=1)
    swept = sweep(work, Cache(tmp_path), jobs=1, report=reports.append)
    assert [swept[piece] for piece in work] == [(1.0, math.inf), (4.0, math.inf), (9.0, math.inf), (9.0, math.inf)]
    assert reports == [Progress(2, 3, 2), Progress(3, 3, 2)]
    assert (swept.total, swept.cached) == (3, 2)
    with pytest.raises(KeyError):
        swept[Square(4)]


def test_what_is_done_before_an_error_is_kept(tmp_path: Path) -> None:
    with pytest.raises(SessionError, match="cannot be done"):
        sweep([Square(1), Square(2, fails=True)], Cache(tmp_path), jobs=1)
    reports: list[Progress] = []
    sweep([Square(1)], Cache(tmp_path), jobs=1, report=reports.append)
    assert reports == [Progress(1, 1, 1)]


def test_a_worker_with_other_code_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SessionError, match="another version"):
        sweep([Wanderer(1)], Cache(tmp_path), jobs=2)
    assert not list(tmp_path.rglob("*.gz"))


def test_a_dask_cluster_comes_to_the_same(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None
    ) as cluster:
        where = cluster.scheduler_address.replace("tcp://", "dask://")
        swept = sweep(FEW, Cache(tmp_path), where=where)
    assert [swept[trial] for trial in FEW] == [trial.run() for trial in FEW]
    assert len(list(tmp_path.rglob("*.gz"))) == len(FEW)


@pytest.mark.parametrize("name", ["threads", "dask", "dask://", "spark://host:1", ""])
def test_an_unknown_executor_is_refused(name: str) -> None:
    with pytest.raises(InputError, match="known: joblib, dask://HOST:PORT"), executor(name):
        pass


def test_an_executor_that_is_not_installed_says_what_to_install() -> None:
    try:
        import ray  # noqa: F401
    except ImportError:
        with pytest.raises(InputError, match=r"pip install 'ray\[client\]'"), executor("ray://127.0.0.1:10001"):
            pass


def test_a_scheduler_that_does_not_answer_is_told(free_port: int) -> None:
    pytest.importorskip("distributed")
    with pytest.raises(SessionError, match="no dask scheduler answers"), executor(f"dask://127.0.0.1:{free_port}"):
        pass


# Interrupted and resumed

LONG = ("--strategies", "spiral", "--worlds", "realistic", "--seeds", "400", "--jobs", "2")


def entries(folder: Path) -> int:
    return len(list((folder / "cache").rglob("*.gz")))


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL], ids=["Ctrl-C", "kill"])
def test_a_stopped_run_leaves_no_process_and_goes_on_where_it_was(palpate: Palpate, how: signal.Signals) -> None:
    arguments = ("experiment", "robustness", *LONG, "--cache", "cache", "--out", "out")
    running = palpate.start(*arguments)
    wait_until(lambda: entries(palpate.folder) >= 3, "three results")
    for process in palpate.processes() if how == signal.SIGINT else [running.pid]:  # a terminal's Ctrl-C reaches all
        os.kill(process, how)
    out, err = running.communicate(timeout=30)
    assert running.returncode == (-signal.SIGKILL if how == signal.SIGKILL else 130), err
    if how != signal.SIGKILL:
        assert err == "palpate: interrupted\n"
    assert out == ""
    wait_until(lambda: not palpate.processes(), "no process left", 20.0)
    kept = entries(palpate.folder)
    assert 3 <= kept < 400
    assert not list((palpate.folder / "cache").rglob("*.part"))
    assert not (palpate.folder / "out").exists()
    few = [*arguments[:2], *LONG[:4], "--seeds", "3", *arguments[-4:]]
    again = palpate.run(*few)
    assert again.returncode == 0, again.stderr
    assert "3 pieces of work, " in again.stdout
    assert "3 pieces of work, 3 of them" in palpate.run(*few).stdout


# The command


def small(palpate: Palpate, name: str, *more: str) -> subprocess.CompletedProcess[str]:
    done = palpate.run(
        "experiment", name, "--seeds", "2", "--boards", "2", "--jobs", "1", "--cache", "cache", "--out", "out", *more
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return done


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def check_files(folder: Path, name: str, pictures: set[str]) -> None:
    for picture in pictures:
        assert (folder / f"{name}-{picture}.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
        assert ElementTree.parse(folder / f"{name}-{picture}.svg").getroot().tag.endswith("svg")
    page = (folder / f"{name}.md").read_text()
    assert page.startswith(f"# {name}: ")
    assert all(f"({name}-{picture}.png)" in page for picture in pictures)


def test_compare_writes_its_table_figures_and_verdict(palpate: Palpate) -> None:
    cache = Cache(palpate.folder / "cache")
    for place in ("realistic", "located"):
        for part in ("igbt", "capacitor"):  # limits take half a minute; what is kept of them is used
            work = LimitWork(world(place), part, boards=2)
            limits = Limits(1.0, 4.0, 5.0, ((4.0,) * 9, (4.0,) * 9), ((5.0,) * 9, (5.0,) * 9))
            cache.store(work, key_of(work), limits)
    done = small(palpate, "compare", "--strategies", "linear,spiral", "--worlds", "realistic,located")
    out = palpate.folder / "out"
    assert (out / "compare.csv").read_text().splitlines()[0] == COMPARE
    rows = rows_of(out / "compare.csv")
    assert [(row["world"], row["component"], row["strategy"]) for row in rows] == [
        (place, part, name)
        for place in ("realistic", "located")
        for part in ("igbt", "capacitor")
        for name in ("linear", "spiral")
    ]
    for row in rows:
        figures = {name: float(value) for name, value in list(row.items())[3:]}
        assert all(math.isfinite(value) for value in figures.values())
        assert 0 <= figures["success_rate"] <= 1
        assert figures["ratio_to_oracle"] == pytest.approx(figures["attempts_mean"])
        assert figures["ratio_to_limit"] == pytest.approx(figures["attempts_mean"] / 5)
        assert figures["board_s_mean"] > 9 * figures["search_s_mean"] > 0
    check_files(out, "compare", {"learning", "limit", "solved"})
    assert "linear leaves many parts out" in done.stdout
    assert "linear leaves many parts out" in (out / "compare.md").read_text()
    limits = [list(row.values())[2:] for row in rows_of(out / "compare-limits.csv")]
    assert limits == [["1.0", "4.0", "5.0"]] * 4


def test_robustness_tells_who_fails_where_nobody_can_insert(palpate: Palpate) -> None:
    done = small(palpate, "robustness", "--strategies", "linear", "--worlds", "realistic,off-board")
    rows = rows_of(palpate.folder / "out" / "robustness.csv")
    assert [(row["world"], row["strategy"]) for row in rows] == [
        (place, name) for place in ("realistic", "off-board") for name in ("spiral", "linear")
    ]
    lost = [row for row in rows if row["world"] == "off-board"]
    assert all((row["failed"], row["within R"], row["unsolved within R"]) == ("36", "0", "0") for row in lost)
    assert all(row["x spiral"] == "1.0" and row["x spiral_se"] == "0.0" for row in rows if row["strategy"] == "spiral")
    assert "off-board, igbt: no hole is within R, and nobody inserts a part" in done.stdout
    check_files(palpate.folder / "out", "robustness", {"spiral"})


def test_the_same_run_in_physics(palpate: Palpate) -> None:
    options = ("--strategies", "spiral", "--worlds", "paper-capacitor", "--components", "capacitor", "--boards", "1")
    small(palpate, "robustness", *options, "--seeds", "1", "--physics")
    (row,) = rows_of(palpate.folder / "out" / "robustness.csv")
    assert (row["searches"], row["world"]) == ("9", "paper-capacitor")
    assert "the full physics" in (palpate.folder / "out" / "robustness.md").read_text()
    model = Trial(world("paper-capacitor"), "capacitor", contender("spiral"), seed=1, boards=1)
    swept = sweep([physics := replace(model, physics=True)], Cache(palpate.folder / "cache"))
    assert swept.cached == 1
    assert [search.offset for search in swept[physics]] == [search.offset for search in model.run()]


def test_without_a_name_the_experiments_are_listed(palpate: Palpate) -> None:
    for arguments in ([], ["list"]):
        shown = palpate.run("experiment", *arguments)
        assert shown.returncode == 0, shown.stderr
        assert {line.split()[0] for line in shown.stdout.splitlines()[1:] if line[:1].strip()} == set(STUDIES)


def test_the_command_explains_itself_and_loads_nothing_heavy_for_it(palpate: Palpate) -> None:
    shown = palpate.run("experiment", "--help")
    assert shown.returncode == 0
    assert "palpate experiment compare" in shown.stdout.split("examples:")[1]
    heavy = ["numpy", "scipy", "matplotlib", "joblib", "rich", "distributed", "runtime.experiment"]
    program = (
        "import sys; from runtime.cli import main; main(['experiment', '--help']);"
        f"print([name for name in {heavy} if name in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stderr.strip() == "[]"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["comparison"], "did you mean 'compare'"),
        (["compare", "--strategies", "meta,mega"], "mega"),
        (["compare", "--strategies", "meta,meta"], "different names"),
        (["compare", "--strategies", "meta,"], "different names"),
        (["compare", "--worlds", "moon"], "known: located"),
        (["compare", "--components", "diode"], "capacitor"),
        (["compare", "--seeds", "0"], "1 or more"),
        (["compare", "--seeds", "many"], "invalid int value"),
        (["compare", "--boards", "-1"], "1 or more"),
        (["compare", "--jobs", "0"], "1 or more"),
        (["compare", "--jobs", "2", "--executor", "dask://127.0.0.1:1"], "all of its workers"),
        (["robustness", "--executor", "cloud"], "dask://HOST:PORT"),
        (["compare", "--cache", "/proc/nowhere"], "--cache DIR"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else None,
)
def test_wrong_input_is_one_line_and_exit_code_2(palpate: Palpate, arguments: list[str], said: str) -> None:
    cache = [] if "--cache" in arguments else ["--cache", "cache"]
    done = palpate.run("experiment", *arguments, *cache)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("palpate: ")
    assert done.stderr.count("\n") == 1
    assert said in done.stderr


def test_where_findings_cannot_be_written_is_wrong_input(palpate: Palpate) -> None:
    done = palpate.run(
        *("experiment", "robustness", "--strategies", "spiral", "--worlds", "located", "--seeds", "1"),
        *("--boards", "1", "--jobs", "1", "--cache", "cache", "--out", "/proc/nowhere"),
    )
    assert done.returncode == 2
    assert "--out DIR" in done.stderr


@pytest.mark.parametrize("name", STUDIES)
def test_every_study_can_say_what_it_needs(name: str) -> None:
    one = study(name)
    assert one.name == name
    assert one.summary
    assert "\n" not in one.summary
    chosen = replace(one.defaults, seeds=min(one.defaults.seeds, 1), boards=min(one.defaults.boards, 1))
    for piece in one.work(chosen):
        assert piece.content


# Figures of merit


def record(board: int, attempts: int, *, seated: bool = True, offset: float = 0.0, time: float = 1.0) -> SearchRecord:
    return SearchRecord(board, "1", seated, attempts, time, 10.0 + time, 0.0, (offset, 0.0))


def test_a_failed_search_counts_with_what_it_used() -> None:
    records = [
        [record(1, 2), record(2, 40, seated=False, offset=3e-3, time=20.0)],
        [record(1, 4), record(2, 6, seated=False, offset=1e-3)],
    ]
    found = score(records, radius=2.5e-3)
    assert found.attempts == Estimate(13.0, pytest.approx(8.0))
    assert found.attempts_per_part.value == pytest.approx(52 / 2)
    assert (found.searches, found.failed, found.within, found.unsolved) == (4, 2, 3, 1)
    assert found.success_rate == 0.5
    assert found.search_time.value == pytest.approx((10.5 + 1.0) / 2)
    assert found.board_time.value == pytest.approx((11 + 30 + 11 + 11) / 4)
    assert {board: curve.value for board, curve in by_board(records).items()} == {1: 3.0, 2: 23.0}
    assert solved_within(records, [1, 2, 4, 100]) == [0.0, 0.25, 0.5, 0.5]


def test_standard_errors_agree_with_the_scatter_of_repeated_draws() -> None:
    draws = np.random.default_rng(5)
    means, ratios = [], []
    for _ in range(400):
        above = 6 + draws.normal(size=(30, 1)) + draws.normal(size=(30, 9))
        below = above + 9 + draws.normal(size=(30, 9))
        means.append(mean_over_seeds(above.tolist()))
        ratios.append(ratio_over_seeds(above.tolist(), below.tolist()))
    for estimates in (means, ratios):
        scatter = float(np.std([estimate.value for estimate in estimates]))
        assert np.mean([estimate.error for estimate in estimates]) == pytest.approx(scatter, rel=0.1)


def test_estimates_without_evidence_claim_none() -> None:
    assert math.isnan(mean_over_seeds([[1.0, 2.0]]).error)
    assert math.isnan(mean_over_seeds([]).value)
    assert math.isnan(ratio_over_seeds([[1.0]], [[0.0]]).value)
    assert ratio_over_seeds([[1.0]], [[2.0]]).value == 0.5
    assert percentile_95([[1.0] * 95, [100.0] * 5]) < percentile_95([[1.0] * 90, [100.0] * 10]) == 100.0


@pytest.mark.parametrize(
    ("estimate", "said"),
    [
        (Estimate(0.33, 0.01), "0.330 ± 0.010; aim at most 0.4: holds"),
        (Estimate(0.50, 0.01), "does not hold"),
        (Estimate(0.39, 0.01), "cannot be decided"),
        (Estimate(0.39, math.nan), "cannot be decided"),
        (Estimate(math.nan, math.nan), "cannot be decided"),
    ],
)
def test_an_aim_is_told_with_the_number(estimate: Estimate, said: str) -> None:
    assert said in aim("share of meta's attempts", estimate, at_most=0.4)


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (None, ""),
        (3, "3"),
        (True, "yes"),
        (0.0, "0"),
        (1234.5, "1234"),
        (12.345, "12.3"),
        (0.012345, "0.0123"),
        (1e-6, "1.00e-06"),
        (math.nan, "-"),
        (Estimate(12.345, 0.0234), "12.345 ± 0.023"),
        (Estimate(1234.5, 230.0), "1234 ± 230"),
        (Estimate(2.0, math.nan), "2 (one seed)"),
    ],
)
def test_numbers_are_rounded_where_people_read_them(value: Any, shown: str) -> None:
    assert text(value) == shown


class Sample:
    """A study that has no work."""

    name = "sample"
    summary = "nothing"
    defaults = Choices()

    def work(self, _chosen: Choices) -> list[Trial]:
        return []

    def findings(self, _chosen: Choices, _results: Any) -> Findings:
        return Findings(
            tables=(
                Table("", "Hidden", ("a", "b"), ((1, 0.1), (2, None)), shown=False),
                Table("shown", "Shown", ("name", "attempts"), (("x|y", Estimate(1.5, 0.25)), ("z", None))),
            ),
            figures=(Picture("line", "A line", lambda figure: figure.subplots().plot([1, 2]) and None),),
            verdict=("It holds.",),
            assumptions=(Assumption("pitch", "0.5 mm", "chosen"),),
        )


def test_findings_are_written_exactly_and_the_same_every_time(tmp_path: Path) -> None:
    sample = Sample()
    written = [
        write(sample, Choices(), sample.findings(Choices(), None), tmp_path / folder) for folder in ("one", "two")
    ]
    assert [path.name for path in written[0]] == [
        *("sample.csv", "sample-shown.csv", "sample-line.png", "sample-line.svg", "sample.md")
    ]
    assert (tmp_path / "one" / "sample.csv").read_text() == "a,b\n1,0.1\n2,\n"
    assert (tmp_path / "one" / "sample-shown.csv").read_text() == "name,attempts,attempts_se\nx|y,1.5,0.25\nz,,\n"
    page = (tmp_path / "one" / "sample.md").read_text()
    assert "| x\\|y | 1.50 ± 0.25 |" in page
    assert "- It holds." in page
    assert "| pitch | 0.5 mm | chosen |" in page
    assert "Hidden" not in page
    for one, two in zip(*written, strict=True):
        assert one.read_bytes() == two.read_bytes(), one.name


def test_one_trial_for_each_seed_that_was_chosen() -> None:
    chosen = Choices(seeds=3, boards=2, physics=True)
    made = trials(chosen, SPIRAL.world, "igbt", SPIRAL.contender)
    assert [(trial.seed, trial.boards, trial.physics) for trial in made] == [(seed, 2, True) for seed in (1, 2, 3)]


def test_a_digest_names_the_code_it_is_of() -> None:
    assert digest(("strategies.spiral",)) != digest(("strategies.linear",))
