"""ur-rtde's IO interface: what it sets is set in the simulation."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from robots import Robot
from ur_rtde_clients import client
from ur_rtde_methods import covers

from drivers.ur3e.control_box.box import ControlBox


@pytest.fixture(scope="module")
def robot() -> Iterator[Robot]:
    with Robot("empty") as robot:
        yield robot


@pytest.fixture(scope="module")
def io(robot: Robot) -> Iterator[Any]:
    io = client("RTDEIOInterface", robot.host)
    yield io
    io.disconnect()


def outputs(box: ControlBox, wanted: int) -> bool:
    return box.wiring.digital_out == wanted


def analog(box: ControlBox, wanted: list[float], voltage: list[bool]) -> bool:
    return box.wiring.analog_out == pytest.approx(wanted) and box.wiring.analog_out_voltage == voltage


def registers(box: ControlBox, integers: list[int], doubles: list[float]) -> bool:
    return box.registers.input_int[18:23] == integers and box.registers.input_double[18:23] == doubles


def slider(box: ControlBox, fraction: float) -> bool:
    return box.speed_slider == pytest.approx(fraction)


@covers(
    "RTDEIOInterface",
    setStandardDigitalOut="bits 0 to 7 of the outputs, one at a time",
    setConfigurableDigitalOut="bits 8 to 15 of the outputs, one at a time",
    setToolDigitalOut="bits 16 and 17 of the outputs, one at a time",
)
def test_digital_outputs(robot: Robot, io: Any) -> None:
    wanted = 0
    for bit in (0, 7, 8, 15, 16, 17):
        wanted |= 1 << bit
        set_output(io, bit, True)
        robot.until(outputs, wanted)
    for bit in (7, 0, 17, 15, 16, 8):
        wanted &= ~(1 << bit)
        set_output(io, bit, False)
        robot.until(outputs, wanted)


def set_output(io: Any, bit: int, on: bool) -> None:
    switch = (io.setStandardDigitalOut, io.setConfigurableDigitalOut, io.setToolDigitalOut)[bit // 8]
    assert switch(bit % 8, on)


@covers(
    "RTDEIOInterface",
    setAnalogOutputVoltage="the share of 0 to 10 V on one output; the other keeps what it has",
    setAnalogOutputCurrent="the share of 4 to 20 mA on one output; the other keeps what it has",
)
def test_analog_outputs(robot: Robot, io: Any) -> None:
    assert io.setAnalogOutputVoltage(0, 0.75)
    robot.until(analog, [7.5, 0.004], [True, False])
    assert io.setAnalogOutputCurrent(1, 1.0)
    robot.until(analog, [7.5, 0.020], [True, False])
    assert io.setAnalogOutputCurrent(0, 0.25)
    robot.until(analog, [0.008, 0.020], [False, False])
    assert io.setAnalogOutputVoltage(1, 0.1)
    robot.until(analog, [0.008, 1.0], [False, True])


@covers("RTDEIOInterface", setSpeedSlider="the speed slider; beyond 0 to 1 it stays at its end")
def test_speed_slider(robot: Robot, io: Any) -> None:
    for fraction, wanted in ((0.25, 0.25), (0.0, 0.0), (1.5, 1.0), (-1.0, 0.0), (1.0, 1.0)):
        assert io.setSpeedSlider(fraction)
        robot.until(slider, wanted)


@covers(
    "RTDEIOInterface",
    setInputIntRegister="registers 18 to 22, which programs read; the client refuses others",
    setInputDoubleRegister="registers 18 to 22, which programs read; the client refuses others",
)
def test_registers(robot: Robot, io: Any) -> None:
    integers, doubles = [2**31 - 1, -(2**31), 0, 7, -7], [0.1, -2.5, 1e300, 0.0, 5.0]
    for index in range(5):
        assert io.setInputIntRegister(18 + index, integers[index])
        assert io.setInputDoubleRegister(18 + index, doubles[index])
    robot.until(registers, integers, doubles)
    for index in (17, 23):
        with pytest.raises(ValueError, match="supported range"):
            io.setInputIntRegister(index, 1)
        with pytest.raises(ValueError, match="supported range"):
            io.setInputDoubleRegister(index, 1.0)


@covers(
    "RTDEIOInterface",
    isConnected="whether it is",
    disconnect="the registers that it had claimed are free for another client",
    reconnect="it sets outputs again",
)
def test_connection(robot: Robot, io: Any) -> None:
    assert io.isConnected()
    io.disconnect()
    assert not io.isConnected()
    other = client("RTDEIOInterface", robot.host)
    assert other.setStandardDigitalOut(4, True)
    robot.until(outputs, 1 << 4)
    other.disconnect()
    assert io.reconnect()
    assert io.isConnected()
    assert io.setStandardDigitalOut(4, False)
    robot.until(outputs, 0)
