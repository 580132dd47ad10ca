"""What RTDE clients can tell an e-Series controller: every input field, its type, and what it does (RTDE guide).

Fields that belong together, such as a value and its mask, come in one package and are applied together.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from drivers.ur3e.control_box.box import ControlBox
from drivers.ur3e.control_box.registers import COUNT

_FIRST_BIT, _LAST_BIT = 64, 127
_OUTPUTS = {  # first bit and number of each kind of digital output
    "standard_digital_output": (0, 8),
    "configurable_digital_output": (8, 8),
    "tool_digital_output": (16, 2),
}

INPUTS: dict[str, str] = {
    "speed_slider_mask": "UINT32",  # 1: the fraction is meant
    "speed_slider_fraction": "DOUBLE",  # 0..1
    "standard_digital_output_mask": "UINT8",
    "standard_digital_output": "UINT8",
    "configurable_digital_output_mask": "UINT8",
    "configurable_digital_output": "UINT8",
    "tool_digital_output_mask": "UINT8",
    "tool_digital_output": "UINT8",
    "standard_analog_output_mask": "UINT8",
    "standard_analog_output_type": "UINT8",  # a bit each: 0 current, 1 voltage
    "standard_analog_output_0": "DOUBLE",  # 0..1
    "standard_analog_output_1": "DOUBLE",
    "input_bit_registers0_to_31": "UINT32",
    "input_bit_registers32_to_63": "UINT32",
    "external_force_torque": "VECTOR6D",  # [N, Nm] at the flange
    **{f"input_bit_register_{index}": "BOOL" for index in range(_FIRST_BIT, _LAST_BIT + 1)},
    **{f"input_int_register_{index}": "INT32" for index in range(COUNT)},
    **{f"input_double_register_{index}": "DOUBLE" for index in range(COUNT)},
}

Apply = Callable[[ControlBox, Any], None]


@dataclass(frozen=True)
class InputRecipe:
    """What to do with the values of one recipe."""

    names: tuple[str, ...]
    simple: tuple[Apply | None, ...]  # for each field by itself; None: it belongs to others
    joint: tuple[Callable[[ControlBox, Mapping[str, Any]], None], ...]  # for fields that belong together

    def apply(self, box: ControlBox, values: list[Any]) -> None:
        """Take in one package."""
        for act, value in zip(self.simple, values, strict=True):
            if act is not None:
                act(box, value)
        if self.joint:
            named = dict(zip(self.names, values, strict=True))
            for together in self.joint:
                together(box, named)


def input_recipe(names: list[str]) -> InputRecipe:
    """How to apply values for known fields."""
    joint: list[Callable[[ControlBox, Mapping[str, Any]], None]] = []
    for kind in _OUTPUTS:
        if kind in names and f"{kind}_mask" in names:
            joint.append(_switch(kind))
    if "speed_slider_fraction" in names:
        joint.append(_slide)
    if "standard_analog_output_mask" in names:
        joint.append(_drive)
    return InputRecipe(tuple(names), tuple(_single(name) for name in names), tuple(joint))


def _single(name: str) -> Apply | None:
    kind, _, index = name.rpartition("_")
    if kind in ("input_int_register", "input_double_register", "input_bit_register"):
        return _store(kind.removesuffix("_register"), int(index))
    if name in ("input_bit_registers0_to_31", "input_bit_registers32_to_63"):
        return _store_bits(0 if name.endswith("31") else 32)
    if name == "external_force_torque":
        return _feel
    return None


def _store(values: str, index: int) -> Apply:
    def act(box: ControlBox, value: Any) -> None:
        getattr(box.registers, values)[index] = value

    return act


def _store_bits(first: int) -> Apply:
    def act(box: ControlBox, value: int) -> None:
        box.registers.input_bit[first : first + 32] = [bool(value >> bit & 1) for bit in range(32)]

    return act


def _feel(box: ControlBox, value: tuple[float, ...]) -> None:
    if all(map(math.isfinite, value)):  # others would stop the arm with a reason that leads nowhere
        box.external_force_torque = list(value)


def _switch(kind: str) -> Callable[[ControlBox, Mapping[str, Any]], None]:
    first, count = _OUTPUTS[kind]

    def act(box: ControlBox, values: Mapping[str, Any]) -> None:
        mask, wanted = values[f"{kind}_mask"], values[kind]
        for bit in range(count):
            if mask >> bit & 1:
                box.wiring.set_output(first + bit, bool(wanted >> bit & 1))

    return act


def _slide(box: ControlBox, values: Mapping[str, Any]) -> None:
    fraction = values["speed_slider_fraction"]
    if values.get("speed_slider_mask", 1) and fraction == fraction:  # noqa: PLR0124 - NaN sets nothing
        box.set_speed_slider(fraction)


def _drive(box: ControlBox, values: Mapping[str, Any]) -> None:
    """Analogue outputs: the share 0..1 of 4-20 mA or of 0-10 V."""
    mask, kinds = values["standard_analog_output_mask"], values.get("standard_analog_output_type")
    wiring = box.wiring
    for index in range(2):
        share = values.get(f"standard_analog_output_{index}")
        if not mask >> index & 1 or share is None or not 0.0 <= share <= 1.0:
            continue
        if kinds is not None:
            wiring.analog_out_voltage[index] = bool(kinds >> index & 1)
        wiring.drive_analog(index, share)
