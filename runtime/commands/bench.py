"""palpate bench: figures measured on this machine, as ratios from one run."""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from runtime import config
from runtime.errors import InputError, SessionError
from runtime.launcher import Order, launch
from runtime.messages import Ending
from runtime.plugin import BareRun, Punctuality


def bench_command(arguments: argparse.Namespace) -> int:
    """Measure, print a table, write the figures where asked."""
    from runtime.commands.bench_bus import bench_bus, bench_log
    from runtime.commands.bench_faults import bench_faults, check_passed
    from runtime.commands.bench_safety import bench_safety

    benches = {
        "sim": bench_sim,
        "robot": bench_robot,
        "plan": bench_plan,
        "bus": bench_bus,
        "log": bench_log,
        "safety": bench_safety,
        "faults": bench_faults,
    }
    figures = benches[arguments.what](arguments)
    if arguments.json:
        try:
            Path(arguments.json).write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
        except OSError as error:
            raise InputError(f"figures cannot be written to {arguments.json}: {error.strerror}") from None
    if arguments.what == "faults":
        check_passed(figures)
    return 0


def bench_sim(arguments: argparse.Namespace) -> dict[str, float]:
    """Real-time factors of bare physics, of physics with controller, and of the whole cell, on one cell and seed."""
    overrides: dict[str, Any] = {
        name: getattr(arguments, name) for name in ("strategy", "seed") if getattr(arguments, name) is not None
    }
    if arguments.port is not None:
        overrides["bus"] = {"port": arguments.port}
    cell_file = config.load(arguments.cell, overrides | {"rate": "max"})
    cell = cell_file.cell
    robot = config.robot_of(cell, cell_file.name)
    run = getattr(robot, "bare_run", None)
    if run is None:
        raise InputError(f"{cell_file.name}: {cell.robot} is not simulated; there is nothing to measure")
    bare: BareRun = run(cell)
    with tempfile.TemporaryDirectory() as folder:
        session = launch(Order(cell_file, Path(folder), fresh=True), lambda _progress: None)
    inserted = sum(result.ending == Ending.INSERTED for result in session.results)
    done = [(result.hole, result.ending == Ending.INSERTED, result.attempts) for result in session.results]
    if done != [(search.hole, search.seated, search.attempts) for search in bare.searches]:
        raise SessionError("the bare loop and the cell did not do the same job: their decisions differ")
    figures = {
        "rtf_physics": bare.session_time / bare.physics_time,
        "rtf_controller": bare.session_time / bare.machine_time,
        "rtf_cell": session.duration / session.machine_time,
        "session_time_s": session.duration,
        "attempts": float(sum(search.attempts for search in bare.searches)),
        "inserted": float(inserted),
    }
    _show(figures, f"{cell_file.name}, {cell.strategy}, seed {cell.seed}")
    return figures


def bench_robot(arguments: argparse.Namespace) -> dict[str, float]:
    """Punctuality of the controller that `palpate robot` serves, with two clients connected."""
    overrides: dict[str, Any] = {} if arguments.seed is None else {"seed": arguments.seed}
    cell_file = config.load(arguments.cell, overrides)
    run = getattr(config.robot_of(cell_file.cell, cell_file.name), "punctuality", None)
    if run is None:
        raise InputError(f"{cell_file.name}: {cell_file.cell.robot} is not simulated; there is nothing to measure")
    found: Punctuality = run(cell_file.name, cell_file.document, arguments.seconds)
    figures = {
        "on_time_share": found.on_time_share,
        "gap_max_ms": 1e3 * found.gap_max,
        "command_p50_ms": 1e3 * found.command_p50,
        "command_p99_ms": 1e3 * found.command_p99,
        "overruns": float(found.overruns),
        "packages": float(found.packages),
        "packages_missing": float(found.missing),
        "cycles": float(found.cycles),
    }
    table = Table(box=None, pad_edge=False, show_header=False)
    table.add_row("RTDE packages within 1 ms of their time", f"{found.on_time_share:.3%} of {found.packages}")
    table.add_row("longest gap between two packages", f"{1e3 * found.gap_max:.2f} ms")
    table.add_row("packages missing", str(found.missing))
    table.add_row(
        f"round trip of a command ({found.commands} asked)",
        f"p50 {1e3 * found.command_p50:.2f} ms, p99 {1e3 * found.command_p99:.2f} ms",
    )
    table.add_row("control cycles that began a cycle late", f"{found.overruns} of {found.cycles}")
    Console().print(table)
    return figures


def bench_plan(arguments: argparse.Namespace) -> dict[str, float]:
    """How long strategies think before each candidate, on one core, in the realistic world."""
    from runtime.experiment.contenders import contender
    from runtime.experiment.planning import PASTS, figures, thinking
    from runtime.experiment.worlds import world

    names = arguments.strategy.split(",") if arguments.strategy else ["meta", "bayes", "bayes-slide"]
    part = config.load(arguments.cell, {}).cell.component
    table = Table(box=None, pad_edge=False)
    table.add_column("strategy")
    for heading in ("mean", "p99", "worst", "first of a search", *(f"after {boards} boards" for boards in PASTS)):
        table.add_column(heading, justify="right")
    found: dict[str, float] = {}
    for name in names:
        said = figures(name, thinking(contender(name), world("realistic"), part, seeds=3))
        found |= said
        pasts = [
            " / ".join(f"{said[f'{name}_after_{boards}_boards_{how}_ms']:.1f}" for how in ("cold", "warm"))
            for boards in PASTS
        ]
        times = [said[f"{name}_{key}_ms"] for key in ("mean", "p99", "worst", "first_mean")]
        table.add_row(name, *(f"{time:.1f}" for time in times), *pasts)
    console = Console()
    console.print(table)
    console.print(
        f"ms before a candidate, {part}, realistic world, 3 x 10 boards, one core; after so many boards: "
        "before the first candidate of a fresh process / of the search after it",
        highlight=False,
    )
    return found


def _show(figures: dict[str, float], what: str) -> None:
    console = Console()
    table = Table(box=None, pad_edge=False)
    for heading in ("loop", "x real time", "of physics", "of controller"):
        table.add_column(heading, justify="left" if heading == "loop" else "right")
    rows = {
        "physics alone": figures["rtf_physics"],
        "with controller, skill and strategy": figures["rtf_controller"],
        "whole cell with bus and recording": figures["rtf_cell"],
    }
    for name, factor in rows.items():
        table.add_row(
            name,
            f"{factor:.1f}",
            f"{factor / figures['rtf_physics']:.2f}",
            f"{factor / figures['rtf_controller']:.2f}",
        )
    console.print(table)
    console.print(
        f"{what}: {figures['session_time_s']:.1f} s of session time, "
        f"{figures['attempts']:.0f} attempts, {figures['inserted']:.0f} inserted",
        highlight=False,
    )
