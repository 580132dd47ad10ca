"""The command line: help, good input, and one line with exit code 2 for every bad one."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from cells import Palpate, cell_text, write_cell
from log_samples import record
from rich.console import Console

from runtime.commands.launch import summarise
from runtime.config import load
from runtime.errors import SessionError
from runtime.follower import Session
from runtime.log.writer import SUMMARY, LogWriter

HEAVY = [
    "joblib",
    "matplotlib",
    "mujoco",
    "pinocchio",
    "rerun",
    "zenoh",
    "numpy",
    "scipy",
    "pydantic",
    "rich",
    "rosbags",
    "mcap",
    "pyarrow",
]
COMMANDS = [
    "launch",
    "info",
    "export",
    "messages",
    "replay",
    "player",
    "view",
    "plugins",
    "picture",
    "bench",
    "robot",
    "experiment",
]


@pytest.fixture
def palpate(tmp_path: Path) -> Palpate:
    return Palpate(tmp_path)


@pytest.fixture(scope="module")
def sample(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("log") / "sample.mcap"
    assert record(path) > 100
    return path


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself_with_an_example(palpate: Palpate, command: str) -> None:
    shown = palpate.run(command, "--help")
    assert shown.returncode == 0
    assert f"palpate {command}" in shown.stdout.split("examples:")[1]
    assert command in palpate.run("--help").stdout


def test_help_imports_nothing_heavy() -> None:
    program = (
        "import sys; from runtime.cli import main; main(['launch', '--help']); main(['--help']);"
        f"print([name for name in {HEAVY} if name in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stderr.strip() == "[]"


def test_no_command_is_wrong_input(palpate: Palpate) -> None:
    assert palpate.run().returncode == 2


def test_the_version_is_told(palpate: Palpate) -> None:
    shown = palpate.run("--version")
    assert (shown.returncode, shown.stdout.split()[0]) == (0, "palpate")


def test_plugins_are_listed_with_what_they_are_for(palpate: Palpate) -> None:
    shown = palpate.run("plugins")
    assert shown.returncode == 0
    for name in ("mujoco_ur3e", "light_curtain", "linear", "spiral", "hybrid", "meta"):
        (line,) = [line for line in shown.stdout.splitlines() if line.startswith(name)]
        assert len(line.split()) > 6


def refused(palpate: Palpate, *arguments: str | Path) -> str:
    """The one line that wrong input is answered with."""
    done = palpate.run(*arguments)
    assert done.returncode == 2, (done.stdout, done.stderr)
    assert done.stderr.count("\n") == 1, done.stderr
    assert done.stderr.startswith("palpate: ")
    assert "Traceback" not in done.stderr
    assert not palpate.processes()
    return done.stderr


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["launch", "--strategy", "mega"], "did you mean 'meta'"),
        (["launch", "--component", "diode"], "capacitor"),
        (["launch", "--boards", "none"], "invalid int value"),
        (["launch", "--boards", "0"], "greater than or equal to 1"),
        (["launch", "--seed", "-1"], "seed"),
        (["launch", "--rate", "quick"], "'max' nor a number"),
        (["launch", "--rerun", "maybe"], "spawn"),
        (["launch", "--port", "0"], "port"),
        (["launch", "nowhere.toml"], "igbt"),
        (["launch", "--logs", "/proc/nowhere"], "--logs DIR"),
        (["launch", "--rerun", "spawn"], "--rerun web"),
        (["fly"], "invalid choice"),
        (["replay"], "LOG"),
        (["replay", "nothing.mcap"], "nothing.mcap"),
        (["view", "nothing.mcap"], "nothing.mcap"),
        (["view", "nothing.mcap", "--save", "x.rrd", "--web"], "not allowed with argument"),
        (["bench", "weather"], "sim"),
        (["bench", "sim", "--cell", "nowhere"], "nowhere"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_wrong_arguments_are_answered_in_one_line(
    palpate: Palpate, monkeypatch: pytest.MonkeyPatch, arguments: list[str], said: str
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert said in refused(palpate, *arguments)


@pytest.mark.parametrize("command", ["replay", "view"])
@pytest.mark.parametrize("kind", ["empty", "no mcap", "cut short", "directory"])
def test_a_file_that_is_no_log_is_answered_in_one_line(palpate: Palpate, sample: Path, command: str, kind: str) -> None:
    path = palpate.folder / "bad.mcap"
    if kind == "directory":
        path.mkdir()
    else:
        contents = {"empty": b"", "no mcap": b"not a log at all" * 20, "cut short": sample.read_bytes()[:20]}
        path.write_bytes(contents[kind])
    extra = ["--save", "bad.rrd"] if command == "view" else ["--port", str(palpate.port)]
    assert "bad.mcap" in refused(palpate, command, path, *extra)
    assert sorted(item.name for item in palpate.folder.iterdir()) == ["bad.mcap"]


def test_a_log_that_is_cut_short_is_used_as_far_as_it_goes_and_said(palpate: Palpate, sample: Path) -> None:
    whole = sample.read_bytes()
    path = palpate.folder / "short.mcap"
    path.write_bytes(whole[: len(whole) * 2 // 3])
    line = refused(palpate, "replay", path, "--rate", "max", "--port", str(palpate.port))
    assert "short.mcap" in line
    assert "everything that it holds was published" in line
    assert "cut short" in refused(palpate, "view", path, "--save", path.with_suffix(".rrd"))
    assert path.with_suffix(".rrd").stat().st_size > 10_000


def test_a_hole_out_of_reach_is_named(palpate: Palpate) -> None:
    cell = write_cell(palpate.folder, cell_text(holes=2).replace('name = "2", x = "0 mm"', 'name = "2", x = "400 mm"'))
    line = refused(palpate, "launch", cell, "--port", str(palpate.port))
    assert "hole '2'" in line
    assert "reach" in line
    assert not palpate.logs()


def test_a_port_in_use_is_named(palpate: Palpate) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert f"port {port}" in refused(palpate, "launch", "--port", str(port))
    assert not palpate.logs()


def test_a_replay_publishes_every_message(palpate: Palpate, sample: Path) -> None:
    done = palpate.run("replay", sample, "--rate", "max", "--port", str(palpate.port))
    assert done.returncode == 0, done.stderr
    assert "/attempt" in done.stdout
    some = palpate.run("replay", sample, "--rate", "max", "--topics", "/search/*", "--port", str(palpate.port))
    assert some.returncode == 0
    assert "/search/goal" in some.stdout
    assert "/attempt" not in some.stdout
    assert "no topic" in refused(palpate, "replay", sample, "--topics", "/nowhere", "--port", str(palpate.port))


def test_a_log_becomes_a_file_that_rerun_opens(palpate: Palpate, sample: Path) -> None:
    output = palpate.folder / "out.rrd"
    done = palpate.run("view", sample, "--save", output)
    assert done.returncode == 0, done.stderr
    assert output.stat().st_size > 10_000
    assert str(output) in done.stdout


def test_the_bench_prints_and_writes_its_figures(palpate: Palpate) -> None:
    cell = write_cell(palpate.folder, cell_text(holes=1))
    figures = palpate.folder / "figures.json"
    done = palpate.run("bench", "sim", "--cell", cell, "--json", figures, "--port", str(palpate.port))
    assert done.returncode == 0, done.stderr
    written = json.loads(figures.read_text())
    assert {"rtf_physics", "rtf_controller", "rtf_cell"} <= set(written)
    assert written["rtf_physics"] > written["rtf_controller"] > 0
    assert written["inserted"] == 1
    assert f"{written['rtf_cell']:.1f}" in done.stdout


def test_the_bench_times_thought(palpate: Palpate) -> None:
    figures = palpate.folder / "figures.json"
    done = palpate.run("bench", "plan", "--strategy", "linear,spiral", "--json", figures)
    assert done.returncode == 0, done.stderr
    written = json.loads(figures.read_text())
    for name in ("linear", "spiral"):
        assert 0 < written[f"{name}_mean_ms"] <= written[f"{name}_worst_ms"]
        assert written[f"{name}_p99_ms"] <= written[f"{name}_worst_ms"]
        assert written[f"{name}_after_1000_boards_warm_ms"] > 0
        assert name in done.stdout
    unknown = palpate.run("bench", "plan", "--strategy", "guesswork")
    assert unknown.returncode == 2
    assert "no strategy 'guesswork' to compare; known: bayes, " in unknown.stderr


def test_a_loss_is_told_and_fails_the_session(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "lossy.mcap"
    with LogWriter(path) as log:
        log.add_metadata(SUMMARY, {"messages": "997", "lost": "3", "lost_topics": '{"/attempt": 3}'})
    with pytest.raises(SessionError, match=r"3 messages were lost .*/attempt 3$"):
        summarise(Session("lossy", path), load("igbt"), Console())
    assert "recorded 997 messages, 3 lost" in capsys.readouterr().out
