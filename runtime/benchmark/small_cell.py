"""A cell of a few holes, run by `palpate launch` as real processes in a folder of its own, and heard from outside."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import threading
import uuid
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from runtime import config
from runtime.bus import Envelope
from runtime.clock import Stopwatch, pause
from runtime.closing import Closing
from runtime.errors import BusError, InputError, SessionError
from runtime.network.meeting_point import free_port
from runtime.network.zenoh_bus import ZenohBus
from runtime.roles import LAUNCHER
from runtime.topics import JOINT_STATES, Topic

RATE = "5"  # session seconds per second: an arm that has no permit stops, as it would at rate 1.0
STARTING = 60.0  # [s] for a cell to be at work on a busy machine
_MARK = "PALPATE_BENCH_CELL"  # in the environment of every process of one cell
_PALPATE = (sys.executable, "-P", "-m", "runtime.cli")
_LOOK = 0.02  # [s]
_ERROR = re.compile(r"^palpate: \S")
_NOT_TAKEN = ("bus", "posterior", "attendance")  # tables of a cell file
_BARE = re.compile(r"[A-Za-z0-9_-]+")


@dataclass(frozen=True)
class Plan:
    """What a cell is to do."""

    boards: int = 1
    rate: str = RATE
    patience: str = "4 s"  # without a permit until the arm gives up
    viewer: bool = False
    store: Path | None = None  # None: one of its own
    environment: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Ending:
    """How a cell ended, as whoever started it sees it."""

    code: int | None  # None: it did not end in time, and was killed
    errors: tuple[str, ...]  # lines on standard error
    left: int  # processes that were still there a while later

    @property
    def line(self) -> str:
        """What it said, if it said one clear thing."""
        if len(self.errors) != 1 or not _ERROR.match(self.errors[0]):
            return ""
        return self.errors[0].removeprefix("palpate: ")


class SmallCell(Closing):
    """A running cell. Closing it kills what is left of it."""

    def __init__(self, folder: Path, document: Mapping[str, Any], plan: Plan, port: int | None = None) -> None:
        self.folder, self.plan = folder, plan
        self._document = document
        self.port = free_port() if port is None else port
        self.searches = plan.boards * len(document["board"]["holes"])
        self._mark = uuid.uuid4().hex
        self.companions: list[SmallCell] = []  # others that were started beside it
        self.strangers: set[bytes] = set()  # identities of publishers whom nobody invited
        folder.mkdir(parents=True, exist_ok=True)
        cell = folder / "cell.toml"
        cell.write_text(toml(_planned(document, plan)), encoding="utf-8")
        self._out, self._err = folder / "stdout", folder / "stderr"
        with self._out.open("wb") as out, self._err.open("wb") as err:
            view = "save" if plan.viewer else "off"
            self.process = subprocess.Popen(
                [*_PALPATE, "launch", cell.name, "--port", str(self.port), "--rerun", view],
                cwd=folder,
                env={**os.environ, **plan.environment, _MARK: self._mark, "COLUMNS": "200"},
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=err,
                start_new_session=True,  # Ctrl-C is for who measures
            )
        self.ear = Ear(self)

    def beside(self, port: int | None = None) -> SmallCell:
        """Another cell that does one board and keeps its evidence in the store of this one."""
        plan = replace(self.plan, boards=1, store=self.store.resolve())
        return SmallCell(self.folder.with_name(f"{self.folder.name}-beside"), self._document, plan, port)

    @property
    def store(self) -> Path:
        """Where its evidence is."""
        return self.plan.store or self.folder / "logs" / "posterior.sqlite3"

    @property
    def log(self) -> Path | None:
        """Its log, if there is one by now."""
        return next(iter(sorted((self.folder / "logs").glob("*.mcap"))), None)

    @property
    def running(self) -> bool:
        """Whether it has not ended yet."""
        return self.process.poll() is None

    def processes(self) -> dict[int, str]:
        """All that carry its mark, with the last word of their command lines: of plugins their role."""
        found = {}
        for entry in Path("/proc").iterdir():
            if not entry.name.isdigit():
                continue
            with contextlib.suppress(OSError):  # ended meanwhile, or another user's
                if f"{_MARK}={self._mark}".encode() in (entry / "environ").read_bytes():
                    words = (entry / "cmdline").read_bytes().decode(errors="replace").split("\0")
                    found[int(entry.name)] = words[-2] if len(words) > 1 else ""
        return found

    def process_of(self, role: str) -> int:
        """The process that plays a role; the router lives in the launcher's. Raises SessionError if there is none."""
        if role == LAUNCHER:
            return self.process.pid
        for pid, word in self.processes().items():
            if word == role:
                return pid
        raise SessionError(f"there is no process of {role}")

    def send(self, role: str, number: signal.Signals) -> None:
        """Send a signal to the process that plays a role. Raises SessionError if it has gone."""
        try:
            os.kill(self.process_of(role), number)
        except ProcessLookupError:
            raise SessionError(f"the process of {role} has ended") from None

    @contextlib.contextmanager
    def stopped(self, role: str) -> Iterator[None]:
        """Let a role's process stand still during the block."""
        self.send(role, signal.SIGSTOP)
        try:
            yield
        finally:
            with contextlib.suppress(SessionError):
                self.send(role, signal.SIGCONT)

    def hear(self, topic: Topic[Any], count: int = 1) -> None:
        """Wait until so many messages of a topic have been heard. Raises SessionError if they never come."""
        watch = Stopwatch()
        while self.ear.count(topic) < count:
            if not self.running or watch.seconds > STARTING:
                raise SessionError(f"{count} of {topic.name} were never heard: {' '.join(self._errors()) or 'silence'}")
            pause(_LOOK)

    def wait(self, patience: float) -> Ending:
        """Wait for its end, for `patience` seconds at most; then for its processes to go."""
        try:
            code: int | None = self.process.wait(patience)
        except subprocess.TimeoutExpired:
            code = None
        watch, left = Stopwatch(), self.processes()
        while code is not None and left and watch.seconds < STARTING / 2:
            pause(_LOOK)
            left = self.processes()
        ending = Ending(code, tuple(self._errors()), len(left) if code is not None else 0)
        self._kill()
        return ending

    def _errors(self) -> list[str]:
        return self._err.read_text(errors="replace").splitlines()

    def close(self) -> None:
        """Kill what is left of it, and of those beside it. Idempotent."""
        self._kill()
        for companion in self.companions:
            companion.close()

    def _kill(self) -> None:
        while left := self.processes():
            for pid in left:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
            self.process.poll()
            pause(_LOOK)
        self.process.wait()
        self.ear.close()


