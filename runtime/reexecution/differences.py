"""Two messages of one type, field by field: which fields differ, and whether that is more than rounding.

Numbers that differ by less than `ROUNDING` count as equal within rounding: other processors and libraries add up in
another order. In metres that is a nanometre, a thousandth of what an arm can repeat.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from typing import Annotated, Any, get_args, get_origin, get_type_hints

from runtime.declaration import Ros

ROUNDING = 1e-9  # relative to the larger of two numbers, or in the unit of the field
_SQUARE_METRES = 1e-13  # [m^2] a variance: half a nanometre of a standard deviation of 0.1 mm
_NOTHING: Mapping[type[Any], frozenset[str]] = {}


@dataclass(frozen=True)
class FieldDifference:
    """One field in which two messages differ."""

    name: str  # dotted, with the index of an item in a list
    unit: str  # empty if it has none
    recorded: Any
    now: Any
    rounding: bool  # the difference is no more than that


def differences(
    recorded: Any, now: Any, known: Mapping[type[Any], frozenset[str]] = _NOTHING
) -> Iterator[FieldDifference]:
    """Fields in which two messages of one class differ, in their order.

    Of the classes in `known` only the fields named there are compared: a log knows no others. Two values that are not
    a number are equal.
    """
    return _compare("", "", recorded, now, known)


def _compare(
    name: str, unit: str, recorded: Any, now: Any, known: Mapping[type[Any], frozenset[str]]
) -> Iterator[FieldDifference]:
    cls: type[Any] = type(recorded)
    if is_dataclass(recorded) and cls is type(now):
        if recorded == now:
            return
        compared = known.get(cls)
        for field_name, field_unit in _fields(cls):  # type: ignore[arg-type]  # classes hash
            if compared is None or field_name in compared:
                place = f"{name}.{field_name}" if name else field_name
                yield from _compare(place, field_unit, getattr(recorded, field_name), getattr(now, field_name), known)
    elif isinstance(recorded, list) and isinstance(now, list):
        if len(recorded) != len(now):
            yield FieldDifference(f"{name} (how many)", "", len(recorded), len(now), rounding=False)
        for index, (one, other) in enumerate(zip(recorded, now, strict=False)):
            yield from _compare(f"{name}[{index}]", unit, one, other, known)
    elif not _same(recorded, now):
        yield FieldDifference(name, unit, recorded, now, _close(recorded, now, unit))


def _same(recorded: Any, now: Any) -> bool:
    if isinstance(recorded, float) and isinstance(now, float) and math.isnan(recorded):
        return math.isnan(now)
    return bool(recorded == now)


def _close(recorded: Any, now: Any, unit: str) -> bool:
    if not (isinstance(recorded, float) and isinstance(now, float)):
        return False
    least = _SQUARE_METRES if unit == "m^2" else ROUNDING
    return math.isclose(recorded, now, rel_tol=ROUNDING, abs_tol=least)


@cache
def _fields(cls: type[Any]) -> tuple[tuple[str, str], ...]:
    """Names and units of a class's fields."""
    names = [item.name for item in fields(cls)]
    if not cls.__module__.startswith("runtime."):  # ROS's own types say no unit
        return tuple((name, "") for name in names)
    hints = get_type_hints(cls, include_extras=True)
    return tuple((name, _unit(hints[name])) for name in names)


def _unit(hint: Any) -> str:
    if get_origin(hint) is not Annotated:
        return ""
    return next((item.unit for item in get_args(hint) if isinstance(item, Ros)), "")
