"""The values of URScript, and how they are measured, copied and written.

Numbers are Python's float and int (32 bits), truth values bool, strings str, lists and matrices list, poses Pose,
structs Struct; a function without a result gives None. Values are never shared: who keeps one copies it. A list keeps
its length and the kind of its elements.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, TypeAlias

from drivers.ur3e.urscript.errors import BuiltinError

Value: TypeAlias = Any  # int | float | bool | str | list | Pose | Struct | None, checked where it is used
Number: TypeAlias = int | float

LONGEST_LIST = 5000  # [values], those of rows and members included
LONGEST_STRING = 65535  # [characters]
LARGEST_INTEGER = 2**31 - 1
DEEPEST = 4  # values inside each other


class Pose(list[float]):
    """p[x, y, z, rx, ry, rz]: position [m] and rotation vector [rad]."""


class Struct(dict[str, Value]):
    """struct(name=value, ...)."""


_KINDS: dict[type, str] = {
    int: "number",
    float: "number",
    bool: "truth value",
    str: "string",
    list: "list",
    Pose: "pose",
    Struct: "struct",
    type(None): "nothing",
}
NUMBERS = frozenset({int, float})
SCALARS = frozenset({int, float, bool, str, type(None)})


def kind(value: Value) -> str:
    """What a value is called in messages; values of one kind can stand for each other."""
    return _KINDS[type(value)]


def number(value: Number) -> Number:
    """The result of a calculation, if it can be represented."""
    if type(value) is int:
        if -LARGEST_INTEGER - 1 <= value <= LARGEST_INTEGER:
            return value
        raise BuiltinError(f"{value} is not an integer of 32 bits")
    if type(value) is float:
        if math.isfinite(value):
            return value
        raise BuiltinError("the result is not a finite number")
    raise BuiltinError(f"a number is needed, not a {kind(value)}")


def pose(values: Iterable[Value]) -> Pose:
    """A pose of six numbers."""
    result = Pose(float(number(value)) for value in values)
    if len(result) != 6:
        raise BuiltinError(f"a pose has six values, not {len(result)}")
    return result


def size(value: Value, depth: int = 1) -> int:
    """How many values something holds, itself included; long strings count for several."""
    held = type(value)
    if held in SCALARS:
        return 1 + (len(value) >> 5) if held is str else 1
    if depth > DEEPEST:
        raise BuiltinError(f"values are more than {DEEPEST} deep inside each other")
    if held is Struct:
        return 1 + sum(size(member, depth + 1) for member in value.values())
    if held is Pose or not value or type(value[0]) in NUMBERS:
        return 1 + len(value)
    return 1 + sum(size(element, depth + 1) for element in value)


def limited(value: Value) -> Value:
    """A new list or struct, if it is not too large."""
    held = size(value)
    if held > LONGEST_LIST:
        raise BuiltinError(f"this {kind(value)} holds {held} values; the limit is {LONGEST_LIST}")
    return value


def uniform(elements: list[Value]) -> list[Value]:
    """A new list, if its elements are of one kind, no deeper than the rows of a matrix, and not too many."""
    if not elements:
        return elements
    first = kind(elements[0])
    for element in elements:
        if kind(element) != first:
            raise BuiltinError(f"a list cannot hold both a {first} and a {kind(element)}")
    if first == "nothing":
        raise BuiltinError("a list cannot hold the result of a function that returns nothing")
    if first == "list":
        if any(type(value) is list for row in elements for value in row):
            raise BuiltinError("lists can be no deeper than a matrix")
        if any(len(row) != len(elements[0]) for row in elements):
            raise BuiltinError("the rows of a matrix must be equally long")
    limited(elements)
    return elements


def duplicate(value: Value) -> Value:
    """A value that shares nothing with this one."""
    held = type(value)
    if held in SCALARS:
        return value
    if held is Pose:
        return Pose(value)
    if held is Struct:
        return Struct({name: duplicate(member) for name, member in value.items()})
    if value and type(value[0]) not in SCALARS:
        return [duplicate(element) for element in value]
    return value[:]


def adopt(value: Any, depth: int = 1) -> Value:
    """A URScript value of what a builtin returned. Raises BuiltinError for what has no counterpart."""
    held = type(value)
    if held in NUMBERS:
        return number(value)
    if held is bool or value is None:
        return value
    if held is str:
        if len(value) > LONGEST_STRING:
            raise BuiltinError(f"a string of {len(value)} characters; the limit is {LONGEST_STRING}")
        return value
    if depth > DEEPEST:
        raise BuiltinError(f"values are more than {DEEPEST} deep inside each other")
    if isinstance(value, Pose):
        return pose(value)
    if isinstance(value, list | tuple):
        if len(value) > LONGEST_LIST:
            raise BuiltinError(f"this list holds {len(value)} values; the limit is {LONGEST_LIST}")
        return uniform([adopt(element, depth + 1) for element in value])
    if isinstance(value, dict):
        return limited(Struct({str(name): adopt(member, depth + 1) for name, member in value.items()}))
    raise BuiltinError(f"URScript has no value for a Python {held.__name__}")


def written(value: Value) -> str:
    """A value as `to_str` and `textmsg` write it: at most six decimals, no trailing zeros."""
    held = type(value)
    if held is str:
        return str(value)
    if held is float:
        digits = f"{value:.6f}".rstrip("0").rstrip(".")
        return "0" if digits == "-0" else digits
    if held in SCALARS:
        return str(value)
    if held is Struct:
        return "struct(" + ", ".join(f"{name}={written(member)}" for name, member in value.items()) + ")"
    return ("p[" if held is Pose else "[") + ", ".join(written(element) for element in value) + "]"
