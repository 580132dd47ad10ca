"""A running script: its threads, one control cycle at a time, within limits that no script can exceed.

Threads take turns in the order in which they began; each runs until it waits for the next cycle. A thread that does not
wait is preempted when the steps of the cycle are used up, and ends the program if it goes on so for long.
"""

from __future__ import annotations

import gc
import marshal
from collections.abc import Generator, Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from types import CodeType, FunctionType, GeneratorType, TracebackType
from typing import Any

from drivers.ur3e.urscript.builtin import Builtin, guarded
from drivers.ur3e.urscript.errors import BuiltinError, Halt, ScriptError
from drivers.ur3e.urscript.operators import Meter, Operators
from drivers.ur3e.urscript.script import FILE, MAIN, Script
from drivers.ur3e.urscript.values import Pose, Struct, Value, size
from runtime.errors import PalpateError, alternatives

_FEWEST_STEPS = 16  # that a thread gets in any cycle
_COUNT_AGAIN = 500_000  # [values] made, after which those that are still held are counted
_HELD = (list, Pose, Struct, str)


@dataclass(frozen=True)
class Limits:
    """What a program may use."""

    steps: int = 4000  # in one control cycle, by all its threads together
    patience: int = 250  # [cycles] in a row in which a thread may be preempted
    threads: int = 50
    depth: int = 64  # calls inside each other
    values: int = 1_000_000  # held in variables and unfinished expressions


@dataclass
class _Thread:
    number: int
    run: Generator[object, None, object]
    preempted: int = 0  # [cycles] in a row
    ended: bool = False


class _ThreadEnds(BaseException):
    """A thread has killed itself."""


