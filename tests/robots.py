"""A simulated controller in a process of its own, for tests that connect real clients to it and look inside.

ur-rtde's constructors hold Python's global lock while they talk, so client and controller cannot share a process.
"""

from __future__ import annotations

import itertools
import multiprocessing
import os
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from types import TracebackType
from typing import Any, Self, TypeVar

from drivers.ur3e.control_box.box import ControlBox

Result = TypeVar("Result")

PATIENCE = 30.0  # [s] for anything to become true
_PROCESSES = itertools.count(1)


def loopback() -> str:
    """An address on loopback that no other test uses: clients have UR's port numbers built in."""
    number = os.getpid() * 16 + next(_PROCESSES) % 16
    return f"127.{1 + number // 62500 % 250}.{1 + number // 250 % 250}.{1 + number % 250}"


def _serve(link: Connection, scene: str, version: str, seed: int, host: str, folder: str) -> None:
    from pathlib import Path

    from drivers.ur3e.control_box.server import RobotServer
    from drivers.ur3e.control_box.simulation import simulated_box
    from drivers.ur3e.control_box.version import polyscope
    from drivers.ur3e.driver import MujocoUr3e
    from runtime import config

    lines: list[str] = []
    cell = config.load("igbt" if scene == "empty" else scene, {"seed": seed}).cell
    box = simulated_box(
        MujocoUr3e().setup(),
        cell,
        version=polyscope(version),
        empty=scene == "empty",
        log=lines.append,
        programs_folder=Path(folder) if folder else None,
    )

    def answer() -> None:
        """Between two control cycles: what a test wants to know, or to happen."""
        if not link.poll(0):
            return
        function, arguments = link.recv()
        if function is None:
            server.stop()
        elif function == "lines":
            link.send((True, list(lines)))
        elif function == "beat":
            link.send((True, server.beat))
        else:
            try:
                link.send((True, function(box, *arguments)))
            except Exception as error:
                link.send((False, error))

    server = RobotServer(box, host, after_cycle=answer)
    link.send((True, server.numbers))
    server.run()
    link.send((True, None))


class Robot:
    """A running controller. `look` calls a function of a test's module with the box, between two control cycles."""

    def __init__(self, scene: str = "igbt", version: str = "5.22", seed: int = 1, folder: str = "") -> None:
        self.host = loopback()
        context = multiprocessing.get_context("spawn")
        self._link, other = context.Pipe()
        self._process = context.Process(target=_serve, args=(other, scene, version, seed, self.host, folder))

    def __enter__(self) -> Self:
        self._process.start()
        self._answer()
        return self

    def _answer(self) -> Any:
        deadline = time.monotonic() + PATIENCE
        while not self._link.poll(0.2):
            assert self._process.is_alive(), "the controller has ended"
            assert time.monotonic() < deadline
        fine, value = self._link.recv()
        if not fine:
            raise value
        return value

    def look(self, function: Callable[..., Result], *arguments: object) -> Result:
        """What a function of (box, *arguments) says; both must be picklable."""
        self._link.send((function, arguments))
        result: Result = self._answer()
        return result

    def until(self, function: Callable[..., Result], *arguments: object, patience: float = PATIENCE) -> Result:
        """The first answer that is true."""
        deadline = time.monotonic() + patience
        while not (found := self.look(function, *arguments)):
            assert time.monotonic() < deadline, f"{function.__name__}{arguments} did not become true"
        return found

    @property
    def lines(self) -> list[str]:
        """What the box has logged."""
        self._link.send(("lines", ()))
        found: list[str] = self._answer()
        return found

    @property
    def beat(self) -> Any:
        """How the control loop keeps its time."""
        self._link.send(("beat", ()))
        return self._answer()

    def kill(self) -> None:
        """End the controller without a word, as a power cut does."""
        self._process.kill()
        self._process.join()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._process.is_alive():
            self._link.send((None, ()))
            self._process.join(PATIENCE)
        if self._process.is_alive():
            self._process.kill()
        self._link.close()


def power(box: ControlBox) -> str:
    """Robot mode, safety mode and runtime state in words."""
    return f"{box.robot_mode.name} {box.safety_mode.name} {box.runtime_state.name}"
