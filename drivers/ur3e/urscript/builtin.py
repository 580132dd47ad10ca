"""A builtin: what scripts can call that no script defines."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import Any

from drivers.ur3e.urscript.errors import BuiltinError
from drivers.ur3e.urscript.operators import Meter
from drivers.ur3e.urscript.values import Value, adopt, size
from runtime.errors import PalpateError


@dataclass(frozen=True)
class Builtin:
    """A function for scripts. Its arguments are the caller's copies, and are named as its Python parameters are.

    It raises BuiltinError, or any other PalpateError, for what it cannot do; Halt ends the program.
    """

    call: Callable[..., Any]
    timed: bool = False  # a generator function, in which each bare `yield` is one control cycle
    cost: int = 1  # [steps] that a call is charged; a step is some 0.25 us


def guarded(name: str, builtin: Builtin, meter: Meter) -> Callable[..., Any]:
    """What a script calls: the builtin, charged, with errors that name it and a result that is a URScript value."""
    call, cost = builtin.call, builtin.cost

    def instant(*arguments: Value, **named: Value) -> Value:
        meter.steps -= cost
        for argument in arguments:
            if type(argument) is str:
                meter.steps -= len(argument) >> 6
        try:
            return _result(call(*arguments, **named), meter)
        except Exception as error:
            raise _explained(name, call, arguments, named, error) from error

    def timed(*arguments: Value, **named: Value) -> Generator[None, None, Value]:
        meter.steps -= cost
        try:
            return _result((yield from call(*arguments, **named)), meter)
        except Exception as error:
            raise _explained(name, call, arguments, named, error) from error

    return timed if builtin.timed else instant


def _result(value: Any, meter: Meter) -> Value:
    kept = adopt(value)
    if type(kept) in (str, list):
        meter.charge(size(kept))
    return kept


def _explained(
    name: str, call: Callable[..., Any], arguments: tuple[Value, ...], named: dict[str, Value], error: Exception
) -> BuiltinError:
    if isinstance(error, PalpateError):
        return BuiltinError(f"{name}: {error}")
    if isinstance(error, TypeError):
        try:
            inspect.signature(call).bind(*arguments, **named)
        except TypeError as mismatch:
            return BuiltinError(f"{name}: {mismatch}")
    return BuiltinError(f"{name}: {type(error).__name__}: {error}")
