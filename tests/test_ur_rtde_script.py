"""ur-rtde's control script: uploaded, replaced, watched, stopped; and what its constructor's flags do."""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from robots import Robot
from ur_rtde_clients import FAST, HOME, Cell, client, connected, has_modes, joints, restored, standing
from ur_rtde_methods import Watched, covers, interface, left_out

from drivers.ur3e.control_box.box import ControlBox

NEAR_HOME = [HOME[0] + 0.05, *HOME[1:]]

left_out(
    "RTDEControlInterface",
    FLAG_USE_EXT_UR_CAP="needs the External Control cap on the pendant, which fetches the script from the client",
)


@pytest.fixture(scope="module")
def running() -> Iterator[Cell]:
    with connected(Robot("empty")) as cell:
        yield cell


@pytest.fixture
def cell(running: Cell) -> Cell:
    return restored(running)


def moving(box: ControlBox) -> bool:
    return max(map(abs, box.arm.getActualQd())) > 0.02


def outputs(box: ControlBox) -> int:
    return box.wiring.digital_out


def name(box: ControlBox) -> str:
    return box.program_name


def started(lines: list[str], program: str) -> int:
    return sum(f"program '{program}' started" in line for line in lines)


@covers(
    "RTDEControlInterface",
    sendCustomScriptFunction="its lines run in place of the control script, which is back afterwards",
    sendCustomScript="a program that tells its end in a register runs; the control script is back afterwards",
    sendCustomScriptFile="the same out of a file",
)
def test_custom_scripts(cell: Cell, tmp_path: Path) -> None:
    control, robot = cell.control, cell.robot
    body = f"set_standard_digital_out(1, True)\nmovej({NEAR_HOME}, a=10, v=3)"
    assert control.sendCustomScriptFunction("mine", body)
    assert started(robot.lines, "mine") == 1
    assert robot.look(outputs) == 1 << 1
    assert robot.look(joints) == pytest.approx(NEAR_HOME, abs=1e-3)
    assert control.moveJ(HOME, *FAST)
    text = (
        "def whole():\n  write_output_integer_register(0, 1)\n  set_standard_digital_out(1, False)\n"
        f"  movej({NEAR_HOME}, a=10, v=3)\n  write_output_integer_register(0, 2)\nend\n"
    )
    assert control.sendCustomScript(text)
    assert started(robot.lines, "whole") == 1
    assert robot.look(outputs) == 0
    assert robot.look(joints) == pytest.approx(NEAR_HOME, abs=1e-3)
    path = tmp_path / "filed.script"
    path.write_text(text.replace("whole", "filed").replace("False", "True"))
    assert control.sendCustomScriptFile(str(path))
    assert started(robot.lines, "filed") == 1
    assert robot.look(outputs) == 1 << 1
    assert control.moveJ(HOME, *FAST)
    assert robot.look(name) == "rtde_control"


OWN = """def own_control():
  write_output_integer_register(0, 1)
  while True:
    cmd = read_input_integer_register(0)
    if cmd == 1:
      set_standard_digital_out(6, True)
      write_output_integer_register(0, 2)
      while read_input_integer_register(0) != 0:
        sync()
      end
      write_output_integer_register(0, 1)
    elif cmd == 255:
      halt
    end
    sync()
  end
end
"""


