"""Builtins on lists and matrices."""

from __future__ import annotations

import math

from drivers.ur3e.urscript.builtin import Builtin
from drivers.ur3e.urscript.errors import BuiltinError
from drivers.ur3e.urscript.maths import real, whole
from drivers.ur3e.urscript.poses import pose_inv
from drivers.ur3e.urscript.values import LONGEST_LIST, Number, Pose, Value, duplicate, kind, number

_BITS = 32
_LARGEST_INVERSE = 24  # rows; more take too long for a control cycle
_SINGULAR = 1e-12  # smallest pivot, of the largest element


def _list(value: Value) -> list[Value]:
    if type(value) is not list:
        raise BuiltinError(f"a list is needed, not a {kind(value)}")
    return value


def _is_matrix(value: Value) -> bool:
    return type(value) is list and bool(value) and type(value[0]) is list


def _binary_list_to_integer(l: Value) -> int:  # noqa: E741 (the parameter's name in URScript)
    bits = _list(l)[:_BITS]
    if any(type(bit) is not bool for bit in bits):
        raise BuiltinError("the list must hold True and False only")
    value: int = sum(bit << position for position, bit in enumerate(bits))
    return value - (1 << _BITS) if value >= 1 << (_BITS - 1) else value


def _integer_to_binary_list(x: Value) -> list[bool]:
    value = whole(x)
    return [bool(value >> position & 1) for position in range(_BITS)]


def _get_list_length(v: Value) -> int:
    values: list[Value] = v if type(v) is Pose else _list(v)
    return len(values)


def _length(v: Value) -> int:
    return len(v.encode("utf-8", "surrogateescape")) if type(v) is str else _get_list_length(v)


def _size(v: Value) -> int | list[int]:
    return [len(v), len(v[0])] if _is_matrix(v) else _length(v)


def _make_list(length: Value, initial_value: Value, capacity: Value = None) -> list[Value]:
    count, most = whole(length), whole(length if capacity is None else capacity)
    if not 0 <= count <= min(most, LONGEST_LIST):
        raise BuiltinError(f"a list of {count} values cannot be made; the limit is {min(most, LONGEST_LIST)}")
    if type(initial_value) is list:
        raise BuiltinError("a list of lists cannot be made")
    return [duplicate(initial_value) for _ in range(count)]


def _norm(a: Value) -> Number:
    if type(a) is list or type(a) is Pose:
        return math.hypot(*(real(value) for value in a))
    real(a)
    return number(abs(a))


def _normalize(v: Value) -> list[float]:
    length = math.hypot(*(real(value) for value in _list(v)))
    if length == 0:
        raise BuiltinError("a vector of length zero has no direction")
    return [real(value) / length for value in v]


def _transpose(m: Value) -> list[Value]:
    if not _is_matrix(m):
        return [[value] for value in _list(m)]
    return [row[0] for row in m] if len(m[0]) == 1 else [list(column) for column in zip(*m, strict=True)]


def _inv(m: Value) -> Value:
    return pose_inv(m) if type(m) is Pose else _inverse(m)


def _inverse(m: Value) -> list[list[float]]:
    """Gauss and Jordan's elimination, the largest pivot of each column first."""
    if not _is_matrix(m) or len(m) != len(m[0]):
        raise BuiltinError("only a pose or a square matrix has an inverse")
    n = len(m)
    if n > _LARGEST_INVERSE:
        raise BuiltinError(f"a matrix of {n} rows is too large to be inverted within a control cycle")
    rows = [[real(value) for value in row] + [float(i == j) for j in range(n)] for i, row in enumerate(m)]
    scale = max(abs(value) for row in rows for value in row[:n])
    for column in range(n):
        pivot = max(range(column, n), key=lambda row: abs(rows[row][column]))
        rows[column], rows[pivot] = rows[pivot], rows[column]
        divisor = rows[column][column]
        if abs(divisor) <= _SINGULAR * scale:
            raise BuiltinError("the matrix is singular")
        rows[column] = [value / divisor for value in rows[column]]
        for row in range(n):
            factor = rows[row][column]
            if row != column and factor:
                rows[row] = [a - factor * b for a, b in zip(rows[row], rows[column], strict=True)]
    return [row[n:] for row in rows]


def lists() -> dict[str, Builtin]:
    """The builtins by name."""
    return {
        "binary_list_to_integer": Builtin(_binary_list_to_integer, cost=16),
        "get_list_length": Builtin(_get_list_length),
        "integer_to_binary_list": Builtin(_integer_to_binary_list, cost=16),
        "inv": Builtin(_inv, cost=200),
        "length": Builtin(_length),
        "make_list": Builtin(_make_list, cost=4),
        "norm": Builtin(_norm, cost=4),
        "normalize": Builtin(_normalize, cost=8),
        "size": Builtin(_size),
        "transpose": Builtin(_transpose, cost=4),
    }
