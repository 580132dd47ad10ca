"""Starts a cell, one process per plugin, follows the session, and ends it in good order whatever happens."""

from __future__ import annotations

import contextlib
import json
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

from runtime import roles
from runtime.bus import Envelope
from runtime.clock import Stopwatch, wall_clock
from runtime.config import CellFile, redacted, scope_of
from runtime.errors import InputError, SessionError
from runtime.messages import Phase, PublisherCounts, Reset, SearchResult, SessionState, header
from runtime.registry import driver
from runtime.roles import Assignment
from runtime.topics import ATTEMPT, COUNTS, PERMIT, RESET, SEARCH_RESULT, SESSION
from runtime.zenoh_bus import ZenohBus, ZenohRouter

START_TIMEOUT = 120.0  # [s] for all plugins to report; a busy machine imports slowly
CLOSE_TIMEOUT = 20.0  # [s] for one plugin to end in good order before it is killed
PACKAGES = ("palpate", "eclipse-zenoh", "mcap", "mujoco", "numpy", "pin", "rerun-sdk", "rosbags", "scipy")


@dataclass(frozen=True)
class Order:
    """What a session shall be."""

    cell_file: CellFile
    logs: Path
    fresh: bool = False
    viewer: dict[str, Any] | None = None  # options of the viewer; None: nobody watches


@dataclass
class Progress:
    """How far a session is, for whoever shows it."""

    searches: int
    done: int = 0
    attempts: int = 0
    board: int = 0
    hole: str = ""
    session_time: float = 0.0  # [s]
    permitted: bool = True


@dataclass
class Session:
    """A session that ended: what came out, and where it is recorded."""

    name: str
    log: Path
    results: list[SearchResult] = field(default_factory=list)
    duration: float = 0.0  # session time [s]
    machine_time: float = 0.0  # [s] from the first permit to the last result
    interrupted: bool = False


@dataclass
class Process:
    """A plugin's process."""

    role: str
    popen: subprocess.Popen[str]
    errors: IO[bytes]

    @property
    def last_words(self) -> str:
        """The last line the process wrote to its standard error."""
        self.errors.seek(0)
        lines = self.errors.read().decode(errors="replace").strip().splitlines()
        return lines[-1] if lines else f"ended with code {self.popen.returncode}"

    def end(self, timeout: float) -> bool:
        """Ask the process to end by closing its input; kill it after `timeout` seconds. True if it ended by itself."""
        if self.popen.stdin is not None:
            with contextlib.suppress(BrokenPipeError):
                self.popen.stdin.close()
        try:
            self.popen.wait(timeout)
        except subprocess.TimeoutExpired:
            self.popen.kill()
            self.popen.wait()
            return False
        return True


def launch(order: Order, show: Callable[[Progress], None]) -> Session:
    """Run a session to its end. KeyboardInterrupt ends it early, in the same order, and is told by `interrupted`.

    Raises InputError if it cannot begin, SessionError if a plugin fails or messages were lost.
    """
    cell_file = order.cell_file
    cell = cell_file.cell
    check = getattr(driver(cell.robot, cell.drivers.get(cell.robot, {}), cell_file.name), "check", None)
    if check is not None:
        check(cell, cell_file.name)
    name = _session_name(order.logs)
    session = Session(name, order.logs / f"{name}.mcap")
    with ZenohRouter(cell.bus.port, cell.bus.domain) as router, _Crew() as crew:
        try:
            for assignment in _assignments(order, session):
                crew.start(assignment)
            crew.wait_until_ready(router)
            with ZenohBus(roles.LAUNCHER, cell.bus.port, cell.bus.domain) as bus:
                follower = _Follower(bus, crew, session, Progress(cell.boards * len(cell.board.holes)), show)
                try:
                    follower.follow()
                except KeyboardInterrupt:
                    session.interrupted = True
                finally:
                    follower.say(Phase.CLOSING, "interrupted" if session.interrupted else "closing")
                    crew.close(all_but=roles.RECORDER)
                    follower.count()
                    crew.close()
        except KeyboardInterrupt:
            session.interrupted = True
            crew.close()
    return session


def _session_name(logs: Path) -> str:
    try:
        logs.mkdir(parents=True, exist_ok=True)
        if not os.access(logs, os.W_OK):
            raise PermissionError("not writable")
    except OSError as error:
        raise InputError(f"logs cannot be written to {logs}: {error.strerror or error}; choose --logs DIR") from None
    name = wall_clock()
    taken = {path.stem for path in logs.glob("*.mcap")}
    return next(candidate for candidate in _numbered(name) if candidate not in taken)


def _numbered(name: str) -> Iterator[str]:
    yield name
    count = 2
    while True:
        yield f"{name}-{count}"
        count += 1


def _assignments(order: Order, session: Session) -> Iterator[Assignment]:
    cell = order.cell_file.cell
    document = order.cell_file.document
    simulated = getattr(driver(cell.robot, cell.drivers.get(cell.robot, {}), order.cell_file.name), "simulated", False)
    scope = scope_of(document) if simulated else "real"
    document = {**document, "posterior": {**document.get("posterior", {}), "scope": scope}}
    store = cell.posterior.path or str(order.logs / "posterior.sqlite3")
    options: dict[str, dict[str, Any]] = {
        roles.POSTERIOR: {"path": store, "fresh": order.fresh},
        roles.RECORDER: {
            "path": str(session.log),
            "metadata": _metadata(order, session),
            "attachments": {order.cell_file.name: order.cell_file.text},
        },
    }
    crew = [role for role in roles.CLOSING_ORDER if role != roles.VIEWER]
    if order.viewer is not None:
        crew.append(roles.VIEWER)
        options[roles.VIEWER] = order.viewer
    for role in crew:
        yield Assignment(
            role=role,
            session=session.name,
            document=redacted(document, role),
            where=order.cell_file.name,
            port=cell.bus.port,
            domain=cell.bus.domain,
            options=options.get(role, {}),
        )


