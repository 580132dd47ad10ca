"""Faults that a cell is struck by at random moments of its work, and what became of it each time."""

from __future__ import annotations

import contextlib
import os
import random
import resource
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field, replace
from fnmatch import fnmatch
from functools import partial
from pathlib import Path
from typing import Any

from runtime.benchmark import stranger
from runtime.benchmark.promises import Verdict, verdict_on
from runtime.benchmark.small_cell import Plan, SmallCell
from runtime.clock import Stopwatch, pause
from runtime.errors import PalpateError, SessionError
from runtime.roles import CLOSING_ORDER, INTERLOCK, LAUNCHER, POSTERIOR, RECORDER, VIEWER
from runtime.topics import ATTEMPT, BELIEF, CANDIDATE

HOLES = 2  # of a cell's board
AT_ONCE = 2  # cells
SHORT_STOP = 3.0  # [s] that a process stands still
LONG_STOP = 15.0  # [s] after which connections to it have been given up
SLOWED = 3.0  # [s] for which a process is slow
SHARE, PERIOD = 0.1, 0.1  # of the time that it runs, in each period [s]
_CRASH_WITHIN = 1.5  # [s] after its start
_SPREAD = 1.0  # [s] from the moment at which a fault may come on

Strike = Callable[[SmallCell, random.Random], None]


@dataclass(frozen=True)
class Fault:
    """One row of the matrix."""

    name: str
    meaning: str
    strike: Strike
    plan: Plan = field(default_factory=Plan)
    at_start: bool = False  # instead of at a random moment of its work, before or after its first search is on record
    recovers: bool = False  # whether the cell must do its whole job all the same, or may end with one clear line
    kills: bool = False  # the launcher, which then says nothing
    names: str = ""  # role that the line has to name, if the cell ends
    limit: float = 60.0  # [s] for the cell to end after it
    prepare: Callable[[Path, random.Random], Mapping[str, str]] | None = None  # environment of its processes
    obstacle: Callable[[], str] = lambda: ""  # why it cannot be brought about here; empty if it can


@dataclass
class Row:
    """What became of all tries with one fault."""

    fault: Fault
    skipped: str = ""  # why there were none
    told: dict[int, Verdict] = field(default_factory=dict)  # by number of the try

    @property
    def verdicts(self) -> list[Verdict]:
        """In the order of the tries."""
        return [self.told[number] for number in sorted(self.told)]

    @property
    def broken(self) -> list[str]:
        """Promises, by try."""
        return [f"try {number}: {what}" for number, one in enumerate(self.verdicts, 1) for what in one.broken]

    @property
    def stop(self) -> float | None:
        """[s] the worst."""
        return max((one.stop for one in self.verdicts if one.stop is not None), default=None)

    @property
    def recovered(self) -> int:
        """In how many tries the cell did its job."""
        return sum(one.recovered for one in self.verdicts)


def measure(
    faults: Sequence[Fault], document: Mapping[str, Any], tries: int, seed: int, advance: Callable[[str], None]
) -> list[Row]:
    """Strike a cell with each fault so many times, two cells at once, as most of the time is spent waiting.

    Every try has dice of its own, whichever others there are. `advance` hears of each that is done.
    """
    rows = [Row(fault, skipped=fault.obstacle()) for fault in faults]
    ward = _Ward(document)
    with ThreadPoolExecutor(AT_ONCE) as pool:
        try:
            pending = {
                pool.submit(ward.tried, row.fault, random.Random(f"{seed} {row.fault.name} {number}")): (row, number)
                for row in rows
                for number in range(tries if not row.skipped else 0)
            }
            for done in as_completed(pending):
                row, number = pending[done]
                row.told[number] = done.result()
                advance(row.fault.name)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            ward.close()
            raise
    return rows


class _Ward:
    """The cells that are being struck."""

    def __init__(self, document: Mapping[str, Any]) -> None:
        self._document = document
        self._cells: set[SmallCell] = set()

    def tried(self, fault: Fault, dice: random.Random) -> Verdict:
        """Run a cell, strike it, wait for its end, judge it."""
        with tempfile.TemporaryDirectory(prefix="palpate-") as name:
            folder = Path(name)
            environment = fault.prepare(folder, dice) if fault.prepare is not None else {}
            plan = replace(fault.plan, environment=environment)
            with SmallCell(folder / "cell", self._document, plan) as cell:
                self._cells.add(cell)
                struck = _struck(fault, cell, dice)
                verdict = verdict_on(cell, cell.wait(fault.limit), fault.limit, killed=fault.kills)
                self._cells.discard(cell)
        broken = [*struck, *verdict.broken]
        if fault.recovers and not verdict.recovered:
            broken.append(f"the cell did not go on: {verdict.line}")
        if not verdict.recovered and fault.names.replace("_", " ") not in verdict.line.replace("_", " "):
            broken.append(f"what it said does not name {fault.names}: {verdict.line}")
        return replace(verdict, broken=tuple(broken))

    def close(self) -> None:
        """End them all: their tries then come to an end as well."""
        for cell in list(self._cells):
            cell.close()


