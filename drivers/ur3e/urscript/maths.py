"""Builtins on numbers."""

from __future__ import annotations

import math
import random
from collections.abc import Callable

from drivers.ur3e.urscript.builtin import Builtin
from drivers.ur3e.urscript.errors import BuiltinError
from drivers.ur3e.urscript.values import NUMBERS, Number, Value, kind, number


def real(value: Value) -> float:
    """A number as a float."""
    if type(value) not in NUMBERS:
        raise BuiltinError(f"a number is needed, not a {kind(value)}")
    return float(value)


def whole(value: Value) -> int:
    """A whole number, even one that is written with a decimal point."""
    if type(value) is float and value.is_integer():
        return int(value)
    if type(value) is not int:
        raise BuiltinError(f"a whole number is needed, not a {kind(value) if type(value) is not float else value}")
    return value


def _within(value: Value, lowest: float, highest: float) -> float:
    if not lowest <= real(value) <= highest:
        raise BuiltinError(f"{value} is outside of {lowest:g} to {highest:g}")
    return real(value)


def _acos(f: Value) -> float:
    return math.acos(_within(f, -1, 1))


def _asin(f: Value) -> float:
    return math.asin(_within(f, -1, 1))


def _atan(f: Value) -> float:
    return math.atan(real(f))


def _atan2(x: Value, y: Value) -> float:
    return math.atan2(real(x), real(y))


def _ceil(f: Value) -> int:
    return math.ceil(real(f))


def _cos(f: Value) -> float:
    return math.cos(real(f))


def _d2r(d: Value) -> float:
    return math.radians(real(d))


def _floor(f: Value) -> int:
    return math.floor(real(f))


def _log(b: Value, f: Value) -> float:
    if real(b) <= 0 or real(b) == 1 or real(f) <= 0:
        raise BuiltinError(f"there is no logarithm of {f} to the base {b}")
    return math.log(real(f)) / math.log(real(b))


def _pow(base: Value, exponent: Value) -> Number:
    b, e = real(base), real(exponent)
    if (b < 0 and not e.is_integer()) or (b == 0 and e < 0):
        raise BuiltinError(f"{base} has no power {exponent}")
    try:
        return number(math.pow(b, e))
    except OverflowError:
        raise BuiltinError("the result is not a finite number") from None


def _r2d(r: Value) -> float:
    return math.degrees(real(r))


def _sin(f: Value) -> float:
    return math.sin(real(f))


def _sqrt(f: Value) -> float:
    return math.sqrt(_within(f, 0, math.inf))


def _tan(f: Value) -> float:
    return math.tan(real(f))


def _random(seed: int) -> Callable[[], float]:
    generator = random.Random(seed)

    def draw() -> float:
        return generator.random()

    return draw


def maths(seed: int) -> dict[str, Builtin]:
    """The builtins by name; `random` gives the same numbers for the same seed."""
    functions: dict[str, Callable[..., Value]] = {
        "acos": _acos,
        "asin": _asin,
        "atan": _atan,
        "atan2": _atan2,
        "ceil": _ceil,
        "cos": _cos,
        "d2r": _d2r,
        "floor": _floor,
        "log": _log,
        "pow": _pow,
        "r2d": _r2d,
        "random": _random(seed),
        "sin": _sin,
        "sqrt": _sqrt,
        "tan": _tan,
    }
    return {name: Builtin(call) for name, call in functions.items()}
