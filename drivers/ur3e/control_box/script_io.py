"""URScript's registers, inputs and outputs, messages and time."""

from __future__ import annotations

from collections.abc import Generator, MutableSequence
from typing import TYPE_CHECKING, Any, TypeAlias

from drivers.ur3e.control_box.events import Popup, TextMessage
from drivers.ur3e.control_box.registers import BITS, COUNT
from drivers.ur3e.control_box.script_sockets import text_of
from drivers.ur3e.control_box.watchdog import ACTIONS, Watchdog
from drivers.ur3e.parameters import CYCLE
from runtime.errors import ArmError, alternatives

if TYPE_CHECKING:
    from drivers.ur3e.control_box.box import ControlBox

Cycles: TypeAlias = Generator[None, None, Any]

_STANDARD, _CONFIGURABLE, _TOOL = 0, 8, 16  # first bit of each kind
_INT32 = 2**31


def _slot(values: MutableSequence[Any], index: float, what: str, size: int) -> int:
    number = int(index)
    if not 0 <= number < size:
        raise ArmError(f"no {what} register {number}; there are 0 to {len(values) - 1}")
    return number


def _pin(index: float, count: int, what: str) -> int:
    number = int(index)
    if not 0 <= number < count:
        raise ArmError(f"no {what} {number}; there are 0 to {count - 1}")
    return number