@covers(
    "RTDEControlInterface",
    setCustomScriptFile="the client's own control script runs from then on, and gets its commands",
    reuploadScript="the control script begins anew in place of the one that runs",
    isProgramRunning="whether it runs",
    stopScript="it ends, and with it the motion under way",
    getRobotStatus="bits 0 power and 1 program",
)
def test_the_control_script(cell: Cell, tmp_path: Path) -> None:
    control, robot = cell.control, cell.robot
    assert control.isProgramRunning()
    assert control.getRobotStatus() == 0b11
    assert control.moveJ([HOME[0] + 1.0, *HOME[1:]], 0.5, 5.0, True)
    robot.until(moving)
    control.stopScript()
    robot.until(has_modes, "STOPPED")
    robot.until(standing)
    assert not control.isProgramRunning()
    assert control.getRobotStatus() == 0b01
    assert not control.moveJ(HOME)
    count = started(robot.lines, "rtde_control")
    assert control.reuploadScript()
    cell.wait(control.isProgramRunning)
    assert control.reuploadScript()
    cell.wait(lambda: started(robot.lines, "rtde_control") == count + 2)
    cell.wait(control.isProgramRunning)
    assert control.moveJ(HOME, *FAST)
    path = tmp_path / "own.script"
    path.write_text(OWN)
    control.setCustomScriptFile(str(path))
    cell.wait(lambda: started(robot.lines, "own_control"))
    cell.wait(control.isProgramRunning)
    before = robot.look(joints)
    assert control.moveJ(NEAR_HOME)
    assert robot.look(outputs) >> 6 & 1
    assert robot.look(joints) == pytest.approx(before, abs=1e-4)
    control.setCustomScriptFile("")
    cell.wait(lambda: started(robot.lines, "rtde_control") == count + 3)
    cell.wait(control.isProgramRunning)
    assert control.moveJ(NEAR_HOME, *FAST)


@covers(
    "RTDEControlInterface",
    setWatchdog="once the client is silent the program ends, and the arm stands",
    kickWatchdog="as long as it comes often enough the program goes on",
)
def test_watchdog(cell: Cell) -> None:
    control, robot = cell.control, cell.robot
    assert control.moveJ([HOME[0] + 2.0, *HOME[1:]], 0.1, 5.0, True)
    assert control.setWatchdog(1.0)
    begin = cell.receive.getTimestamp()
    while cell.receive.getTimestamp() < begin + 1.5:
        assert control.kickWatchdog()
        control.waitPeriod(control.initPeriod())
    assert robot.look(has_modes, "PLAYING")
    assert robot.look(moving)
    robot.until(has_modes, "STOPPED")
    robot.until(standing)
    assert any("watchdog: input_int_register_0 has not come within 1 s: stop" in line for line in robot.lines)


@covers(
    "RTDEControlInterface",
    isConnected="whether packages come",
    disconnect="the registers that it had claimed are free; the program stays",
    reconnect="the control script is uploaded anew, and moves the arm",
)
def test_connection(cell: Cell) -> None:
    control = cell.control
    assert control.isConnected()
    control.disconnect()
    assert not control.isConnected()
    assert cell.robot.look(has_modes, "PLAYING")
    assert control.reconnect()
    assert control.isConnected()
    assert control.moveJ(NEAR_HOME, *FAST)
    assert cell.robot.look(joints) == pytest.approx(NEAR_HOME, abs=1e-3)


# Flags

CONTROL = Watched("RTDEControlInterface", interface("RTDEControlInterface"))


@pytest.fixture
def robot(running: Cell) -> Iterator[Robot]:
    """A controller that no control interface is connected to."""
    running.control.disconnect()
    running.robot.look(ControlBox.stop)
    yield running.robot
    running.robot.look(ControlBox.stop)
    running.control.reconnect()


@contextmanager
def controlled(robot: Robot, *flags: Any) -> Iterator[Any]:
    control = client("RTDEControlInterface", robot.host, 500.0, sum(int(flag) for flag in flags))
    try:
        yield control
    finally:
        control.disconnect()


def moves(control: Any, robot: Robot, q: list[float]) -> bool:
    return bool(control.moveJ(q, *FAST)) and robot.look(joints) == pytest.approx(q, abs=1e-3)


@covers(
    "RTDEControlInterface",
    FLAGS_DEFAULT="uploads the script",
    FLAG_UPLOAD_SCRIPT="the control script runs, in place of one that ran",
    FLAG_VERBOSE="says what it does; all else as without",
    Flags="names them",
)
def test_uploading(robot: Robot, capfd: pytest.CaptureFixture[str]) -> None:
    assert CONTROL.Flags.FLAG_UPLOAD_SCRIPT == CONTROL.FLAG_UPLOAD_SCRIPT
    assert int(CONTROL.FLAGS_DEFAULT) == int(CONTROL.FLAG_UPLOAD_SCRIPT)
    count = started(robot.lines, "rtde_control")
    with controlled(robot, CONTROL.FLAGS_DEFAULT) as control:
        assert moves(control, robot, HOME)
    with controlled(robot, CONTROL.FLAG_UPLOAD_SCRIPT, CONTROL.FLAG_VERBOSE) as control:
        assert moves(control, robot, NEAR_HOME)
    assert "A script was running on the controller, killing it!" in capfd.readouterr().out
    assert started(robot.lines, "rtde_control") == count + 2


