"""A small robot for URScript programs: it says what they say, and notes what they move."""

import textwrap
from collections.abc import Generator

import pytest

from drivers.ur3e.urscript.builtin import Builtin
from drivers.ur3e.urscript.compiler import compile_script
from drivers.ur3e.urscript.errors import BuiltinError, Halt, ScriptError
from drivers.ur3e.urscript.program import Limits, Program
from drivers.ur3e.urscript.pure_builtins import pure_builtins
from drivers.ur3e.urscript.values import Value, written


class Bench:
    """A program with what it said and what its builtins saw."""

    def __init__(self, text: str, seed: int = 1, limits: Limits | None = None) -> None:
        self.said: list[Value] = []
        self.moves: list[str] = []
        self.internal = [1.0, 2.0, 3.0]
        builtins = pure_builtins(seed) | {
            "say": Builtin(self._say),
            "textmsg": Builtin(lambda s1, s2="": self.said.append(written(s1) + written(s2))),
            "sync": Builtin(self._wait, timed=True),
            "wait": Builtin(self._wait, timed=True),
            "move": Builtin(self._move, timed=True),
            "joints": Builtin(lambda: self.internal),
            "refuse": Builtin(self._refuse),
            "leave": Builtin(self._leave),
        }
        self.script = compile_script(textwrap.dedent(text), {name: b.timed for name, b in builtins.items()})
        self.program = Program(self.script, builtins, limits)

    def _say(self, value: Value) -> None:
        self.said.append(value)

    def _wait(self, cycles: int = 1) -> Generator[None, None, int]:
        for _ in range(cycles):
            yield
        return cycles

    def _move(self, target: Value, speed: float = 1.0) -> Generator[None, None, None]:
        self.moves.append(f"to {written(target)} at {written(speed)}")
        try:
            yield
            yield
        finally:
            self.moves.append("stopped")

    def _refuse(self, what: str) -> None:
        raise BuiltinError(f"no {what} here")

    def _leave(self) -> None:
        raise Halt

    def run(self, cycles: int = 1000) -> list[Value]:
        """Tick until the program ends."""
        for _ in range(cycles):
            if not self.program.tick():
                return self.said
        raise AssertionError(f"still running after {cycles} cycles")


def run(text: str) -> list[Value]:
    return Bench(text).run()


def value(expression: str) -> Value:
    return run(f"say({expression})")[0]


def failure(text: str) -> ScriptError:
    """What a script is told, when compiled or when run."""
    with pytest.raises(ScriptError) as caught:
        run(text)
    return caught.value