class IoBuiltins:
    """The functions that exchange values with clients, the surroundings and the operator."""

    def __init__(self, box: ControlBox) -> None:
        self._box = box

    # Registers

    def read_input_integer_register(self, address: float) -> int:
        """A register that an RTDE client has written."""
        values = self._box.registers.input_int
        return values[_slot(values, address, "integer", COUNT)]

    def read_input_float_register(self, address: float) -> float:
        """A register that an RTDE client has written."""
        values = self._box.registers.input_double
        return values[_slot(values, address, "float", COUNT)]

    def read_input_boolean_register(self, address: float) -> bool:
        """A register that an RTDE client has written."""
        values = self._box.registers.input_bit
        return values[_slot(values, address, "boolean", BITS)]

    def read_output_integer_register(self, address: float) -> int:
        """What a program wrote last."""
        values = self._box.registers.output_int
        return values[_slot(values, address, "integer", COUNT)]

    def read_output_float_register(self, address: float) -> float:
        """What a program wrote last."""
        values = self._box.registers.output_double
        return values[_slot(values, address, "float", COUNT)]

    def read_output_boolean_register(self, address: float) -> bool:
        """What a program wrote last."""
        values = self._box.registers.output_bit
        return values[_slot(values, address, "boolean", BITS)]

    def write_output_integer_register(self, address: float, value: float) -> None:
        """Write a register that RTDE clients read."""
        values = self._box.registers.output_int
        number = int(value)
        if not -_INT32 <= number < _INT32:
            raise ArmError(f"{number} does not fit into an integer register of 32 bits")
        values[_slot(values, address, "integer", COUNT)] = number

    def write_output_float_register(self, address: float, value: float) -> None:
        """Write a register that RTDE clients read."""
        values = self._box.registers.output_double
        values[_slot(values, address, "float", COUNT)] = float(value)

    def write_output_boolean_register(self, address: float, value: bool) -> None:
        """Write a register that RTDE clients read."""
        values = self._box.registers.output_bit
        values[_slot(values, address, "boolean", BITS)] = bool(value)

    # Digital inputs and outputs

    def _read(self, first: int, index: float, count: int, what: str, *, output: bool) -> bool:
        wiring = self._box.wiring
        bits = wiring.digital_out if output else wiring.digital_in
        return bool(bits >> (first + _pin(index, count, what)) & 1)

    def _write(self, first: int, index: float, count: int, what: str, on: bool) -> None:
        self._box.wiring.set_output(first + _pin(index, count, what), bool(on))

    def get_standard_digital_in(self, n: float) -> bool:
        """Standard inputs 0-7."""
        return self._read(_STANDARD, n, 8, "standard digital input", output=False)

    def get_configurable_digital_in(self, n: float) -> bool:
        """Configurable inputs 0-7."""
        return self._read(_CONFIGURABLE, n, 8, "configurable digital input", output=False)

    def get_tool_digital_in(self, n: float) -> bool:
        """Inputs 0-1 at the tool."""
        return self._read(_TOOL, n, 2, "tool digital input", output=False)

    def get_digital_in(self, n: float) -> bool:
        """Inputs 0-7 standard, 8-15 configurable, 16-17 at the tool."""
        return self._read(0, n, 18, "digital input", output=False)

    def get_standard_digital_out(self, n: float) -> bool:
        """Standard outputs 0-7."""
        return self._read(_STANDARD, n, 8, "standard digital output", output=True)

    def get_configurable_digital_out(self, n: float) -> bool:
        """Configurable outputs 0-7."""
        return self._read(_CONFIGURABLE, n, 8, "configurable digital output", output=True)

    def get_tool_digital_out(self, n: float) -> bool:
        """Outputs 0-1 at the tool."""
        return self._read(_TOOL, n, 2, "tool digital output", output=True)

    def get_digital_out(self, n: float) -> bool:
        """Outputs 0-7 standard, 8-15 configurable, 16-17 at the tool."""
        return self._read(0, n, 18, "digital output", output=True)

    def set_standard_digital_out(self, n: float, b: bool) -> None:
        """Standard outputs 0-7."""
        self._write(_STANDARD, n, 8, "standard digital output", b)

    def set_configurable_digital_out(self, n: float, b: bool) -> None:
        """Configurable outputs 0-7."""
        self._write(_CONFIGURABLE, n, 8, "configurable digital output", b)

    def set_tool_digital_out(self, n: float, b: bool) -> None:
        """Outputs 0-1 at the tool; the gripper is on 0."""
        self._write(_TOOL, n, 2, "tool digital output", b)

    def set_digital_out(self, n: float, b: bool) -> None:
        """Outputs 0-7 standard, 8-15 configurable, 16-17 at the tool."""
        self._write(0, n, 18, "digital output", b)

    # Analogue inputs and outputs

    def get_standard_analog_in(self, n: float) -> float:
        """As a share 0..1 of 4-20 mA or 0-10 V."""
        wiring, pin = self._box.wiring, _pin(n, 2, "standard analog input")
        return _share(wiring.analog_in[pin], wiring.analog_in_voltage[pin])

    def get_standard_analog_out(self, n: float) -> float:
        """As a share 0..1 of 4-20 mA or 0-10 V."""
        wiring, pin = self._box.wiring, _pin(n, 2, "standard analog output")
        return _share(wiring.analog_out[pin], wiring.analog_out_voltage[pin])

    def set_standard_analog_out(self, n: float, f: float) -> None:
        """A share 0..1 of 4-20 mA or 0-10 V."""
        wiring, pin = self._box.wiring, _pin(n, 2, "standard analog output")
        if not 0 <= f <= 1:
            raise ArmError(f"an analog output takes a share from 0 to 1, not {f:g}")
        wiring.drive_analog(pin, f)

    def set_analog_outputdomain(self, port: float, domain: float) -> None:
        """0: 4-20 mA, 1: 0-10 V."""
        self._box.wiring.analog_out_voltage[_pin(port, 2, "standard analog output")] = bool(_pin(domain, 2, "domain"))

    def set_standard_analog_input_domain(self, port: float, domain: float) -> None:
        """0: 4-20 mA, 1: 0-10 V."""
        self._box.wiring.analog_in_voltage[_pin(port, 2, "standard analog input")] = bool(_pin(domain, 2, "domain"))

    def get_tool_analog_in(self, n: float) -> float:
        """As a share 0..1 of 0-10 V."""
        return self._box.wiring.tool_analog_in[_pin(n, 2, "tool analog input")] / 10.0

    def set_tool_voltage(self, voltage: float) -> None:
        """Supply of the tool: 0, 12 or 24 V."""
        volts = int(voltage)
        if volts not in (0, 12, 24):
            raise ArmError(f"the tool's supply can be 0, 12 or 24 V, not {voltage:g} V")
        self._box.wiring.tool_voltage = volts

    # Messages, time, watchdog

    def textmsg(self, s1: object, s2: object = "") -> None:
        """Write into the log, and tell primary clients."""
        text = f"{text_of(s1)}{text_of(s2)}"
        self._box.events.append(TextMessage(text))
        self._box.programs.spoken.append(text)

    def popup(
        self,
        s: object,
        title: str = "Popup",
        warning: bool = False,
        error: bool = False,
        blocking: bool = False,
    ) -> Cycles:
        """Put up a window; a blocking one holds the thread until somebody closes it."""
        popup = Popup(title, text_of(s), "error" if error else "warning" if warning else "message", blocking)
        self._box.show(popup)
        while blocking and self._box.popup is popup:
            yield

    def sleep(self, t: float) -> Cycles:
        """Let `t` [s] pass."""
        for _ in range(max(1, round(t / CYCLE))):
            yield

    def sync(self) -> Cycles:
        """Let the rest of this control cycle pass."""
        yield

    def rtde_set_watchdog(self, variable_name: str, min_frequency: float = 10.0, action: str = "pause") -> None:
        """Pause or stop this program when an RTDE input no longer comes often enough."""
        kind = next((known for known in ACTIONS if known == action.lower()), None)
        if kind is None:
            raise ArmError(f"rtde_set_watchdog knows no action {action!r}; {alternatives(action, ACTIONS)}")
        if not 0.01 <= min_frequency <= 500:
            raise ArmError(f"rtde_set_watchdog takes 0.01 to 500 Hz, not {min_frequency:g}")
        box = self._box
        count = box.fed.get(variable_name, 0)
        box.programs.watchdog = Watchdog.on(variable_name, min_frequency, kind, count, box.time)

    def get_controller_temp(self) -> float:
        """Temperature [C] in the control box; assumed constant."""
        return 32.0


def _share(value: float, is_voltage: bool) -> float:
    return value / 10.0 if is_voltage else (value - 0.004) / 0.016
