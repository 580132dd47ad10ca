"""Makes the recorded sessions in this folder: one for each strategy, one of searches given up, one of an arm by wire.

    python tests/golden/make.py [NAME ...]

Run it only when decisions are meant to change: `test_reexecution.py` lets today's code decide on these logs again.
Each is a real session of two holes with the topics alone that decisions rest on, all but the last the second of its
board type.
"""

from __future__ import annotations

import os
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))

from runtime.cli import ONE_THREAD  # noqa: E402 - it loads no linear algebra yet

os.environ.update(ONE_THREAD)

from cells import cell_text, write_cell  # noqa: E402 - beside the tests

from runtime import config, topics  # noqa: E402
from runtime.bus import Envelope, encode  # noqa: E402
from runtime.in_process import run_in_process  # noqa: E402
from runtime.launcher import Order  # noqa: E402
from runtime.log.file import open_log  # noqa: E402
from runtime.log.writer import LogWriter  # noqa: E402
from runtime.reexecution.session import DECIDED_FROM  # noqa: E402

STRATEGIES = ("linear", "spiral", "hybrid", "meta", "bayes", "bayes-slide")
WIRED, EXHAUSTED = "wired", "exhausted"
_REACH_IN = 'interruptions = [{ at = "5 s", clear_after = "0.6 s", reset_after = "0.4 s" }]\n'


def text(holes: int = 2, extra: str = "", **replacements: str) -> str:
    """A cell in which somebody reaches into the light curtain once."""
    return cell_text(holes=holes, extra=extra, **replacements).replace("[safety]\n", "[safety]\n" + _REACH_IN)


def session(folder: Path, cell: str, before: int = 1) -> Path:
    """The log of a session, after one `before` it in the same folder, so that it begins with evidence."""
    order = Order(config.load(str(write_cell(folder, cell))), folder / "logs")
    for _ in range(before):
        run_in_process(order)
    return run_in_process(order).log


def strip(source: Path, target: Path) -> None:
    """Keep of a log what decisions rest on."""
    target.unlink(missing_ok=True)
    with open_log(source) as log, LogWriter(target) as kept:
        for name, values in log.metadata.items():
            kept.add_metadata(name, values)
        for envelope in log.messages(topic.name for topic in DECIDED_FROM):
            kept.write(_unsealed(envelope) if envelope.topic == topics.PERMIT.name else envelope)


def _unsealed(envelope: Envelope) -> Envelope:
    """A permit without its seal, which nothing compresses and nobody can check without the session's key."""
    return replace(envelope, payload=encode(replace(envelope.read(topics.PERMIT), seal="")))


def make(name: str) -> Path:
    """Record and keep one session."""
    target = HERE / f"{name}.mcap"
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        if name == WIRED:
            from robots import Robot
            from test_wired_session import LUCKY, wired_text

            with Robot("igbt", seed=LUCKY) as robot:
                cell = wired_text(robot.host, 2, seed=str(LUCKY)).replace("[safety]\n", "[safety]\n" + _REACH_IN)
                strip(session(folder, cell, before=0), target)
        elif name == EXHAUSTED:
            strip(session(folder, text(strategy='"spiral"', seed="3", max_attempts="1")), target)
        else:
            loose = {"board_shift": '"0.4 mm"', "part_scatter": '"0.15 mm"'}
            strip(session(folder, text(strategy=f'"{name}"', seed="5", **loose)), target)
    return target


def main() -> None:
    """Make the logs that are named, or all."""
    for name in sys.argv[1:] or (*STRATEGIES, EXHAUSTED, WIRED):
        target = make(name)
        with open_log(target) as log:
            counts = {topic.name: topic.count for topic in log.topics}
        print(f"{target.name}: {target.stat().st_size} bytes, {counts}")  # noqa: T201 - a script tells what it did


if __name__ == "__main__":
    main()
