"""Compiling in a process of its own, so that a script can neither stall nor exhaust the control loop.

The worker gets and gives frames: four bytes of length, then the content. Its first frame is the table of builtins,
every other one a script; it answers each with a line of JSON, followed by the marshalled code if the script is one.
"""

from __future__ import annotations

import hashlib
import json
import os
import resource
import select
import signal
import subprocess
import sys
import time
from collections import OrderedDict, deque
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass

from drivers.ur3e.urscript.errors import ScriptError
from drivers.ur3e.urscript.script import Script
from runtime.closing import Closing

TIMEOUT = 10.0  # [s] for one script, the worker's start included
_CPU = 10  # [s] of processor time for one script
_MEMORY = 1 << 30  # [bytes] of address space
_LONGEST_TEXT = 1_000_000  # [characters] sent to the worker at all
_CACHED = 32  # scripts
_WAITING = 32  # scripts
_PIECE = 1 << 18  # [bytes] read or written in one go
_ORPHAN_CHECK = 2.0  # [s]

Result = Script | ScriptError


@dataclass
class _Job:
    ticket: int
    text: str
    key: bytes
    deadline: float = 0.0  # [s] of the monotonic clock


class Compiler(Closing):
    """Hands scripts to the worker one by one; nothing here waits for it."""

    def __init__(self, builtins: Mapping[str, bool], timeout: float = TIMEOUT) -> None:
        self._table = _frame(json.dumps(dict(builtins)).encode())
        self._timeout = timeout
        self._tickets = 0
        self._waiting: deque[_Job] = deque()
        self._job: _Job | None = None
        self._ready: list[tuple[int, Result]] = []
        self._cache: OrderedDict[bytes, Result] = OrderedDict()
        self._dying: list[subprocess.Popen[bytes]] = []
        self._outgoing = b""
        self._incoming = bytearray()
        self._worker: subprocess.Popen[bytes] | None = None
        self._start()

    @property
    def pid(self) -> int | None:
        """The worker's process, if it runs."""
        return self._worker.pid if self._worker else None

    def submit(self, text: str) -> int:
        """Begin to compile a script; `poll` gives the result under the ticket returned here."""
        self._tickets += 1
        job = _Job(self._tickets, text, b"")
        if len(text) > _LONGEST_TEXT:
            refusal = f"a script of {len(text)} characters; the limit is {_LONGEST_TEXT}"
            self._ready.append((job.ticket, ScriptError(1, 1, refusal)))
        elif len(self._waiting) >= _WAITING:
            self._ready.append((job.ticket, ScriptError(1, 1, f"more than {_WAITING} scripts wait to be compiled")))
        else:
            job.key = hashlib.sha256(text.encode("utf-8", "surrogatepass")).digest()
            self._waiting.append(job)
            self._work()
        return job.ticket

    def poll(self) -> list[tuple[int, Result]]:
        """What has been compiled, or turned out to be no script, since the last call."""
        self._dying = [process for process in self._dying if process.poll() is None]
        self._work()
        ready, self._ready = self._ready, []
        return ready

    def close(self) -> None:
        """End the worker; what it has not finished is dropped."""
        self._waiting.clear()
        self._job = None
        self._discard()
        for process in self._dying:
            process.wait()
        self._dying = []

    def _start(self) -> None:
        command = [sys.executable, "-P", "-m", "drivers.ur3e.urscript.compile_worker"]
        self._worker = subprocess.Popen(
            command, bufsize=0, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
        )
        for pipe in (self._worker.stdin, self._worker.stdout):
            if pipe is not None:
                os.set_blocking(pipe.fileno(), False)
        self._outgoing = self._table
        self._incoming = bytearray()

    def _discard(self) -> None:
        if self._worker is None:
            return
        self._worker.kill()
        for pipe in (self._worker.stdin, self._worker.stdout):
            if pipe is not None:
                pipe.close()
        self._dying.append(self._worker)
        self._worker = None

    def _work(self) -> None:
        """Advance as far as possible without waiting."""
        while self._job is not None or self._waiting:
            if self._job is None:
                self._begin()
                continue
            if not self._exchange():
                self._fail("compiling ended early: the script needs too much time or memory")
                continue
            answer = self._answer()
            if answer is not None:
                self._finish(self._job, answer)
            elif time.monotonic() > self._job.deadline:
                self._fail(f"compiling took longer than {self._timeout:g} s")
            else:
                return

    def _begin(self) -> None:
        job = self._waiting.popleft()
        known = self._cache.get(job.key)
        if known is not None:
            self._cache.move_to_end(job.key)
            self._ready.append((job.ticket, known))
            return
        if self._worker is None or self._worker.poll() is not None:
            self._discard()
            self._start()
        self._outgoing += _frame(job.text.encode("utf-8", "surrogatepass"))
        job.deadline = time.monotonic() + self._timeout
        self._job = job

    def _exchange(self) -> bool:
        """Write and read what the pipes take and have. False if the worker is gone."""
        worker = self._worker
        if worker is None or worker.stdin is None or worker.stdout is None:
            return False
        try:
            if self._outgoing:
                with suppress(BlockingIOError):
                    sent = os.write(worker.stdin.fileno(), self._outgoing[:_PIECE])
                    self._outgoing = self._outgoing[sent:]
            with suppress(BlockingIOError):
                received = os.read(worker.stdout.fileno(), _PIECE)
                self._incoming += received
                return bool(received)
        except OSError:
            return False
        return True

    def _answer(self) -> bytes | None:
        """The content of the frame received, once it is complete."""
        if len(self._incoming) < 4:
            return None
        length = int.from_bytes(self._incoming[:4], "big")
        if len(self._incoming) < 4 + length:
            return None
        content = bytes(self._incoming[4 : 4 + length])
        del self._incoming[: 4 + length]
        return content

    def _finish(self, job: _Job, answer: bytes) -> None:
        head, _, code = answer.partition(b"\n")
        said = json.loads(head)
        result: Result
        if "text" in said:
            result = ScriptError(said["line"], said["column"], said["text"])
        else:
            result = Script(said["name"], said["kind"], code, tuple(said["builtins"]))
        self._cache[job.key] = result
        if len(self._cache) > _CACHED:
            self._cache.popitem(last=False)
        self._ready.append((job.ticket, result))
        self._job = None

    def _fail(self, reason: str) -> None:
        """Give up the script at hand, and the worker with it."""
        if self._job is not None:
            self._ready.append((self._job.ticket, ScriptError(1, 1, reason)))
        self._job = None
        self._discard()