def _struck(fault: Fault, cell: SmallCell, dice: random.Random) -> list[str]:
    """Bring the fault about at a random moment; what prevented it, if anything did."""
    try:
        if not fault.at_start:
            cell.hear(dice.choice((CANDIDATE, BELIEF)))
            pause(dice.uniform(0.0, _SPREAD))
        fault.strike(cell, dice)
    except (PalpateError, OSError) as error:  # a process that has ended by then
        return [f"the fault did not come about: {error}"]
    return []


def figures_of(rows: Sequence[Row]) -> dict[str, float]:
    """The matrix in a few numbers."""
    verdicts = [one for row in rows for one in row.verdicts]
    return {
        "faults_tried": float(len(verdicts)),
        "faults_passed": float(sum(not one.broken for one in verdicts)),
        "faults_recovered": float(sum(one.recovered for one in verdicts)),
        "worst_stop_ms": 1e3 * max((one.stop for one in verdicts if one.stop is not None), default=0.0),
        "evidence_lost": float(sum(one.lost for one in verdicts)),
        "logs_unreadable": float(sum(one.unreadable for one in verdicts)),
        "processes_left": float(sum(one.left for one in verdicts)),
    }


def chosen(patterns: str | None) -> list[Fault]:
    """The faults whose names match one of the patterns, or contain one of the words; all for None."""
    known = all_faults()
    if patterns is None:
        return known
    wanted = [one.strip() for one in patterns.split(",") if one.strip()]
    return [fault for fault in known if any(fnmatch(fault.name, one) or one in fault.name for one in wanted)]


def all_faults() -> list[Fault]:
    """The matrix."""
    roles = CLOSING_ORDER
    return [
        *(_of_role(role, "kill -9", "is killed", partial(_kill, role), boards=3) for role in roles),
        *(
            _of_role(role, "SIGSTOP 3 s", "stands still for a while", partial(_pause, role, SHORT_STOP), recovers=True)
            for role in roles
        ),
        *(_of_role(role, "SIGSTOP", "stands still for good", partial(_halt, role), boards=5) for role in roles),
        *(_of_role(role, "slow", "runs a tenth of the time", partial(_slow, role), 2, recovers=True) for role in roles),
        *(_crash(role) for role in roles),
        *_of_router(),
        *_of_disk(),
        *_of_messages(),
        *_of_two(),
    ]


def _of_role(role: str, what: str, does: str, strike: Strike, boards: int = 1, *, recovers: bool = False) -> Fault:
    return Fault(
        f"{what} {role}",
        f"the process of {role} {does}",
        strike,
        Plan(boards=boards, viewer=role == VIEWER),
        recovers=recovers,
        names=role,
    )


def _kill(role: str, cell: SmallCell, _dice: random.Random) -> None:
    cell.send(role, signal.SIGKILL)


def _halt(role: str, cell: SmallCell, _dice: random.Random) -> None:
    cell.send(role, signal.SIGSTOP)


def _pause(role: str, seconds: float, cell: SmallCell, _dice: random.Random) -> None:
    watch = Stopwatch()
    with cell.stopped(role):
        while cell.running and watch.seconds < seconds:
            pause(PERIOD)


def _slow(role: str, cell: SmallCell, _dice: random.Random) -> None:
    process, watch = cell.process_of(role), Stopwatch()
    with contextlib.suppress(ProcessLookupError):  # a cell may be done before
        while cell.running and watch.seconds < SLOWED:
            os.kill(process, signal.SIGSTOP)
            pause((1 - SHARE) * PERIOD)
            os.kill(process, signal.SIGCONT)
            pause(SHARE * PERIOD)


_CRASHING = """\
import os, signal, sys, threading
if sys.orig_argv[-2:] == ["runtime.host", {role!r}]:
    threading.Timer({delay!r}, os.kill, (os.getpid(), signal.SIGSEGV)).start()
"""


def _crash(role: str) -> Fault:
    def prepare(folder: Path, dice: random.Random) -> Mapping[str, str]:
        text = _CRASHING.format(role=role, delay=dice.uniform(0.0, _CRASH_WITHIN))
        (folder / "sitecustomize.py").write_text(text, encoding="utf-8")
        return {"PYTHONPATH": os.pathsep.join(filter(None, (str(folder), os.environ.get("PYTHONPATH"))))}

    return Fault(
        f"crash {role}",
        f"the process of {role} crashes at a moment of its start",
        lambda _cell, _dice: None,
        Plan(boards=3, viewer=role == VIEWER),
        at_start=True,
        names=role,
        prepare=prepare,
        limit=90.0,
    )


