"""How a message type is declared: a dataclass whose annotations carry each field's ROS type and unit.

The ROS 2 `.msg` text follows from it: `definition(Attempt)` is complete.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, is_dataclass
from typing import Annotated, Any, TypeVar, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Ros:
    """The ROS type of a field, with its unit where it has one."""

    type: str
    unit: str = ""


Bool = Annotated[bool, Ros("bool")]
UInt8 = Annotated[int, Ros("uint8")]
UInt32 = Annotated[int, Ros("uint32")]
UInt64 = Annotated[int, Ros("uint64")]
Text = Annotated[str, Ros("string")]
Number = Annotated[float, Ros("float64")]
Metres = Annotated[float, Ros("float64", "m")]
SquareMetres = Annotated[float, Ros("float64", "m^2")]
Radians = Annotated[float, Ros("float64", "rad")]
Seconds = Annotated[float, Ros("float64", "s")]
Newtons = Annotated[float, Ros("float64", "N")]
Numbers = Annotated[NDArray[np.float64], Ros("float64[]")]

Message = TypeVar("Message")
_declared: dict[str, type[Any]] = {}


def message(cls: type[Message]) -> type[Message]:
    """Declare a dataclass as the ROS type `palpate_msgs/msg/<class name>`."""
    name = f"palpate_msgs/msg/{cls.__name__}"
    cls.__msgtype__ = name  # type: ignore[attr-defined]
    _declared[name] = cls
    return cls


def type_name(cls: type[Any]) -> str:
    """ROS name of a message class, `package/msg/Type`."""
    return str(cls.__msgtype__)


def definition(cls: type[Any]) -> str:
    """The `.msg` text of a type that palpate declares."""
    lines = [f"# {line}".rstrip() for line in (cls.__doc__ or "").strip().splitlines()]
    hints = get_type_hints(cls, include_extras=True)
    lines += [_field_line(item.name, hints[item.name]) for item in fields(cls)]
    return "\n".join(lines) + "\n"


def _field_line(name: str, hint: Any) -> str:
    if get_origin(hint) is list:
        return f"{_nested_name(get_args(hint)[0])}[] {name}"
    if get_origin(hint) is Annotated:
        ros_type = next(item for item in get_args(hint) if isinstance(item, Ros))
        return f"{ros_type.type} {name}" + (f"  # [{ros_type.unit}]" if ros_type.unit else "")
    return f"{_nested_name(hint)} {name}"


def _nested_name(cls: type[Any]) -> str:
    assert is_dataclass(cls), f"{cls} is no message type"
    package, _, name = type_name(cls).split("/")
    return f"{package}/{name}"


def declared() -> dict[str, type[Any]]:
    """Every `palpate_msgs` type by its ROS name."""
    return dict(_declared)