def _frame(content: bytes) -> bytes:
    return len(content).to_bytes(4, "big") + content


def _serve() -> None:
    """The worker: answer scripts until the input ends or the parent is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    parent = os.getppid()
    builtins: dict[str, bool] = json.loads(_receive(parent))
    while True:
        text = _receive(parent).decode("utf-8", "surrogatepass")
        used = resource.getrusage(resource.RUSAGE_SELF)
        allowed = int(used.ru_utime + used.ru_stime) + _CPU + 1
        resource.setrlimit(resource.RLIMIT_CPU, (allowed, resource.RLIM_INFINITY))
        answer = memoryview(_frame(_compiled(text, builtins)))
        while answer:
            answer = answer[os.write(1, answer) :]


def _compiled(text: str, builtins: Mapping[str, bool]) -> bytes:
    from drivers.ur3e.urscript.compiler import compile_script

    try:
        script = compile_script(text, builtins)
    except ScriptError as error:
        shown = error.text.encode("utf-8", "replace").decode()
        return json.dumps({"line": error.line, "column": error.column, "text": shown}).encode() + b"\n"
    head = {"name": script.name, "kind": script.kind, "builtins": script.builtins}
    return json.dumps(head).encode() + b"\n" + script.code


def _receive(parent: int) -> bytes:
    length = int.from_bytes(_exactly(4, parent), "big")
    return _exactly(length, parent)


def _exactly(count: int, parent: int) -> bytes:
    content = bytearray()
    while len(content) < count:
        ready, _, _ = select.select([0], [], [], _ORPHAN_CHECK)
        if os.getppid() != parent:
            sys.exit()
        if ready:
            piece = os.read(0, min(_PIECE, count - len(content)))
            if not piece:
                sys.exit()
            content += piece
    return bytes(content)


if __name__ == "__main__":
    _serve()
