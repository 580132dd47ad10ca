"""palpate bench bus and palpate bench log: palpate beside the bare libraries and those that others use instead."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol, TypeVar

from rich.console import Console
from rich.table import Table

from runtime.commands.progress import progress_bar
from runtime.errors import InputError, alternatives
from runtime.log.file import open_log

FLOOD = 100_000  # messages of each contender in a minute
LEAST, MOST = 100, 10_000_000  # messages that a measurement can have


class Contender(Protocol):
    """What takes part in a measurement."""

    @property
    def key(self) -> str:
        """Its name in the figures."""
        ...

    @property
    def label(self) -> str:
        """Its name in the table."""
        ...

    @property
    def missing(self) -> str:
        """What to do to have it; empty if it is there."""
        ...


ContenderT = TypeVar("ContenderT", bound=Contender)


def bench_bus(arguments: argparse.Namespace) -> dict[str, float]:
    """Round trips and floods between two processes."""
    from runtime.benchmark.bus import TRIPS, bus_figures, measure_bus, steps
    from runtime.benchmark.bus_contenders import CONTENDERS, PALPATE, RAW, RAW_CHANNEL

    messages = _messages(arguments)
    present, absent = _contenders(arguments, CONTENDERS)
    with _progress(steps(len(present), messages)) as advance:
        results = measure_bus(present, messages, max(messages // TRIPS, LEAST), arguments.port, advance)
    figures = bus_figures(results)
    table = _table("", "round trip p50", "p99", "flood", "lost", "CPU per 10 000")
    for result in results:
        table.add_row(
            result.contender.label,
            f"{1e6 * result.trip(0.5):.0f} us",
            f"{1e6 * result.trip(0.99):.0f} us",
            f"{result.delivered_per_second:,.0f}/s",
            f"{result.lost}",
            f"{result.processor_per_10000:.2f} s",
        )
    _show(table, absent)
    trips = sum(len(times) for times in results[0].trips)
    _say(
        f"Joint states of six joints, encoded and decoded at both ends, two processes: {trips} round trips and "
        f"{messages} messages as fast as can be, in turn in {len(results[0].trips)} rounds. "
        "CPU is that of both ends and the router."
    )
    for key, name in ((RAW, "rtt_ratio"), (RAW_CHANNEL, f"rtt_ratio_{RAW_CHANNEL}")):
        if name in figures:
            label = CONTENDERS[key].label
            _say(f"palpate's round trip takes {figures[name]:.2f} x that of {label} (median over the rounds).")
    unanswered = {result.contender.label: result.unanswered for result in results if result.unanswered}
    for label, count in unanswered.items():
        _say(f"{label}: {count} round trips got no answer.")
    return figures | {
        f"{'' if result.contender.key == PALPATE else result.contender.key + '_'}rtt_lost": float(result.unanswered)
        for result in results
    }


def bench_log(arguments: argparse.Namespace) -> dict[str, float]:
    """Writing and reading logs."""
    from runtime.benchmark.log import log_figures, measure_log, steps, time_to_open
    from runtime.benchmark.log_contenders import LOG_CONTENDERS, RECORDER

    messages = _messages(arguments)
    present, absent = _contenders(arguments, LOG_CONTENDERS)
    if arguments.log is not None:
        open_log(arguments.log).close()  # before minutes of measuring, if there is none
    with _progress(steps(len(present))) as advance:
        results, reading = measure_log(present, messages, advance)
    figures = log_figures(results, reading)
    table = _table("", "messages", "lost", "CPU per 10 000", "on disk")
    for result in results:
        table.add_row(
            result.contender.label,
            f"{result.rate:,.0f}/s",
            f"{result.lost}",
            f"{result.processor_per_10000:.3f} s",
            f"{result.bytes_per_message:.0f} bytes each",
        )
    _show(table, absent)
    _say(
        f"{messages} joint states of 316 bytes on 10 topics, zstd, chunks of 64 KiB, from the first message to the "
        f"closed file, in turn in {len(results[0].files)} rounds. CPU is that of the process that writes."
    )
    if any(result.contender.key == RECORDER for result in results):
        _say(
            f"Flooded over Zenoh, the recorder takes {figures['recorder_msgs_per_cpu_s']:,.0f} messages "
            "for each second that it computes."
        )
    if reading.ours:
        _say(
            f"Read in time order: {figures['read_msgs_per_s']:,.0f}/s by palpate, "
            f"{figures['raw_read_msgs_per_s']:,.0f}/s by the mcap reader."
        )
    if arguments.log is not None:
        opened = time_to_open(Path(arguments.log))
        _say(
            f"{arguments.log}: {opened['view_messages']:,.0f} messages indexed in {opened['view_index_s']:.2f} s, "
            f"ready for Rerun in {opened['view_open_s']:.2f} s."
        )
        figures |= opened
    return figures


def _messages(arguments: argparse.Namespace) -> int:
    if arguments.messages is None:
        return max(LEAST, round(FLOOD * float(arguments.seconds) / 60))
    if not LEAST <= arguments.messages <= MOST:
        raise InputError(f"--messages {arguments.messages} is no number from {LEAST} to {MOST}")
    return int(arguments.messages)


def _contenders(
    arguments: argparse.Namespace, known: Mapping[str, ContenderT]
) -> tuple[list[ContenderT], list[ContenderT]]:
    """Those who take part, and those who are not installed. One who was asked for has to be."""
    if arguments.contenders is None:
        wanted = list(known)
    else:
        wanted = list(dict.fromkeys(name.strip() for name in arguments.contenders.split(",")))
    for name in wanted:
        if name not in known:
            raise InputError(f"{name!r} is no contender of bench {arguments.what}; {alternatives(name, known)}")
        if arguments.contenders is not None and known[name].missing:
            raise InputError(f"{known[name].label} is {known[name].missing}")
    found = [known[name] for name in wanted]
    return [one for one in found if not one.missing], [one for one in found if one.missing]


@contextmanager
def _progress(steps: int) -> Iterator[Callable[[str], None]]:
    with progress_bar(Console()) as bar:
        task = bar.add_task("measuring", total=steps, detail="")

        def advance(label: str) -> None:
            bar.update(task, advance=1, detail=label)

        yield advance


def _table(*headings: str) -> Table:
    table = Table(box=None, pad_edge=False)
    for heading in headings:
        table.add_column(heading, justify="right" if heading else "left", no_wrap=True)
    return table


def _show(table: Table, absent: list[ContenderT]) -> None:
    for contender in absent:
        table.add_row(contender.label, *("-" for _ in table.columns[1:]))
    Console().print(table)
    for contender in absent:
        _say(f"{contender.label}: {contender.missing}")
    _say("")


def _say(text: str) -> None:
    Console().print(text, highlight=False)
