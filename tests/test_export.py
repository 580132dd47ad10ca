"""palpate export: a log as tables that other programs read."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import log_samples
import pytest
from command_line import CommandLine
from pyarrow import parquet

from runtime import messages as m
from runtime import topics as t
from runtime.log.file import open_log
from runtime.log.writer import LogWriter


@pytest.fixture
def palpate(tmp_path: Path) -> CommandLine:
    return CommandLine(tmp_path)


def traced() -> Iterator[log_samples.Sent]:
    """A sample session in which the arm tells of a few control cycles and a search is left unfinished."""
    last = 0
    for role, topic, message, stamp in log_samples.messages():
        yield role, topic, message, stamp
        if topic is t.SEARCH_GOAL:
            goal, last = message, stamp
    values = log_samples.np.arange(18.0)
    yield "arm", t.TRACE, m.ControlTrace(m.header(10_000_000), 0.002, values, values + 0.5, -values), 16_000_000
    unfinished = [getattr(goal, name) for name in ("search", "board", "hole", "component", "nominal")]
    unfinished[0] = 3
    yield (
        "assembly",
        t.SEARCH_GOAL,
        m.SearchGoal(m.header(last), *unfinished, 1e-4, 2e-3, 150, 7, m.Gaussian(), []),
        last + 1,
    )


@pytest.fixture(scope="module")
def sample(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("log") / "sample.mcap"
    log_samples.record(path, traced())
    return path


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def read(path: Path, topic: t.Topic[Any]) -> list[tuple[int, Any]]:
    with open_log(path) as log:
        return list(log.read(topic))


def test_attempts_searches_and_stops_are_tables(palpate: CommandLine, sample: Path) -> None:
    done = palpate.run("export", sample, "--csv", "tables", "--signals", "none")
    assert (done.returncode, done.stderr) == (0, "")
    assert [line.split()[:2] for line in done.stdout.splitlines()[1:]] == [
        ["attempts", "10"],
        ["searches", "3"],
        ["permits", str(len(read(sample, t.PERMIT)))],
        ["stops", "2"],
    ]
    folder = palpate.folder / "tables"
    assert {path.name for path in folder.iterdir()} == {"attempts.csv", "searches.csv", "permits.csv", "stops.csv"}
    attempts, tried = rows(folder / "attempts.csv"), read(sample, t.ATTEMPT)
    for row, (stamp, attempt) in zip(attempts, tried, strict=True):
        assert float(row["time_s"]) == stamp / 1e9
        assert (float(row["x_m"]), float(row["y_m"])) == (attempt.x, attempt.y)
        assert float(row["force_z_N"]) == attempt.wrench.force.z
        assert row["outcome"] == m.Outcome(attempt.outcome).name.lower()
        assert (row["hole"], row["kind"], row["path_m"]) == (attempt.hole, "peck", "")
        assert float(row["probability"]) == pytest.approx(0.2 * attempt.number)
    first, second, third = rows(folder / "searches.csv")
    assert [float(first["offset_x_m"]), float(first["offset_y_m"])] == list(log_samples.WHERE["1"])
    assert (first["outcome"], first["attempts"], first["earlier_seats"]) == ("inserted", "5", "12")
    assert float(second["prior_xx_m2"]) == 0.4e-3**2
    assert (third["outcome"], third["attempts"], third["end_s"], third["offset_x_m"]) == ("unfinished", "", "", "")
    assert third["prior_x_m"] == ""
    waiting, broken = rows(folder / "stops.csv")
    assert float(waiting["start_s"]) == 0.0
    assert float(broken["duration_s"]) == pytest.approx(0.5)
    assert (broken["state"], broken["reason"]) == ("tripped", "the light field is interrupted")


def test_signals_have_their_units_in_both_kinds_of_file(palpate: CommandLine, sample: Path) -> None:
    done = palpate.run("export", sample, "--csv", "a", "--parquet", "b/c", "--signals", "joints,wrench,tcp,trace")
    assert done.returncode == 0, done.stderr
    for name in ("attempts", "searches", "permits", "stops", "joints", "wrench", "tcp", "trace"):
        table = parquet.read_table(palpate.folder / "b" / "c" / f"{name}.parquet")
        text = rows(palpate.folder / "a" / f"{name}.csv")
        assert table.column_names == list(text[0])
        for column, values in table.to_pydict().items():
            written = [row[column] for row in text]
            expected = ["" if value is None else value for value in values]
            kind = next((type(value) for value in values if value is not None), str)
            assert [kind(value) if value and kind is not bool else value for value in written] == [
                str(value).lower() if kind is bool else value for value in expected
            ], column
    joints = parquet.read_table(palpate.folder / "b" / "c" / "joints.parquet").to_pylist()
    stamp, state = read(sample, t.JOINT_STATES)[7]
    assert joints[7]["time_s"] == stamp / 1e9
    assert joints[7]["elbow_joint_rad"] == state.position[2]
    assert joints[7]["elbow_joint_rad_per_s"] == state.velocity[2]
    assert joints[7]["elbow_joint_Nm"] == state.effort[2]
    trace = parquet.read_table(palpate.folder / "b" / "c" / "trace.parquet").to_pylist()
    assert [row["time_s"] for row in trace] == [0.010, 0.012, 0.014]
    assert (trace[1]["shoulder_pan_joint_rad"], trace[1]["wrist_3_joint_target_rad"]) == (6.0, 11.5)
    assert (trace[2]["force_x_N"], trace[2]["torque_z_Nm"]) == (-12.0, -17.0)


def test_tables_that_are_there_are_not_replaced_unless_told(palpate: CommandLine, sample: Path) -> None:
    folder = palpate.folder / "tables"
    folder.mkdir()
    (folder / "attempts.csv").write_text("precious")
    (folder / "stops.csv").touch()  # empty: nothing is lost
    done = palpate.run("export", sample, "--csv", "tables", "--signals", "none")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "tables holds attempts.csv already" in done.stderr
    assert {path.name for path in folder.iterdir()} == {"attempts.csv", "stops.csv"}
    assert (folder / "attempts.csv").read_text() == "precious"
    assert palpate.run("export", sample, "--csv", "tables", "--signals", "none", "--force").returncode == 0
    assert len(rows(folder / "attempts.csv")) == 10


def test_what_a_log_lacks_is_left_out_with_a_word(palpate: CommandLine) -> None:
    bare = palpate.folder / "bare.mcap"
    stand = (item for item in log_samples.messages() if item[1] in {t.WRENCH, t.PERMIT} and 0.3e9 < item[3] < 0.4e9)
    log_samples.record(bare, stand)
    done = palpate.run("export", bare, "--csv", "tables", "--signals", "joints,wrench")
    assert (done.returncode, done.stderr) == (0, "")
    said = done.stdout.splitlines()
    assert "left out attempts: the log has no /attempt" in said
    assert "left out searches: the log has no /search/goal" in said
    assert "left out joints: the log has no /joint_states" in said
    assert "left out stops: there always was a permit" in said
    assert {path.name for path in (palpate.folder / "tables").iterdir()} == {"permits.csv", "wrench.csv"}
    nothing = palpate.run("export", bare, "--csv", "other", "--signals", "trace", "--force")
    assert nothing.returncode == 0
    with LogWriter(palpate.folder / "empty.mcap"):
        pass
    empty = palpate.run("export", "empty.mcap", "--csv", "none")
    assert (empty.returncode, empty.stderr.count("\n")) == (2, 1)
    assert "holds nothing to export" in empty.stderr
    assert not (palpate.folder / "none").exists()


def test_a_log_that_is_cut_short_is_exported_as_far_as_it_goes(palpate: CommandLine, sample: Path) -> None:
    whole = sample.read_bytes()
    (palpate.folder / "cut.mcap").write_bytes(whole[: len(whole) // 2])
    done = palpate.run("export", "cut.mcap", "--parquet", "tables", "--signals", "none")
    assert done.returncode == 2
    assert "cut.mcap is cut short" in done.stderr
    assert done.stderr.count("\n") == 1
    tried = parquet.read_table(palpate.folder / "tables" / "attempts.parquet")
    assert 0 < tried.num_rows < 10


def test_bad_input_is_one_line(palpate: CommandLine, sample: Path) -> None:
    (palpate.folder / "file").write_text("x")
    for arguments, said in (
        ([sample], "say where the tables go"),
        ([sample, "--csv", "a", "--signals", "wrensh"], "did you mean 'wrench'?"),
        ([sample, "--csv", "a", "--signals", ","], "known: joints, none"),
        ([sample, "--csv", "file"], "file cannot be written to"),
        (["none.mcap", "--csv", "a"], "there is no log none.mcap"),
    ):
        done = palpate.run("export", *arguments)
        assert (done.returncode, done.stdout) == (2, "")
        assert said in done.stderr
        assert done.stderr.count("\n") == 1
    assert not (palpate.folder / "a").exists()