class Program:
    """A script with the builtins it runs on."""

    def __init__(self, script: Script, builtins: Mapping[str, Builtin], limits: Limits | None = None) -> None:
        self.name, self.kind = script.name, script.kind
        self.current = 1  # number of the thread that runs now, or ran last; the program's own is 1
        self.wants_pause = False  # a `pause` has been reached; whoever ticks the program may clear it
        self._limits = limits or Limits()
        self._meter = Meter()
        self._globals = self._namespace(script, builtins)
        main = next(name for name in self._globals if name.startswith(MAIN))
        self._threads = [_Thread(1, self._globals[main](1))]
        self._last = 1
        self._debt = 0  # [steps] used beyond those of the last cycle

    @property
    def threads(self) -> int:
        """How many threads run, the program's own included; 0 once it has ended."""
        return len(self._threads)

    @property
    def line(self) -> int:
        """Line, from 1, in which the program's own thread waits; 0 once it has ended."""
        line = 0
        run: Any = self._threads[0].run if self._threads else None
        while isinstance(run, GeneratorType) and run.gi_code.co_filename == FILE and run.gi_frame is not None:
            line = run.gi_frame.f_lineno
            run = run.gi_yieldfrom
        return line

    def tick(self) -> bool:
        """Run every thread until it waits. False once the program has ended; its other threads then end too.

        Raises ScriptError if the script errs, which ends it.
        """
        try:
            self._cycle()
        except Halt:
            self.stop()
        except Exception as error:
            explained = self._explained(error)
            self._close()
            raise explained from error
        return bool(self._threads)

    def stop(self) -> None:
        """End every thread, and what its builtins have begun. Idempotent."""
        failure = self._close()
        if failure is not None:
            raise self._explained(failure) from failure

    def _cycle(self) -> None:
        limits, meter, threads = self._limits, self._meter, self._threads
        left = limits.steps - self._debt
        index = 0
        while index < len(threads):
            thread = threads[index]
            index += 1
            if thread.ended:
                continue
            self.current = thread.number
            granted = meter.steps = max(left // (len(threads) - index + 1), _FEWEST_STEPS)
            self._advance(thread)
            left -= granted - meter.steps
            if threads[0].ended:
                self.stop()
                return
        self._debt = max(0, -left)
        if any(thread.ended for thread in threads):
            self._threads[:] = [thread for thread in threads if not thread.ended]
        if meter.made > _COUNT_AGAIN:
            self._count()

    def _advance(self, thread: _Thread) -> None:
        try:
            preempted = thread.run.send(None)
        except (StopIteration, _ThreadEnds):
            thread.ended = True
            return
        if not preempted:
            thread.preempted = 0
            return
        thread.preempted += 1
        if thread.preempted >= self._limits.patience:
            cycles = f"{thread.preempted} control cycles"
            raise _infinite(thread.run, f"infinite loop: the thread ran for {cycles} without waiting; sync() waits")

    def _close(self) -> Exception | None:
        """Close all threads; the first error on the way, if any."""
        failure: Exception | None = None
        threads, self._threads = self._threads, []
        for thread in threads:
            thread.ended = True
            try:
                thread.run.close()
            except Exception as error:
                failure = failure or error
        return failure

    def _count(self) -> None:
        """Count the values that are held. Raises BuiltinError if they are too many."""
        self._meter.made = 0
        seen: set[int] = set()
        held = 0
        for value in self._held():
            if id(value) not in seen:
                seen.add(id(value))
                held += size(value)
        if held > self._limits.values:
            raise BuiltinError(f"the program holds {held} values; the limit is {self._limits.values}")

    def _held(self) -> Iterator[Value]:
        for name, value in self._globals.items():
            if name.startswith("g_") and type(value) in _HELD:
                yield value
        for thread in self._threads:
            run: Any = thread.run
            while isinstance(run, GeneratorType) and run.gi_code.co_filename == FILE:
                yield from (value for value in gc.get_referents(run) if type(value) in _HELD)
                run = run.gi_yieldfrom

    def _namespace(self, script: Script, builtins: Mapping[str, Builtin]) -> dict[str, Any]:
        """All that the script's code can name."""
        operators = Operators(self._meter)
        names: dict[str, Any] = {
            "__builtins__": {},
            "_meter": self._meter,
            "_deepest": self._limits.depth,
            "_too_deep": self._too_deep,
            "_run": self._run,
            "_kill": self._kill,
            "_join": self._join,
            "_halt": _halt,
            "_pause": self._pause,
            "_add": operators.add,
            "_subtract": operators.subtract,
            "_multiply": operators.multiply,
            "_divide": operators.divide,
            "_modulo": operators.modulo,
            "_negative": operators.negative,
            "_positive": operators.positive,
            "_eq": operators.equal,
            "_ne": operators.unequal,
            "_lt": operators.less,
            "_le": operators.less_equal,
            "_gt": operators.greater,
            "_ge": operators.greater_equal,
            "_truth": operators.truth,
            "_copy": operators.copy,
            "_list": operators.array,
            "_pose": operators.pose,
            "_struct": operators.struct,
            "_item": operators.item,
            "_cell": operators.cell,
            "_member": operators.member,
            "_set_item": operators.set_item,
            "_set_cell": operators.set_cell,
            "_set_member": operators.set_member,
        }
        for name in script.builtins:
            if name not in builtins:
                raise ScriptError(1, 1, f"there is no builtin {name!r}; {alternatives(name, builtins)}")
            names[f"b_{name}"] = guarded(name, builtins[name], self._meter)
        module = marshal.loads(script.code)
        for code in module.co_consts:
            if isinstance(code, CodeType):
                names[code.co_name] = FunctionType(code, names, code.co_name)
        return names

    def _run(self, run: Generator[object, None, object]) -> int:
        if len(self._threads) >= self._limits.threads:
            raise BuiltinError(f"more than {self._limits.threads} threads")
        self._last += 1
        self._threads.append(_Thread(self._last, run))
        return self._last

    def _kill(self, number: Value) -> None:
        thread = self._find(number)
        if thread is None:
            return
        thread.ended = True
        if number == self.current:
            raise _ThreadEnds
        thread.run.close()

    def _join(self, number: Value) -> Generator[None, None, None]:
        while (thread := self._find(number)) is not None and not thread.ended:
            yield

    def _find(self, number: Value) -> _Thread | None:
        if type(number) is not int:
            raise BuiltinError("a thread is named by the number that `run` gave")
        return next((thread for thread in self._threads if thread.number == number and not thread.ended), None)

    def _pause(self) -> None:
        self.wants_pause = True

    def _too_deep(self) -> None:
        raise BuiltinError(f"calls more than {self._limits.depth} deep in each other")

    def _explained(self, error: Exception) -> ScriptError:
        """Where in the script an error arose, and what it means there."""
        if isinstance(error, ScriptError):
            return error
        line, column = _place(error.__traceback__)
        return ScriptError(line, column, _meaning(error))


def _halt() -> None:
    raise Halt


def _infinite(run: object, text: str) -> ScriptError:
    """An error at the statement at which a thread was preempted."""
    line = 1
    while isinstance(run, GeneratorType) and run.gi_frame is not None and run.gi_code.co_filename == FILE:
        line = run.gi_frame.f_lineno
        run = run.gi_yieldfrom
    return ScriptError(line, 1, text)


def _place(trace: TracebackType | None) -> tuple[int, int]:
    """Line and column of the innermost frame of the script, 1 and 1 if there is none."""
    line, column = 1, 1
    while trace is not None:
        code = trace.tb_frame.f_code
        if code.co_filename == FILE:
            position = next(islice(code.co_positions(), trace.tb_lasti // 2, None), (None,) * 4)
            line, column = trace.tb_lineno, (position[2] or 0) + 1
        trace = trace.tb_next
    return line, column


def _meaning(error: Exception) -> str:
    if isinstance(error, NameError):
        mangled = str(error).split("'")[1]
        return f"the variable {mangled[2:]!r} has no value"
    if isinstance(error, PalpateError):
        return str(error)
    return f"{type(error).__name__}: {error}"
