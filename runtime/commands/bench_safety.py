"""palpate bench safety: how fast a cell stops, and how far from it a light curtain would have to stand."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

from rich.console import Console
from rich.table import Table

from runtime.benchmark.safe_distance import minimum_distance
from runtime.benchmark.safety import (
    FULL_SPEED,
    REAL_TIME,
    Advance,
    Subject,
    Trials,
    figures_of,
    full_speed_trials,
    real_time_trials,
)
from runtime.commands.progress import progress_bar
from runtime.errors import InputError
from runtime.network.meeting_point import free_port

BOTH = "both"
TRIALS = {FULL_SPEED: 10_000, REAL_TIME: 250, BOTH: 10_000}
SHARE, FEWEST = 40, 3  # of the trials at full speed as many again at rate 1.0
MOST = 1_000_000
LONGEST = 1.0  # [s] response time of a curtain
NAMES = {FULL_SPEED: "full speed", REAL_TIME: "1.0"}
_SHOWN = 5  # failures

Measure = Callable[[Subject, int, Advance], Trials]


def bench_safety(arguments: argparse.Namespace) -> dict[str, float]:
    """Break the beam, print what came of it, and tell the figures."""
    resolution, response = 1e-3 * arguments.resolution, 1e-3 * arguments.response
    minimum_distance(0.0, resolution)  # before minutes of measuring, if there is none
    if not 0 <= response <= LONGEST:
        raise InputError(f"--response {arguments.response:g} is no number of ms from 0 to {1e3 * LONGEST:g}")
    counts = _counts(arguments)
    overrides: dict[str, Any] = {} if arguments.strategy is None else {"strategy": arguments.strategy}
    port = free_port() if arguments.port is None else arguments.port
    subject = Subject(arguments.cell, overrides, 1 if arguments.seed is None else arguments.seed, port)
    subject.session(0, FULL_SPEED, [])
    measures: dict[str, Measure] = {FULL_SPEED: full_speed_trials, REAL_TIME: real_time_trials}
    with progress_bar(Console()) as bar:
        task = bar.add_task("beams broken", total=sum(counts.values()), detail="")
        measured = []
        for rate, count in counts.items():
            bar.update(task, detail=f"at {NAMES[rate]}" if rate == FULL_SPEED else f"at rate {rate}")
            measured.append(measures[rate](subject, count, lambda made: bar.update(task, advance=made)))
    figures = figures_of(measured, resolution, response)
    _show(measured, figures)
    return figures


def _counts(arguments: argparse.Namespace) -> dict[str, int]:
    """How many beams to break at each rate."""
    rate = str(arguments.rate)
    trials = TRIALS[rate] if arguments.trials is None else arguments.trials
    if not 1 <= trials <= MOST:
        raise InputError(f"--trials {trials} is no number from 1 to {MOST}")
    if rate == BOTH:
        return {FULL_SPEED: trials, REAL_TIME: max(FEWEST, trials // SHARE)}
    return {rate: trials}


def _show(measured: list[Trials], figures: dict[str, float]) -> None:
    console = Console()
    table = Table(box=None, pad_edge=False)
    table.add_column("rate")
    for trials in measured:
        table.add_column(NAMES[trials.rate], justify="right")
    prefixes = ["real_time_" if trials.rate == REAL_TIME else "full_speed_" for trials in measured]
    counts = {"beams broken": "trials", "stopped": "stopped", "  in motion": "moving", "  standing already": "standing"}
    for label, name in counts.items():
        table.add_row(label, *(f"{figures[prefix + name]:.0f}" for prefix in prefixes))
    for what in ("command", "standstill"):
        for key in ("p50", "p99", "worst"):
            names = [f"{prefix}{what}_{key}_ms" for prefix in prefixes]
            times = (f"{figures[name]:.1f} ms" if name in figures else "-" for name in names)
            table.add_row(f"beam to {what}, {key}", *times)
    console.print(table)
    for line in _lines(measured, figures):
        console.print(line, highlight=False, markup=False)


def _lines(measured: list[Trials], figures: dict[str, float]) -> list[str]:
    lines = [""]
    for trials in measured:
        failures = [stop.failure for stop in trials.stops if stop.failure]
        lines += [f"NOT STOPPED, {NAMES[trials.rate]}: {failure}" for failure in failures[:_SHOWN]]
        if len(failures) > _SHOWN:
            lines.append(f"and {len(failures) - _SHOWN} more")
        lines += [f"a session failed on its own: {failure}" for failure in trials.failed_sessions]
    lines += [
        "Times are those of arms in motion, from the broken beam: to the first control cycle whose commanded speed "
        "falls, and until every joint stands.",
        "Full speed: session time, from the scripted break. 1.0: machine time, from when the curtain takes note "
        "until the arm's word of its stop is back over the bus.",
        f"Minimum distance of the curtain after ISO 13855:2010: {figures['safe_distance_mm']:.0f} mm, for the worst "
        f"stop plus {figures['response_ms']:g} ms that the curtain itself takes (assumed, --response), "
        f"T = {figures['stop_time_ms']:.0f} ms, and a resolution of {figures['resolution_mm']:g} mm (assumed, "
        "--resolution).",
        "That is a figure of a simulation. It does not replace the stopping time measured at the real machine.",
    ]
    return lines
