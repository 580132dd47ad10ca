"""What URScript's operators, indices and assignments do, charged by the size of what they touch.

Arrays combine element by element, with each other or with a number; a matrix multiplies a matrix or an array; poses add
and subtract element by element and scale with a number.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from operator import mul

from drivers.ur3e.urscript.errors import BuiltinError
from drivers.ur3e.urscript.values import (
    LONGEST_LIST,
    NUMBERS,
    SCALARS,
    Number,
    Pose,
    Struct,
    Value,
    duplicate,
    kind,
    limited,
    number,
    size,
    uniform,
)

_LARGEST_PRODUCT = 20_000  # multiplications of one matrix product
_MEASURED = 16  # [elements] below which the size of a list is not worth measuring


class Meter:
    """What a program has used: steps it may still take now, and values made since they were last counted."""

    __slots__ = ("made", "steps")

    def __init__(self) -> None:
        self.steps = 0
        self.made = 0

    def charge(self, values: int) -> None:
        """Making or reading this many values costs a quarter of a step each."""
        self.steps -= values >> 2
        self.made += values


class Operators:
    """The operations that compiled scripts call; one per program, since each has its own meter."""

    def __init__(self, meter: Meter) -> None:
        self._meter = meter

    def add(self, a: Value, b: Value) -> Value:
        """`a + b`."""
        return number(a + b) if type(a) in NUMBERS and type(b) in NUMBERS else self._combine("+", _add, a, b)

    def subtract(self, a: Value, b: Value) -> Value:
        """`a - b`."""
        return number(a - b) if type(a) in NUMBERS and type(b) in NUMBERS else self._combine("-", _subtract, a, b)

    def multiply(self, a: Value, b: Value) -> Value:
        """`a * b`."""
        if type(a) in NUMBERS and type(b) in NUMBERS:
            return number(a * b)
        if _is_matrix(a) and type(b) is list:
            return self._matrix_product(a, b)
        return self._combine("*", _multiply, a, b)

    def divide(self, a: Value, b: Value) -> Value:
        """`a / b`, never truncated."""
        return _divide(a, b) if type(a) in NUMBERS and type(b) in NUMBERS else self._combine("/", _divide, a, b)

    def modulo(self, a: Value, b: Value) -> Value:
        """`a % b`. Assumed: the sign of `a`, as in C."""
        return _modulo(a, b) if type(a) in NUMBERS and type(b) in NUMBERS else self._combine("%", _modulo, a, b)

    def negative(self, a: Value) -> Value:
        """`-a`."""
        return number(-a) if type(a) in NUMBERS else self._combine("*", _multiply, -1, a)

    def positive(self, a: Value) -> Value:
        """`+a`."""
        return a if type(a) in NUMBERS else self._combine("*", _multiply, 1, a)

    def equal(self, a: Value, b: Value) -> bool:
        """`a == b`; values of different kinds are not equal."""
        if type(a) is not type(b):
            return type(a) in NUMBERS and type(b) in NUMBERS and a == b
        if type(a) not in SCALARS:
            self._meter.charge(size(a))
        return bool(a == b)

    def unequal(self, a: Value, b: Value) -> bool:
        """`a != b`."""
        return not self.equal(a, b)

    def less(self, a: Value, b: Value) -> bool:
        """`a < b`."""
        return bool(a < b) if type(a) in NUMBERS and type(b) in NUMBERS else _cannot_order(a, b)

    def less_equal(self, a: Value, b: Value) -> bool:
        """`a <= b`."""
        return bool(a <= b) if type(a) in NUMBERS and type(b) in NUMBERS else _cannot_order(a, b)

    def greater(self, a: Value, b: Value) -> bool:
        """`a > b`."""
        return bool(a > b) if type(a) in NUMBERS and type(b) in NUMBERS else _cannot_order(a, b)

    def greater_equal(self, a: Value, b: Value) -> bool:
        """`a >= b`."""
        return bool(a >= b) if type(a) in NUMBERS and type(b) in NUMBERS else _cannot_order(a, b)

    def truth(self, a: Value) -> bool:
        """A condition, or an operand of `and`, `or`, `xor`, `not`."""
        if a is True or a is False:
            return a
        raise BuiltinError(f"True or False is needed here, not a {kind(a)}")

    def copy(self, a: Value) -> Value:
        """The value for one who keeps it."""
        if type(a) in SCALARS:
            return a
        self._meter.charge(size(a) if len(a) > _MEASURED or type(a) is Struct else len(a))
        return duplicate(a)

    def array(self, elements: list[Value]) -> list[Value]:
        """`[a, b, ...]` of values that belong to nobody else."""
        self._meter.charge(len(elements))
        return uniform(elements)

    def pose(self, *values: Value) -> Pose:
        """`p[x, y, z, rx, ry, rz]`."""
        return Pose(float(number(value)) for value in values)

    def struct(self, members: dict[str, Value]) -> Struct:
        """`struct(a=..., b=...)`."""
        self._meter.charge(len(members))
        return limited(Struct(members))  # type: ignore[no-any-return]

    def item(self, base: Value, key: Value) -> Value:
        """`base[key]`."""
        if type(key) is int and (type(base) is list or type(base) is Pose) and 0 <= key < len(base):
            return base[key]
        return base[_position(base, key)]

    def cell(self, base: Value, row: Value, column: Value) -> Value:
        """`base[row, column]`."""
        if not _is_matrix(base):
            raise BuiltinError(f"two indices need a matrix, not a {kind(base)}")
        return self.item(self.item(base, row), column)

    def member(self, base: Value, name: str) -> Value:
        """`base.name`."""
        _must_have(base, name)
        return base[name]

    def set_item(self, value: Value, key: Value, base: Value) -> None:
        """`base[key] = value`."""
        position = _position(base, key)
        if type(base) is Pose:
            base[position] = float(number(value))
            return
        self._put(value, base, position)

    def set_cell(self, value: Value, column: Value, row: Value, base: Value) -> None:
        """`base[row, column] = value`."""
        if not _is_matrix(base):
            raise BuiltinError(f"two indices need a matrix, not a {kind(base)}")
        self.set_item(value, column, self.item(base, row))

    def set_member(self, value: Value, base: Value, name: str) -> None:
        """`base.name = value`."""
        _must_have(base, name)
        self._put(value, base, name)

    def _put(self, value: Value, base: Value, key: int | str) -> None:
        _must_fit(base[key], value)
        if type(value) is str:
            self._meter.charge(size(value))
        base[key] = value

    def _combine(self, sign: str, operation: Callable[[Value, Value], Number], a: Value, b: Value) -> Value:
        lists = [value for value in (a, b) if type(value) in (list, Pose)]
        if not lists or not all(type(value) in (list, Pose, int, float) for value in (a, b)):
            hint = "; str_cat joins strings" if sign == "+" and str in (type(a), type(b)) else ""
            raise BuiltinError(f"{kind(a)} {sign} {kind(b)} is not possible{hint}")
        for value in lists:
            self._meter.charge(size(value) << 2)
        if type(a) is Pose or type(b) is Pose:
            if type(a) is type(b):
                if sign not in "+-":
                    raise BuiltinError(f"pose {sign} pose is not possible")
            elif len(lists) == 2 or sign not in "*/" or (sign == "/" and type(b) is Pose):
                raise BuiltinError(f"{kind(a)} {sign} {kind(b)} is not possible")
            return Pose(float(value) for value in _elementwise(sign, operation, a, b))
        if len(lists) == 2 and (_is_matrix(a) or _is_matrix(b)):
            raise BuiltinError(f"{_shape(a)} {sign} {_shape(b)} is not possible")
        return _elementwise(sign, operation, a, b)

    def _matrix_product(self, a: list[list[Number]], b: list[Value]) -> list[Value]:
        """Matrix times matrix or array."""
        if len(a[0]) != len(b):
            raise BuiltinError(f"{_shape(a)} * {_shape(b)} is not possible: the sizes do not match")
        columns = list(zip(*b, strict=True)) if _is_matrix(b) else [tuple(b)]
        work = len(a) * len(b) * len(columns)
        if work > _LARGEST_PRODUCT:
            raise BuiltinError(f"{_shape(a)} * {_shape(b)} is too large to be calculated within a control cycle")
        self._meter.charge(work)
        for row in (*a, *columns):
            for value in row:
                _numeric(value)
        rows = [[number(sum(map(mul, row, column))) for column in columns] for row in a]
        return limited(rows if _is_matrix(b) else [row[0] for row in rows])  # type: ignore[no-any-return]


def _add(a: Value, b: Value) -> Number:
    return number(_numeric(a) + _numeric(b))


def _subtract(a: Value, b: Value) -> Number:
    return number(_numeric(a) - _numeric(b))


def _multiply(a: Value, b: Value) -> Number:
    return number(_numeric(a) * _numeric(b))


def _divide(a: Value, b: Value) -> Number:
    if _numeric(b) == 0:
        raise BuiltinError("division by zero")
    return number(_numeric(a) / b)


def _modulo(a: Value, b: Value) -> Number:
    if _numeric(b) == 0:
        raise BuiltinError("modulo by zero")
    remainder = math.fmod(_numeric(a), b)
    return int(remainder) if type(a) is int and type(b) is int else remainder


def _numeric(a: Value) -> Number:
    if type(a) in NUMBERS:
        return a  # type: ignore[no-any-return]
    raise BuiltinError(f"a number is needed, not a {kind(a)}")


def _elementwise(sign: str, operation: Callable[[Value, Value], Number], a: Value, b: Value) -> list[Value]:
    if isinstance(a, list) and isinstance(b, list):
        if len(a) != len(b):
            raise BuiltinError(f"lists of {len(a)} and {len(b)} elements cannot be combined by {sign}")
        return [operation(x, y) for x, y in zip(a, b, strict=True)]
    if isinstance(a, list):
        return [_elementwise(sign, operation, x, b) if type(x) is list else operation(x, b) for x in a]
    return [_elementwise(sign, operation, a, y) if type(y) is list else operation(a, y) for y in b]


def _is_matrix(a: Value) -> bool:
    return type(a) is list and bool(a) and type(a[0]) is list


def _shape(a: Value) -> str:
    return f"matrix of {len(a)} by {len(a[0])}" if _is_matrix(a) else f"array of {len(a)}"


def _position(base: Value, key: Value) -> int:
    if type(base) is not list and type(base) is not Pose:
        raise BuiltinError(f"a {kind(base)} has no elements")
    if type(key) is float and key.is_integer():
        key = int(key)
    if type(key) is not int:
        raise BuiltinError(f"an index is a whole number, not a {kind(key) if type(key) is not float else key}")
    if not 0 <= key < len(base):
        raise BuiltinError(f"index {key} is outside of a {kind(base)} of {len(base)}")
    return key


def _must_have(base: Value, name: str) -> None:
    if type(base) is not Struct:
        raise BuiltinError(f"a {kind(base)} has no member {name!r}")
    if name not in base:
        raise BuiltinError(f"the struct has no member {name!r}; it has {', '.join(base)}")


def _must_fit(old: Value, new: Value) -> None:
    """What is inside a list or struct keeps its kind and length, so that nothing grows in place."""
    if kind(old) != kind(new):
        raise BuiltinError(f"a {kind(old)} cannot be replaced by a {kind(new)}")
    if type(old) is list or type(old) is Struct:
        if len(old) != len(new) or size(old) < size(new):
            raise BuiltinError(f"a {kind(old)} cannot be replaced by one of another size")
    elif type(new) is str and len(new) > LONGEST_LIST:
        raise BuiltinError(f"a string of {len(new)} characters cannot stand inside of another value")


def _cannot_order(a: Value, b: Value) -> bool:
    raise BuiltinError(f"a {kind(a)} and a {kind(b)} have no order")
