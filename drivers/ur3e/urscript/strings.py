"""Builtins on strings. Positions are those of bytes, as UR counts them."""

from __future__ import annotations

import re

from drivers.ur3e.urscript.builtin import Builtin
from drivers.ur3e.urscript.errors import BuiltinError
from drivers.ur3e.urscript.maths import whole
from drivers.ur3e.urscript.values import Number, Value, kind, number, written

LONGEST_JOINED = 1023  # [bytes] that to_str and str_cat may make
_DECIMAL = r"(?:\d{1,400}\.?\d{0,400}|\.\d{1,400})(?:[eE][+-]?\d{1,5})?"
_NUMBER = re.compile(rf"\s*([+-]?)(?:(0[xX][0-9a-fA-F]{{1,16}})|({_DECIMAL}))", re.ASCII)


def _bytes(value: Value) -> bytes:
    if type(value) is not str:
        raise BuiltinError(f"a string is needed, not a {kind(value)}")
    return value.encode("utf-8", "surrogateescape")


def _text(content: bytes) -> str:
    return content.decode("utf-8", "surrogateescape")


def _short(text: str) -> str:
    content = _bytes(text)
    if len(content) > LONGEST_JOINED:
        raise BuiltinError(f"the string would have {len(content)} bytes; the limit is {LONGEST_JOINED}")
    return _text(content)


def _str_at(src: Value, index: Value) -> str:
    content, at = _bytes(src), whole(index)
    if not 0 <= at < len(content):
        raise BuiltinError(f"index {at} is outside of a string of {len(content)} bytes")
    return _text(content[at : at + 1])


def _str_cat(op1: Value, op2: Value) -> str:
    return _short(_to_str(op1) + _to_str(op2))


def _str_empty(str: Value) -> bool:  # noqa: A002 (the parameter's name in URScript)
    return not _bytes(str)


def _str_find(src: Value, target: Value, start_from: Value = 0) -> int:
    content, at = _bytes(src), whole(start_from)
    if not 0 <= at <= len(content):
        raise BuiltinError(f"start {at} is outside of a string of {len(content)} bytes")
    return content.find(_bytes(target), at)


def _str_len(str: Value) -> int:  # noqa: A002
    return len(_bytes(str))


def _str_sub(src: Value, index: Value, len: Value = None) -> str:  # noqa: A002
    return _part(_bytes(src), whole(index), None if len is None else whole(len))


def _part(content: bytes, at: int, count: int | None) -> str:
    if not 0 <= at <= len(content):
        raise BuiltinError(f"index {at} is outside of a string of {len(content)} bytes")
    if count is None:
        return _text(content[at:])
    if count < 0:
        raise BuiltinError(f"a substring cannot have {count} bytes")
    return _text(content[at : at + count])


def _to_num(str: Value) -> Number:  # noqa: A002
    text = _text(_bytes(str))
    match = _NUMBER.fullmatch(text)
    if match is None:
        raise BuiltinError(f"{text[:40]!r} is not a number")
    sign = -1 if match[1] == "-" else 1
    if match[2]:
        return number(sign * int(match[2], 16))
    return number(sign * int(match[3])) if match[3].isdigit() else number(sign * float(match[3]))


def _to_str(val: Value) -> str:
    if val is None:
        raise BuiltinError("a function that returns nothing has no string")
    return _short(written(val))


def strings() -> dict[str, Builtin]:
    """The builtins by name."""
    return {
        "str_at": Builtin(_str_at),
        "str_cat": Builtin(_str_cat, cost=4),
        "str_empty": Builtin(_str_empty),
        "str_find": Builtin(_str_find, cost=8),
        "str_len": Builtin(_str_len),
        "str_sub": Builtin(_str_sub, cost=4),
        "to_num": Builtin(_to_num),
        "to_str": Builtin(_to_str, cost=4),
    }
