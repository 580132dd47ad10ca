"""A part of a measurement in a process of its own, asked through a pipe.

The process ends when the pipe does, whatever it is doing: nothing is left of a measurement that was broken off.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import queue
import signal
import threading
from collections.abc import Callable, Iterator
from multiprocessing import forkserver
from multiprocessing.connection import Connection
from multiprocessing.context import ForkServerContext
from typing import Any, Protocol

from runtime.closing import Closing
from runtime.errors import InputError, PalpateError, SessionError

PATIENCE = 120.0  # [s] for an answer
_FAREWELL = 3.0  # [s] for a process to end by itself


class Part(Protocol):
    """What runs in a process: its public methods can be asked for."""

    def close(self) -> None:
        """Let go of everything held."""
        ...


class Station(Closing):
    """The process of one part, made there by `make(*arguments)`. Both have to be importable or picklable."""

    def __init__(self, name: str, make: Callable[..., Part], *arguments: Any) -> None:
        self.name = name
        context = _context()
        self._pipe, other = context.Pipe()
        self._process = context.Process(target=_serve, args=(other, make, arguments), daemon=True)
        self._process.start()
        other.close()

    def start(self, method: str, *arguments: Any) -> None:
        """Let the part do something."""
        try:
            self._pipe.send((method, arguments))
        except OSError:
            raise SessionError(f"{self.name}: its process has ended") from None

    def answer(self, patience: float = PATIENCE) -> Any:
        """What came of it, or of making the part. Raises what it failed with, or SessionError after `patience`."""
        try:
            if not self._pipe.poll(patience):
                raise SessionError(f"{self.name} gave no answer within {patience:g} s")
            done, result = self._pipe.recv()
        except (EOFError, OSError):
            raise SessionError(f"{self.name}: its process ended with exit code {self._exit_code()}") from None
        if not done:
            wrong_input, text = result
            raise InputError(text) if wrong_input else SessionError(f"{self.name}: {text}")
        return result

    def ask(self, method: str, *arguments: Any) -> Any:
        """Let the part do something and wait for what comes of it."""
        self.start(method, *arguments)
        return self.answer()

    def dismiss(self) -> None:
        """Let the process end, without waiting for it."""
        self._pipe.close()

    def close(self) -> None:
        """End the process. Idempotent."""
        self.dismiss()
        self._process.join(_FAREWELL)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()

    def _exit_code(self) -> int | None:
        self._process.join(1.0)
        return self._process.exitcode


@contextlib.contextmanager
def stations() -> Iterator[list[Station]]:
    """A list for stations, all of which end with the block: the later ones first, as they depend on the earlier."""
    begun: list[Station] = []
    try:
        yield begun
    finally:
        for station in reversed(begun[1:]):
            station.dismiss()
        for station in reversed(begun):
            station.close()


def _context() -> ForkServerContext:
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["runtime.benchmark.preload"])
    # Ctrl-C is for the process that measures: the others are born deaf to it.
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        forkserver.ensure_running()
    finally:
        signal.signal(signal.SIGINT, before)
    return context


def _serve(pipe: Connection, make: Callable[..., Part], arguments: tuple[Any, ...]) -> None:
    tasks: queue.SimpleQueue[tuple[str, tuple[Any, ...]] | None] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(pipe, tasks), daemon=True).start()
    with contextlib.suppress(BrokenPipeError):  # whoever asked has gone
        try:
            part = make(*arguments)
        except Exception as error:
            pipe.send((False, _explained(error)))
            return
        try:
            pipe.send((True, None))
            while (task := tasks.get()) is not None:
                pipe.send(_outcome(part, *task))
        finally:
            part.close()


def _outcome(part: Part, method: str, values: tuple[Any, ...]) -> tuple[bool, Any]:
    try:
        return True, getattr(part, method)(*values)
    except Exception as error:
        return False, _explained(error)


def _explained(error: Exception) -> tuple[bool, str]:
    """Whether the user's input was wrong, and what to say. Contenders stand on libraries with errors of their own."""
    text = str(error) if isinstance(error, PalpateError) else f"{type(error).__name__}: {error}"
    return isinstance(error, InputError), text


def _listen(pipe: Connection, tasks: queue.SimpleQueue[tuple[str, tuple[Any, ...]] | None]) -> None:
    try:
        while True:
            tasks.put(pipe.recv())
    except (EOFError, OSError):
        tasks.put(None)
        threading.main_thread().join(_FAREWELL / 2)
        os._exit(1)  # what it does would keep it for ever
