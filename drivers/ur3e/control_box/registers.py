"""General purpose registers and electrical inputs and outputs: what programs and clients exchange values through."""

from __future__ import annotations

from dataclasses import dataclass, field

COUNT = 48  # integer and double registers in each direction
BITS = 128  # bit registers in each direction


def _integers() -> list[int]:
    return [0] * COUNT


def _doubles() -> list[float]:
    return [0.0] * COUNT


def _bits() -> list[bool]:
    return [False] * BITS


@dataclass
class Registers:
    """Inputs are written by RTDE clients and read by programs; outputs the other way round."""

    input_int: list[int] = field(default_factory=_integers)  # (48,) int32
    input_double: list[float] = field(default_factory=_doubles)  # (48,)
    input_bit: list[bool] = field(default_factory=_bits)  # (128,)
    output_int: list[int] = field(default_factory=_integers)
    output_double: list[float] = field(default_factory=_doubles)
    output_bit: list[bool] = field(default_factory=_bits)


@dataclass
class Wiring:
    """Electrical inputs and outputs. Bits as in RTDE: 0-7 standard, 8-15 configurable, 16-17 tool."""

    digital_in: int = 0
    digital_out: int = 0
    analog_in: list[float] = field(default_factory=lambda: [0.004, 0.004])  # [A] or [V], by analog_in_voltage
    analog_out: list[float] = field(default_factory=lambda: [0.004, 0.004])  # [A] or [V], by analog_out_voltage
    analog_in_voltage: list[bool] = field(default_factory=lambda: [False, False])  # False: 4-20 mA, True: 0-10 V
    analog_out_voltage: list[bool] = field(default_factory=lambda: [False, False])
    tool_analog_in: list[float] = field(default_factory=lambda: [0.0, 0.0])  # [V]
    tool_voltage: int = 0  # [V] 0, 12 or 24

    def set_output(self, bit: int, on: bool) -> None:
        """Switch one digital output, by its bit."""
        self.digital_out = self.digital_out | 1 << bit if on else self.digital_out & ~(1 << bit)

    def drive_analog(self, index: int, share: float) -> None:
        """Put an analogue output at a share 0..1 of 4-20 mA or of 0-10 V."""
        self.analog_out[index] = 10.0 * share if self.analog_out_voltage[index] else 0.004 + 0.016 * share

    def set_input(self, bit: int, on: bool) -> None:
        """What the world outside puts on one digital input, by its bit."""
        self.digital_in = self.digital_in | 1 << bit if on else self.digital_in & ~(1 << bit)
