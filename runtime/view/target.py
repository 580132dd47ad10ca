"""Where a recording goes: Rerun's window, a browser that Rerun serves on loopback, or an .rrd file."""

from __future__ import annotations

import contextlib
import os
import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, Literal
from urllib.parse import quote

from runtime.clock import Stopwatch
from runtime.errors import InputError, SessionError
from runtime.network.meeting_point import LOOPBACK, free_port

Mode = Literal["spawn", "web", "save"]
APPLICATION = "palpate"  # by which Rerun knows our recordings
START_TIMEOUT = 30.0  # [s] of machine time for Rerun to answer
FLUSH_TIMEOUT = 60.0  # [s] of machine time for what was drawn to be handed over


@dataclass(frozen=True)
class Shown:
    """What shows a recording."""

    url: str = ""  # what a browser opens
    process: subprocess.Popen[bytes] | None = None  # of Rerun

    def wait(self) -> None:
        """Wait until Rerun's window is closed, or for ever for a browser; not at all for a file."""
        if self.process is not None:
            self.process.wait()


def has_display() -> bool:
    """Whether a window can be opened here."""
    return not sys.platform.startswith("linux") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


@contextlib.contextmanager
def target(recording: Any, mode: Mode, file: Path | None = None, *, keep: bool = False) -> Iterator[Shown]:
    """Connect a recording with what shows it. With `keep` a window outlives us, for somebody may still look at it.

    Raises InputError if `file`, which mode "save" needs, cannot be written, SessionError if Rerun does not start.
    """
    if mode == "save":
        if file is None:
            raise InputError("mode 'save' needs the path of an .rrd file")
        with _saving(recording, file):
            yield Shown()
        return
    arguments = ["--serve-web"] if mode == "web" else ["--expect-data-soon", "--hide-welcome-screen"]
    with _rerun(arguments, keep=keep and mode == "spawn") as server:
        recording.connect_grpc(server.source)
        try:
            yield Shown(server.url if mode == "web" else "", server.process)
        finally:
            recording.disconnect()


@contextlib.contextmanager
def _saving(recording: Any, file: Path) -> Iterator[None]:
    """Write a recording to a file."""
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        recording.save(file)
    except (OSError, RuntimeError) as error:
        raise InputError(f"{file} cannot be written: {error}") from None
    yield
    recording.flush(timeout_sec=FLUSH_TIMEOUT)
    recording.disconnect()


@dataclass(frozen=True)
class _Server:
    """A running Rerun process."""

    process: subprocess.Popen[bytes]
    source: str  # where data goes to
    url: str  # what a browser opens


@contextlib.contextmanager
def _rerun(arguments: list[str], *, keep: bool) -> Iterator[_Server]:
    """Run Rerun's own viewer or server, on loopback only: the SDK's own servers listen on every interface."""
    port, web_port = free_port(), free_port()
    program = Path(str(resources.files("rerun_cli"))) / "rerun"  # its Python script would not pass signals on
    command = [str(program), "--bind", LOOPBACK, "--port", str(port), *arguments]
    if "--serve-web" in arguments:
        command += ["--web-viewer-port", str(web_port)]
    if not keep:
        command = [*_dying_with_us(), *command]
    environment = {"RUST_LOG": "error", **os.environ}
    # In a session of its own it hears no Ctrl-C, and takes what it is sent until we end it.
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL, start_new_session=True, env=environment)
    try:
        _wait_for(web_port if "--serve-web" in arguments else port, process)
        source = f"rerun+http://{LOOPBACK}:{port}/proxy"
        yield _Server(process, source, f"http://{LOOPBACK}:{web_port}/?url={quote(source, safe='')}")
    finally:
        if not keep:
            process.terminate()
            process.wait()


def _dying_with_us() -> list[str]:
    """What to put before a command that shall end even where we are killed: util-linux has it, macOS does not."""
    setpriv = shutil.which("setpriv")
    return [setpriv, "--pdeathsig", "TERM"] if setpriv else []


def _wait_for(port: int, process: subprocess.Popen[bytes]) -> None:
    watch = Stopwatch()
    while watch.seconds < START_TIMEOUT:
        with contextlib.suppress(OSError), socket.create_connection((LOOPBACK, port), timeout=1.0):
            return
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(0.05)
            raise SessionError(f"Rerun ended at once with exit code {process.returncode}")
    raise SessionError(f"Rerun did not answer on {LOOPBACK}:{port} within {START_TIMEOUT:g} s")
