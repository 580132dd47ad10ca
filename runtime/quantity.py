"""Physical quantities as people write them: `"0.3 mm"`, `"45 deg"`, `"5 N"`. Inside they are SI floats.

    class Settings:
        stride: Length = 0.3e-3  # [m]

A field annotated with one of these types accepts a text with a unit of its dimension, and nothing else: a bare number
would leave the unit to be guessed. `Annotated[Length, Positive]` narrows the range.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import Annotated, Any

from pydantic import BeforeValidator, Field
from pydantic_core import PydanticCustomError

_NUMBER = re.compile(r"^\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*([^\s\d].*?)\s*$")

UNITS: dict[str, dict[str, float]] = {
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6},
    "angle": {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180},
    "time": {"s": 1.0, "ms": 1e-3, "min": 60.0},
    "force": {"N": 1.0, "mN": 1e-3},
    "torque": {"Nm": 1.0, "mNm": 1e-3},
    "speed": {"m/s": 1.0, "mm/s": 1e-3},
    "acceleration": {"m/s2": 1.0, "mm/s2": 1e-3},
    "mass": {"kg": 1.0, "g": 1e-3},
    "stiffness": {"N/m": 1.0, "N/mm": 1e3},
    "frequency": {"Hz": 1.0},
    "inverse area": {"m^-2": 1.0, "mm^-2": 1e6},
}


def parse(text: str, dimension: str) -> float:
    """SI value of a quantity. Raises ValueError that names the units which would do."""
    units = UNITS[dimension]
    wanted = f"write a number and a unit of {dimension}: {', '.join(units)}"
    match = _NUMBER.match(text)
    if match is None:
        raise ValueError(f"{text!r} is no {dimension}; {wanted}")
    number, unit = match.groups()
    if unit not in units:
        raise ValueError(f"{unit!r} is no unit of {dimension}; {wanted}")
    return float(number) * units[unit]


def _reader(dimension: str) -> Callable[[Any], float]:
    example = f'"1 {next(iter(UNITS[dimension]))}"'

    def read(value: Any) -> float:
        if not isinstance(value, str):
            raise PydanticCustomError(
                "quantity",
                "{value} has no unit; write it as text with one, such as {example}",
                {"value": repr(value), "example": example},
            )
        try:
            return parse(value, dimension)
        except ValueError as error:
            raise PydanticCustomError("quantity", "{reason}", {"reason": str(error)}) from None

    return read


Length = Annotated[float, BeforeValidator(_reader("length"))]
Angle = Annotated[float, BeforeValidator(_reader("angle"))]
Duration = Annotated[float, BeforeValidator(_reader("time"))]
Force = Annotated[float, BeforeValidator(_reader("force"))]
Torque = Annotated[float, BeforeValidator(_reader("torque"))]
Speed = Annotated[float, BeforeValidator(_reader("speed"))]
Acceleration = Annotated[float, BeforeValidator(_reader("acceleration"))]
Mass = Annotated[float, BeforeValidator(_reader("mass"))]
Stiffness = Annotated[float, BeforeValidator(_reader("stiffness"))]
Frequency = Annotated[float, BeforeValidator(_reader("frequency"))]
InverseArea = Annotated[float, BeforeValidator(_reader("inverse area"))]

Positive = Field(gt=0)
NotNegative = Field(ge=0)
