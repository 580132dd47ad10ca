"""Real control boxes without sockets, for tests of what speaks for them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from drivers.ur3e.control_box.box import ControlBox
from drivers.ur3e.control_box.simulation import simulated_box
from drivers.ur3e.control_box.version import polyscope
from drivers.ur3e.driver import MujocoUr3e
from runtime import config


@dataclass
class Ear:
    """A `Peer` that keeps what it is sent."""

    name: str = "127.0.0.1:1"
    heard: bytes = b""
    backlog: int = 0
    gone: bool = False

    def send(self, data: bytes) -> None:
        self.heard += data

    def close(self) -> None:
        self.gone = True

    def take(self) -> bytes:
        heard, self.heard = self.heard, b""
        return heard


@dataclass
class Boxed:
    """A control box and what it has logged."""

    box: ControlBox
    lines: list[str] = field(default_factory=list)

    def cycles(self, count: int) -> None:
        for _ in range(count):
            self.box.cycle()

    def run(self, text: str, limit: int = 50_000) -> None:
        """Run a program to its end."""
        self.start(text)
        self.until(lambda: self.box.programs.state.name == "STOPPED", limit)

    def start(self, text: str) -> None:
        """Run a program from its compilation on."""
        programs = self.box.programs
        programs.submit(text, "test")
        while programs.compiling:
            programs.advance()

    def until(self, ready: object, limit: int = 50_000) -> None:
        assert callable(ready)
        for _ in range(limit):
            if ready():
                return
            self.box.cycle()
        raise AssertionError("not within its cycles")


@contextmanager
def boxed(scene: str = "empty", version: str = "5.22") -> Iterator[Boxed]:
    lines: list[str] = []
    cell = config.load("igbt" if scene == "empty" else scene).cell
    box = simulated_box(
        MujocoUr3e().setup(), cell, version=polyscope(version), empty=scene == "empty", log=lines.append
    )
    try:
        yield Boxed(box, lines)
    finally:
        box.programs.close()
