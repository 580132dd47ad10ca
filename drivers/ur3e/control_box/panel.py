"""What an operator does to a control box by hand: buttons, inputs, a push at the tool. One line of words each."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from drivers.ur3e.control_box.box import ControlBox
from runtime.errors import InputError, alternatives

HELP = """\
estop press|release            the emergency stop button
safeguard open|close           the safeguard input: a light curtain that is interrupted, or clear
power on|off|run               drives and brakes
unlock                         release a protective stop, 5 s after it happened at the earliest
input N on|off                 digital input: 0-7 standard, 8-15 configurable, 16-17 at the tool
analog N VALUE                 analog input 0-1 in mA or V, 2-3 at the tool in V
push FX FY FZ [TX TY TZ]       push at the gripper, N and Nm in the base frame; `push 0 0 0` lets go
speed PERCENT                  the speed slider
play | pause | stop            the program
close                          the window that a program has put up
quit                           end"""

_INPUTS = 18
_STRONGEST = 200.0  # [N], [Nm] a person pushes no harder


def operate(box: ControlBox, line: str) -> str:
    """Do what a line says; tells what was done. Raises InputError that names what can be said instead."""
    words = line.split()
    if not words:
        return ""
    action = _ACTIONS.get(words[0].lower())
    if action is None:
        raise InputError(f"no such action {words[0]!r}; {alternatives(words[0], _ACTIONS)}")
    return action(box, words[1:])


def _one_of(words: Sequence[str], *known: str) -> str:
    if len(words) != 1 or words[0].lower() not in known:
        raise InputError(f"say one of: {', '.join(known)}")
    return words[0].lower()


def _numbers(words: Sequence[str], *counts: int) -> list[float]:
    try:
        values = [float(word) for word in words]
    except ValueError:
        values = [math.nan]
    if len(values) not in counts or not all(math.isfinite(value) for value in values):
        needed = " or ".join(map(str, counts))
        raise InputError(f"{needed} numbers are needed" if any(counts) else "nothing more is to be said")
    return values


def _estop(box: ControlBox, words: Sequence[str]) -> str:
    pressed = _one_of(words, "press", "release") == "press"
    box.press_emergency_stop(pressed)
    return "emergency stop pressed" if pressed else "emergency stop released; switch the power on again"


def _safeguard(box: ControlBox, words: Sequence[str]) -> str:
    is_open = _one_of(words, "open", "close") == "open"
    box.open_safeguard(is_open)
    return f"safeguard input {'open' if is_open else 'closed'}"


def _power(box: ControlBox, words: Sequence[str]) -> str:
    wanted = _one_of(words, "on", "off", "run")
    {"on": box.power_on, "off": box.power_off, "run": box.brake_release}[wanted]()
    return f"power {wanted}"


def _unlock(box: ControlBox, words: Sequence[str]) -> str:
    _numbers(words, 0)
    return "unlocked" if box.unlock_protective_stop() else "cannot be unlocked until 5 s after the stop"


def _input(box: ControlBox, words: Sequence[str]) -> str:
    (number,) = _numbers(words[:1], 1)
    on = _one_of(words[1:], "on", "off") == "on"
    if number not in range(_INPUTS):
        raise InputError(f"no digital input {words[0]}; there are 0 to {_INPUTS - 1}")
    box.wiring.set_input(int(number), on)
    return f"digital input {int(number)} {'on' if on else 'off'}"


def _analog(box: ControlBox, words: Sequence[str]) -> str:
    number, value = _numbers(words, 2)
    wiring = box.wiring
    if number in (0, 1):
        index = int(number)
        wiring.analog_in[index] = value if wiring.analog_in_voltage[index] else value * 1e-3
        return f"analog input {index} at {value:g} {'V' if wiring.analog_in_voltage[index] else 'mA'}"
    if number in (2, 3):
        wiring.tool_analog_in[int(number) - 2] = value
        return f"tool's analog input {int(number)} at {value:g} V"
    raise InputError(f"no analog input {words[0]}; there are 0 to 3")


def _push(box: ControlBox, words: Sequence[str]) -> str:
    values = _numbers(words, 3, 6)
    if max(map(abs, values)) > _STRONGEST:
        raise InputError(f"nobody pushes harder than {_STRONGEST:g} N")
    x, y, z, *torque = values
    tx, ty, tz = torque or (0.0, 0.0, 0.0)
    box.arm.scene.push((-x, -y, z, -tx, -ty, tz))  # base is base_link turned by half a turn
    return f"pushing with ({x:g}, {y:g}, {z:g}) N" if any(values) else "let go"


def _speed(box: ControlBox, words: Sequence[str]) -> str:
    (percent,) = _numbers(words, 1)
    box.set_speed_slider(percent / 100)
    return f"speed slider at {box.speed_slider:.0%}"


def _program(name: str) -> Callable[[ControlBox, Sequence[str]], str]:
    def act(box: ControlBox, words: Sequence[str]) -> str:
        _numbers(words, 0)
        done = {"play": box.play, "pause": box.pause, "stop": box.stop}[name]()
        return name if done else f"{name}: not possible now"

    return act


def _close(box: ControlBox, words: Sequence[str]) -> str:
    _numbers(words, 0)
    box.close_popup()
    return "window closed"


def _quit(box: ControlBox, words: Sequence[str]) -> str:
    _numbers(words, 0)
    box.shutdown()
    return "ending"


def _help(_box: ControlBox, _words: Sequence[str]) -> str:
    return HELP


_ACTIONS: dict[str, Callable[[ControlBox, Sequence[str]], str]] = {
    "estop": _estop,
    "safeguard": _safeguard,
    "power": _power,
    "unlock": _unlock,
    "input": _input,
    "analog": _analog,
    "push": _push,
    "speed": _speed,
    "play": _program("play"),
    "pause": _program("pause"),
    "stop": _program("stop"),
    "close": _close,
    "quit": _quit,
    "help": _help,
}