def _metadata(order: Order, session: Session) -> dict[str, dict[str, str]]:
    cell = order.cell_file.cell
    versions = {package: version(package) for package in PACKAGES}
    return {
        "palpate.session": {
            "session": session.name,
            "cell": order.cell_file.name,
            "robot": cell.robot,
            "strategy": cell.strategy,
            "component": cell.component,
            "board_type": cell.board.type,
            "boards": str(cell.boards),
            "seed": str(cell.seed),
            "rate": cell.rate,
            "settings": json.dumps(order.cell_file.document),
        },
        "palpate.versions": {**versions, "python": platform.python_version(), "system": platform.system()},
    }


class _Crew:
    """The processes of a cell."""

    def __init__(self) -> None:
        self._processes: dict[str, Process] = {}
        self._files = contextlib.ExitStack()  # where the processes write their errors

    def start(self, assignment: Assignment) -> None:
        errors = self._files.enter_context(tempfile.TemporaryFile())
        popen = subprocess.Popen(
            [sys.executable, "-P", "-m", "runtime.host"],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=errors,
            text=True,
            start_new_session=True,  # Ctrl-C reaches the launcher alone
            env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},  # plugins share the cores
        )
        self._processes[assignment.role] = Process(assignment.role, popen, errors)
        assert popen.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # `check` tells why it died
            popen.stdin.write(json.dumps(asdict(assignment)) + "\n")
            popen.stdin.flush()

    def check(self) -> None:
        """Raise SessionError if a plugin has ended."""
        for process in self._processes.values():
            if process.popen.poll() is not None:
                raise SessionError(f"{process.role}: {process.last_words}")

    def wait_until_ready(self, router: ZenohRouter) -> None:
        waited = Stopwatch()
        while missing := router.wait_for(set(self._processes), 0.2):
            self.check()
            if waited.seconds > START_TIMEOUT:
                raise SessionError(f"not ready within {START_TIMEOUT:g} s: {', '.join(sorted(missing))}")

    def close(self, all_but: str = "") -> None:
        """End the processes, in order. Raises SessionError for those that had to be killed, once all have ended."""
        killed = []
        for role in roles.CLOSING_ORDER:
            process = self._processes.get(role)
            if process is not None and role != all_but:
                del self._processes[role]
                if not process.end(CLOSE_TIMEOUT):
                    killed.append(role)
        if killed:
            raise SessionError(f"had to be killed: {', '.join(killed)}")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for process in self._processes.values():
            process.popen.kill()
            process.popen.wait()
        self._files.close()


class _Follower:
    """The launcher's own voice and ear on the bus."""

    def __init__(
        self, bus: ZenohBus, crew: _Crew, session: Session, progress: Progress, show: Callable[[Progress], None]
    ) -> None:
        self._bus = bus
        self._crew = crew
        self._session = session
        self._progress = progress
        self._show = show
        self._now = 0  # session time [ns]
        self._resets = bus.publisher(RESET)
        self._states = bus.publisher(SESSION)
        self._counts = bus.publisher(COUNTS)
        bus.subscribe(PERMIT, SEARCH_RESULT, ATTEMPT, SESSION)
        bus.announce()

    def say(self, phase: Phase, text: str) -> None:
        self._states.send(SessionState(header(self._now), self._session.name, phase, text), self._now)

    def count(self) -> None:
        """Tell the recorder how much this process has published."""
        self._counts.send(PublisherCounts(header(self._now), roles.LAUNCHER, self._bus.counts()), self._now)

    def follow(self) -> None:
        """Start the session as an operator would, by a reset, and follow it until its job is done."""
        self.say(Phase.STARTING, "waiting for the first permit")
        started = False
        watch = Stopwatch()
        while True:
            item = self._bus.inbox.receive(timeout=0.2)
            self._crew.check()
            if not isinstance(item, Envelope):
                continue
            self._now = max(self._now, item.stamp)
            self._progress.session_time = self._now / 1e9
            if item.topic == PERMIT.name:
                permit = item.read(PERMIT)
                self._progress.permitted = permit.granted
                if not started and permit.granted:
                    started = True
                    watch = Stopwatch()
                    self.say(Phase.RUNNING, "")
                elif not started:
                    self._resets.send(Reset(header(self._now), roles.LAUNCHER), self._now)
            elif item.topic == ATTEMPT.name:
                attempt = item.read(ATTEMPT)
                self._progress.attempts += 1
                self._progress.board, self._progress.hole = attempt.board, attempt.hole
            elif item.topic == SEARCH_RESULT.name:
                self._session.results.append(item.read(SEARCH_RESULT))
                self._progress.done += 1
                self._session.duration = self._now / 1e9
                self._session.machine_time = watch.seconds
            elif item.topic == SESSION.name and item.read(SESSION).phase == Phase.DONE:
                self._show(self._progress)
                return
            self._show(self._progress)