@dataclass(frozen=True, slots=True)
class Heard:
    """A message, and when it came."""

    at: float  # [s] of machine time
    item: Envelope


class Ear(Closing):
    """Hears all that is said in a cell, from when its router answers: what a log may lack."""

    def __init__(self, cell: SmallCell) -> None:
        self._heard: dict[str, list[Heard]] = defaultdict(list)
        self._watch = Stopwatch()
        self._cell = cell
        self._ended = False
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    @property
    def now(self) -> int:
        """The latest session time [ns] that the arm has told of its joints: whoever else speaks does not move it on."""
        return max((one.item.stamp for one in self._heard[JOINT_STATES.name][-1:]), default=0)

    def count(self, topic: Topic[Any]) -> int:
        """How many messages of a topic have been heard."""
        return len(self._heard[topic.name])

    def heard(self, topic: Topic[Any]) -> list[Heard]:
        """All messages of a topic in order of arrival."""
        return list(self._heard[topic.name])

    def _listen(self) -> None:
        bus = self._joined()
        if bus is None:
            return
        with bus:
            bus.subscribe_all()
            while not self._ended:
                for item in bus.inbox.gather(timeout=0.1, linger=_LOOK):
                    if isinstance(item, Envelope):
                        self._heard[item.topic].append(Heard(self._watch.seconds, item))

    def _joined(self) -> ZenohBus | None:
        while not self._ended:
            with contextlib.suppress(BusError):
                return ZenohBus("viewer", self._cell.port, patience=1.0)
            pause(_LOOK)
        return None

    def close(self) -> None:
        """Stop listening. Idempotent."""
        self._ended = True
        self._thread.join()


def small(name: str, holes: int, overrides: Mapping[str, Any]) -> dict[str, Any]:
    """A cell file's document with its first few holes alone, on loopback, with a store of its own, and unattended.

    Raises InputError where that is no cell, or no simulated one.
    """
    loaded = config.load(name, dict(overrides))
    document = {key: value for key, value in loaded.document.items() if key not in _NOT_TAKEN}
    document["board"] = {**document["board"], "holes": document["board"]["holes"][:holes]}
    if "tolerances" in document:
        document["tolerances"] = {**document["tolerances"], "abnormal_hole": 0}
    cell = config.cell_of(document, loaded.name)
    if not getattr(config.robot_of(cell, loaded.name), "simulated", False):
        raise InputError(f"{loaded.name}: {cell.robot} is not simulated; nobody strikes a cell with a real arm")
    return document


def _planned(document: Mapping[str, Any], plan: Plan) -> dict[str, Any]:
    safety = {**document.get("safety", {}), "patience": plan.patience}
    posterior = {} if plan.store is None else {"posterior": {"path": str(plan.store)}}
    return {**document, "boards": plan.boards, "rate": plan.rate, "safety": safety, **posterior}


def toml(document: Mapping[str, Any]) -> str:
    """A document of plain values as TOML."""
    return "".join(f"{_key(key)} = {_value(value)}\n" for key, value in document.items())


def _key(key: str) -> str:
    return key if _BARE.fullmatch(key) else json.dumps(key)


def _value(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(key)} = {_value(item)}" for key, item in value.items()) + " }"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(_value, value)) + "]"
    return json.dumps(value)
