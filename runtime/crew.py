"""The processes of a cell: started together, watched, ended in order."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from types import TracebackType
from typing import IO, Self

from runtime.clock import Stopwatch, pause
from runtime.errors import SessionError
from runtime.linear_algebra import ONE_THREAD
from runtime.roles import CLOSING_ORDER, RECORDER, Assignment

START_TIMEOUT = 120.0  # [s] for all plugins to report; a busy machine imports slowly
_CRASH = "Fatal Python error: "  # how the trace of a crash begins (faulthandler)
_TOGETHER = 0.2  # [s] in which those end that cannot do without one that has
CLOSE_TIMEOUT = 20.0  # [s] for one plugin to end in good order before it is killed


@dataclass
class Process:
    """A plugin's process."""

    role: str
    popen: subprocess.Popen[str]
    errors: IO[bytes]

    @property
    def last_words(self) -> str:
        """The last line the process wrote to its standard error; if it crashed, how, and the last line before that."""
        self.errors.seek(0)
        lines = self.errors.read().decode(errors="replace").strip().splitlines()
        crash = next((index for index, line in enumerate(lines) if line.startswith(_CRASH)), None)
        if crash is not None:
            before = f" after: {lines[crash - 1]}" if crash else ""
            return f"crashed ({lines[crash].removeprefix(_CRASH)}){before}"
        if lines:
            return lines[-1]
        code = self.popen.returncode
        return f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with code {code}"

    def end(self, timeout: float) -> bool:
        """Ask the process to end by closing its input; kill it after `timeout` seconds. True if it ended by itself."""
        self.popen.send_signal(signal.SIGCONT)  # one that was stopped could not end
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


class Crew:
    """The processes of a cell."""

    def __init__(self) -> None:
        self._processes: dict[str, Process] = {}
        self._files = contextlib.ExitStack()  # where the processes write their errors

    def start(self, assignment: Assignment) -> None:
        """Start one plugin."""
        errors = self._files.enter_context(tempfile.TemporaryFile())  # noqa: SIM115 - closed with the crew
        popen = subprocess.Popen(
            [sys.executable, "-P", "-m", "runtime.host", assignment.role],  # the role is for who lists processes
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=errors,
            text=True,
            start_new_session=True,  # Ctrl-C reaches the launcher alone
            env=os.environ | ONE_THREAD,  # plugins share the cores, too
        )
        self._processes[assignment.role] = Process(assignment.role, popen, errors)
        assert popen.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # `check` tells why it died
            popen.stdin.write(json.dumps(asdict(assignment)) + "\n")
            popen.stdin.flush()

    def check(self) -> None:
        """Raise SessionError if a plugin has ended, and tell of those that it took along."""
        if self._ended():
            pause(_TOGETHER)
            raise SessionError("; ".join(f"{process.role}: {process.last_words}" for process in self._ended()))

    def _ended(self) -> list[Process]:
        return [process for process in self._processes.values() if process.popen.poll() is not None]

    @property
    def roles(self) -> set[str]:
        """Those whose processes have been started and not ended."""
        return set(self._processes)

    def wait_until_ready(self, wait_for: Callable[[set[str], float], set[str]]) -> None:
        """Wait until all have announced themselves. Raises SessionError if one ends before, or it takes too long."""
        waited = Stopwatch()
        while missing := wait_for(set(self._processes), 0.2):
            self.check()
            if waited.seconds > START_TIMEOUT:
                raise SessionError(f"not ready within {START_TIMEOUT:g} s: {', '.join(sorted(missing))}")

    def close(self, all_but: str = "") -> None:
        """End the processes, in order.

        Raises SessionError once all have ended, for those that had to be killed and for a recorder that failed at last.
        """
        killed, failed = [], []
        for role in CLOSING_ORDER:
            process = self._processes.get(role)
            if process is not None and role != all_but:
                del self._processes[role]
                if not process.end(CLOSE_TIMEOUT):
                    killed.append(role)
                elif role == RECORDER and process.popen.returncode:
                    failed.append(f"{role}: {process.last_words}")
        if killed:
            failed.append(f"had to be killed: {', '.join(killed)}")
        if failed:
            raise SessionError("; ".join(failed))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for process in self._processes.values():
            process.popen.kill()
            process.popen.wait()
        self._files.close()