def _of_router() -> list[Fault]:
    patient = Plan(patience="60 s", rate="max")
    return [
        Fault(
            "router SIGSTOP 3 s",
            "the launcher, in which the router lives, stands still for a while",
            partial(_pause, LAUNCHER, SHORT_STOP),
            recovers=True,
        ),
        Fault(
            "router gone and back",
            "it stands still until all have given up their connections to it, then goes on",
            partial(_pause, LAUNCHER, LONG_STOP),
            replace(patient, boards=3),
            limit=90.0,
        ),
        Fault(
            "connections cut",
            "every connection to the router is reset at once, by the kernel",
            _cut,
            replace(patient, boards=2),
            obstacle=_cannot_cut,
        ),
        Fault("kill -9 router", "the launcher is killed, and the router with it", partial(_kill, LAUNCHER), kills=True),
    ]


def _cut(cell: SmallCell, _dice: random.Random) -> None:
    done = subprocess.run(
        ["ss", "-K", "dst", "127.0.0.1", "dport", "=", str(cell.port)], capture_output=True, check=False
    )
    if str(cell.port).encode() not in done.stdout:
        raise SessionError(f"ss cut no connection: {done.stderr.decode(errors='replace').strip()}")


def _cannot_cut() -> str:
    return "" if shutil.which("ss") and os.geteuid() == 0 else "needs root and ss (iproute2)"


def _of_disk() -> list[Fault]:
    return [
        Fault(
            "full disk recorder",
            "the recorder can write no further",
            partial(_fill, RECORDER, lambda cell: cell.log),
            Plan(boards=5),
            names=RECORDER,
        ),
        Fault(
            "full disk posterior",
            "the posterior store can grow no further",
            partial(_fill, POSTERIOR, lambda cell: cell.store.with_name(cell.store.name + "-wal")),
            Plan(boards=20),
            names=POSTERIOR,
            limit=90.0,
        ),
    ]


def _fill(role: str, grows: Callable[[SmallCell], Path | None], cell: SmallCell, dice: random.Random) -> None:
    """Limit the size of the files of a process to what one of them has by now, or a little more."""
    path = grows(cell)
    if path is None or not path.exists():
        raise SessionError(f"{role} has written no file yet")
    size = path.stat().st_size + dice.randrange(5_000)
    resource.prlimit(cell.process_of(role), resource.RLIMIT_FSIZE, (size, size))


def _of_messages() -> list[Fault]:
    senseless = {
        "malformed bytes": ("bytes at random and cut messages on every input of every plugin", stranger.malformed),
        "NaN": ("real messages with every number not a number, on every input", stranger.not_numbers),
        "out of range": ("real messages with every number out of range, on every input", stranger.out_of_range),
    }
    odd = {
        "out of order": ("old messages once more on every input, the latest first", stranger.out_of_order),
        "clock ahead": ("somebody says on /clock that it is an hour later", stranger.clock_ahead),
        "clock back": ("somebody says on /clock that it is the beginning", stranger.clock_back),
    }
    return [
        *(Fault(name, text, partial(_talk, say), recovers=True) for name, (text, say) in senseless.items()),
        *(Fault(name, text, partial(_talk, say)) for name, (text, say) in odd.items()),
    ]


def _talk(say: stranger.Round, cell: SmallCell, dice: random.Random) -> None:
    stranger.talk(cell, dice, say)


def _of_two() -> list[Fault]:
    return [
        Fault(
            "two interlocks",
            "the interlock stands still, and somebody else grants permits meanwhile",
            _forge,
            recovers=True,
        ),
        Fault("two arms", "somebody else tells of attempts", partial(_talk, stranger.second_arm)),
        Fault("two strategies", "somebody else proposes candidates", partial(_talk, stranger.second_strategy)),
        Fault("shared store", "another cell adds to the same store", _share, Plan(boards=4), recovers=True),
        Fault(
            "shared store and kill -9",
            "as before, and the posterior of the first is killed",
            _share_and_kill,
            Plan(boards=30),
            names=POSTERIOR,
        ),
        Fault("shared port", "another cell is launched on the same port", _collide, Plan(boards=4), recovers=True),
    ]


def _forge(cell: SmallCell, dice: random.Random) -> None:
    with cell.stopped(INTERLOCK):
        stranger.talk(cell, dice, stranger.second_interlock)


def _share(cell: SmallCell, _dice: random.Random) -> None:
    other = cell.beside()
    cell.companions.append(other)
    other.hear(ATTEMPT)


def _share_and_kill(cell: SmallCell, dice: random.Random) -> None:
    other = cell.beside()
    cell.companions.append(other)
    other.hear(ATTEMPT)
    pause(dice.uniform(0.0, _SPREAD))
    cell.send(POSTERIOR, signal.SIGKILL)


def _collide(cell: SmallCell, _dice: random.Random) -> None:
    with cell.beside(cell.port) as other:
        ending = other.wait(30.0)
    if ending.code != 2 or not ending.line:
        raise SessionError(f"the other cell ended with code {ending.code}: {' / '.join(ending.errors)}")
