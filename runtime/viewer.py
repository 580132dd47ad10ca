"""Shows a session in Rerun: live over the bus, or a finished log."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal
from urllib.parse import quote

from runtime.bus import Envelope
from runtime.cell import Board
from runtime.clock import Stopwatch
from runtime.context import Context
from runtime.errors import InputError, PalpateError, SessionError
from runtime.log_file import LogFile, open_log
from runtime.settings import read
from runtime.topics import SEARCH_GOAL

if TYPE_CHECKING:
    from runtime.view_scene import Scene

Mode = Literal["spawn", "web", "save"]
APPLICATION = "palpate"
LOOPBACK = "127.0.0.1"
REFRESH = 0.1  # [s] of machine time between two updates of a live view
START_TIMEOUT = 30.0  # [s] of machine time for Rerun to answer
_RADIUS = 2e-3  # [m] of the close-up if nothing says how far searches reach


@dataclass(frozen=True)
class Viewer:
    """Shows the running session. It only listens, and takes samples of what is published all the time."""

    mode: Mode = "spawn"
    path: str = ""  # of the .rrd file to write with mode "save"

    def run(self, context: Context) -> None:
        """Show what arrives until stopped."""
        import rerun as rr

        check(self.mode, Path(self.path) if self.path else None)
        recording = rr.RecordingStream(APPLICATION, recording_id=context.session)
        with contextlib.ExitStack() as stack:
            said = stack.enter_context(_target(recording, self.mode, self.path))
            scene = _prepare(recording, context.session, context.cell.board, context.cell.search.radius)
            context.bus.subscribe(*scene.topics)
            context.ready()
            shown = Stopwatch()
            while not context.stopping:
                item = context.bus.inbox.receive(REFRESH)
                if isinstance(item, Envelope):
                    context.clock.advance(item.stamp)
                    scene.show(item)
                    if said:  # only now: before the session begins the others may not listen yet
                        context.log(said)
                        said = ""
                if shown.seconds > REFRESH:
                    scene.flush()
                    shown = Stopwatch()
            while isinstance(item := context.bus.inbox.poll(), Envelope):
                scene.show(item)
            scene.flush()
            recording.flush(timeout_sec=10.0)
            recording.disconnect()


def view(path: Path, mode: Mode = "spawn", save: Path | None = None, say: Callable[[str], None] = print) -> None:
    """Show a finished log: in a window or a browser until that is closed, or as the .rrd file `save`.

    Raises LogError for a log that cannot be read, InputError for a mode that cannot work here.
    """
    check(mode, save)
    with open_log(path) as log, contextlib.ExitStack() as stack:
        if not log.complete:
            say(f"{path} was never finished; it is shown as far as it goes")
        if save is None:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="palpate-")))
            file = folder / f"{path.stem}.rrd"
        else:
            file = save
        convert(log, file)
        if mode == "save":
            say(f"open it with: rerun {file}")
        elif mode == "web":
            server = stack.enter_context(_rerun([str(file), "--serve-web"]))
            say(f"open {server.url} (Ctrl-C ends it)")
            server.process.wait()
        else:
            stack.enter_context(_rerun([str(file)])).process.wait()


def convert(log: LogFile, file: Path) -> None:
    """Write a log as an .rrd file with the layout inside. Raises InputError if the file cannot be written."""
    import rerun as rr

    recording = rr.RecordingStream(APPLICATION, recording_id=log.path.stem)
    with _saving(recording, file):
        goals = [goal for _, goal in log.read(SEARCH_GOAL)] if SEARCH_GOAL.name in {t.name for t in log.topics} else []
        radius = max((goal.search_radius for goal in goals), default=_RADIUS)
        scene = _prepare(recording, log.path.stem, _board_of(log, goals), radius)
        for count, envelope in enumerate(log.messages()):
            scene.show(envelope)
            if count % 5000 == 4999:
                scene.flush()
        scene.flush()


def has_display() -> bool:
    """Whether a window can be opened here."""
    return not sys.platform.startswith("linux") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def check(mode: str, save: Path | None) -> None:
    """Raise InputError, with the way out, if a mode cannot work here."""
    if mode == "save" and save is None:
        raise InputError("mode 'save' needs the path of an .rrd file")
    if mode == "spawn" and not has_display():
        raise InputError(
            "there is no display for Rerun's window; use `--rerun web` and a browser, "
            "or `palpate view LOG --rerun save` and open the .rrd file on a machine with a display"
        )


def _prepare(recording: Any, name: str, board: Board | None, radius: float) -> Scene:
    """An empty scene with its layout."""
    from runtime.view_blueprint import blueprint, styles
    from runtime.view_scene import Scene

    recording.set_log_time_enabled(False)
    recording.set_log_tick_enabled(False)
    recording.send_recording_name(name)
    recording.send_blueprint(blueprint(board or Board("unknown", ()), radius))
    styles(recording)
    return Scene(recording, board)


def _board_of(log: LogFile, goals: list[Any]) -> Board | None:
    """The board of the settings that the launcher records, or as far as search goals tell."""
    with contextlib.suppress(PalpateError, ValueError, KeyError):
        settings = json.loads(log.metadata["palpate.session"]["settings"])
        return read(Board, settings["board"], "palpate.session")
    from runtime.view_board import board_of

    return board_of(goals) if goals else None


@contextlib.contextmanager
def _saving(recording: Any, file: Path) -> Iterator[None]:
    """Write a recording to a file."""
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        recording.save(file)
    except (OSError, RuntimeError) as error:
        raise InputError(f"{file} cannot be written: {error}") from None
    yield
    recording.flush(timeout_sec=60.0)
    recording.disconnect()


@contextlib.contextmanager
def _target(recording: Any, mode: Mode, path: str) -> Iterator[str]:
    """Connect a live recording with its viewer; yields what to tell the user."""
    if mode == "save":
        with _saving(recording, Path(path)):
            yield ""
        return
    arguments = ["--serve-web"] if mode == "web" else ["--expect-data-soon", "--hide-welcome-screen"]
    with _rerun(arguments, keep=mode == "spawn") as server:
        recording.connect_grpc(server.source)
        yield f"open {server.url} to watch" if mode == "web" else ""


@dataclass(frozen=True)
class _Server:
    """A running Rerun process."""

    process: subprocess.Popen[bytes]
    source: str  # where data goes to
    url: str  # what a browser opens


@contextlib.contextmanager
def _rerun(arguments: list[str], *, keep: bool = False) -> Iterator[_Server]:
    """Run Rerun's own viewer or server, on loopback only: the SDK's own servers listen on every interface.

    With `keep` it outlives us, as a window does that somebody still looks at.
    """
    port, web_port = _free_port(), _free_port()
    program = Path(str(resources.files("rerun_cli"))) / "rerun"  # its Python script would not pass signals on
    command = [str(program), "--bind", LOOPBACK, "--port", str(port), *arguments]
    if "--serve-web" in arguments:
        command += ["--web-viewer-port", str(web_port)]
    environment = {"RUST_LOG": "error", **os.environ}
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL, start_new_session=keep, env=environment)
    try:
        _wait_for(web_port if "--serve-web" in arguments else port, process)
        source = f"rerun+http://{LOOPBACK}:{port}/proxy"
        yield _Server(process, source, f"http://{LOOPBACK}:{web_port}/?url={quote(source, safe='')}")
    finally:
        if not keep:
            process.terminate()
            process.wait()


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind((LOOPBACK, 0))
        return int(probe.getsockname()[1])


def _wait_for(port: int, process: subprocess.Popen[bytes]) -> None:
    watch = Stopwatch()
    while watch.seconds < START_TIMEOUT:
        with contextlib.suppress(OSError), socket.create_connection((LOOPBACK, port), timeout=1.0):
            return
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(0.05)
            raise SessionError(f"Rerun ended at once with exit code {process.returncode}")
    raise SessionError(f"Rerun did not answer on {LOOPBACK}:{port} within {START_TIMEOUT:g} s")