def registers(box: ControlBox) -> tuple[int, int]:
    """What the control script has in its first output register, in the lower and in the upper range."""
    return box.registers.output_int[0], box.registers.output_int[24]


def forget_registers(box: ControlBox) -> None:
    box.registers.output_int[:] = [0] * len(box.registers.output_int)


@covers(
    "RTDEControlInterface",
    FLAG_UPPER_RANGE_REGISTERS="the arm is moved over registers 24 and up; those below stay free",
    FLAG_NO_EXT_FT="external_force_torque stays free for another client, whose wrench arrives",
)
def test_registers_are_left_to_others(robot: Robot) -> None:
    robot.look(forget_registers)
    with controlled(robot, 1, CONTROL.FLAG_UPPER_RANGE_REGISTERS, CONTROL.FLAG_NO_EXT_FT) as control:
        assert moves(control, robot, HOME)
        assert robot.look(registers) == (0, 1)
        with pytest.raises((RuntimeError, ValueError), match="flag for not using the external_force_torque"):
            control.setExternalForceTorque([0.0] * 6)
        with socket.create_connection((robot.host, 30004), timeout=10) as other:
            other.sendall(
                struct.pack(">HBH", 5, ord("V"), 2) + struct.pack(">HB", 24, ord("I")) + b"external_force_torque"
            )
            answer = b""
            while len(answer) < 4 + 12:
                answer += other.recv(100)
            assert answer[4:] == struct.pack(">HBB", 12, ord("I"), 1) + b"VECTOR6D"
            other.sendall(struct.pack(">HBB6d", 52, ord("U"), 1, 1.0, 2.0, 3.0, 0.1, 0.2, 0.3))
            robot.until(has_external, [1.0, 2.0, 3.0, 0.1, 0.2, 0.3])


def has_external(box: ControlBox, wrench: list[float]) -> bool:
    return box.external_force_torque == wrench


def run_own(box: ControlBox) -> None:
    box.run_script(OWN, "pendant")


@covers(
    "RTDEControlInterface",
    FLAG_CUSTOM_SCRIPT="commands go to a program that was started on the controller itself",
    FLAG_NO_WAIT="connects although no program runs; commands are refused until one does",
)
def test_a_program_of_the_controller(robot: Robot) -> None:
    with controlled(robot, CONTROL.FLAG_NO_WAIT, CONTROL.FLAG_CUSTOM_SCRIPT) as control:
        assert control.isConnected()
        assert not control.moveJ(HOME)
        robot.look(run_own)
        robot.until(has_modes, "PLAYING")
        robot.look(put_out)
        while not control.isProgramRunning():
            control.waitPeriod(control.initPeriod())
        assert control.moveJ(HOME)
        assert robot.look(outputs) >> 6 & 1


def put_out(box: ControlBox) -> None:
    box.wiring.digital_out = 0


def local(box: ControlBox, is_local: bool) -> None:
    box.remote_control = not is_local


@covers(
    "RTDEControlInterface",
    FLAG_DISABLE_REMOTE_CONTROL_CHECK="connects in local control, which is refused without it",
)
def test_local_control(robot: Robot) -> None:
    robot.look(local, True)
    with pytest.raises((RuntimeError, ValueError), match="Please enable remote control"):
        client("RTDEControlInterface", robot.host)
    with controlled(robot, CONTROL.FLAG_NO_WAIT, CONTROL.FLAG_DISABLE_REMOTE_CONTROL_CHECK) as control:
        assert control.isConnected()
    robot.look(local, False)
