"""ur-rtde's dashboard client: what it asks for happens in the simulation."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest
from robots import Robot
from ur_rtde_clients import Cell, client, connected, has_modes, restored, trail
from ur_rtde_methods import covers, interface, left_out

from drivers.ur3e.control_box.box import ControlBox

PROGRAM = """def swing():
  set_standard_digital_out(5, True)
  while True:
    movej([-0.2, -1.6, 1.9, -1.8, -1.6, -2.0], a=3, v=0.5)
    movej([-0.6, -1.6, 1.9, -1.8, -1.6, -2.0], a=3, v=0.5)
  end
end
"""

left_out(
    "DashboardClient",
    setUserRole="ur-rtde gives Python no UserRole to call it with, and an e-Series has no user roles",
)


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    folder = tmp_path_factory.mktemp("programs")
    (folder / "swing.script").write_text(PROGRAM)
    (folder / "pendant.urp").write_text("")
    with connected(Robot("empty", folder=str(folder))) as cell:
        yield cell


@pytest.fixture
def cell(running: Cell) -> Cell:
    return restored(running)


def moving(box: ControlBox) -> bool:
    return max(map(abs, box.arm.getActualQd())) > 0.1


def steady(box: ControlBox) -> bool:
    return box.steady


def lit(box: ControlBox) -> bool:
    return bool(box.wiring.digital_out >> 5 & 1)


def name(box: ControlBox) -> str:
    return box.program_name


def refusal(command: Callable[[], None]) -> str:
    try:
        command()
    except RuntimeError as error:
        return str(error)
    return ""


@covers(
    "DashboardClient",
    loadURP="ends the program that runs, and loads a .script file of the programs' folder; others are refused",
    getLoadedProgram="its name",
    isProgramSaved="sent and answered; ur-rtde looks for `True` where the dashboard writes `true`: always False",
    play="the program moves the arm; after a pause it goes on",
    pause="the arm stands, the program is kept",
    stop="the arm stands, the program is over",
    running="whether a program moves on",
    programState="PLAYING, PAUSED, STOPPED and the program's name",
)
def test_programs(cell: Cell) -> None:
    dashboard, robot = cell.dashboard, cell.robot
    assert dashboard.getLoadedProgram() == "No program loaded"
    with pytest.raises(RuntimeError, match=r"File not found: nowhere\.urp"):
        dashboard.loadURP("nowhere.urp")
    with pytest.raises(RuntimeError, match=r"Error while loading program: pendant\.urp"):
        dashboard.loadURP("pendant.urp")
    assert dashboard.running()
    dashboard.loadURP("swing.script")
    robot.until(has_modes, "STOPPED")
    assert dashboard.getLoadedProgram() == "Loaded program: swing.script"
    assert dashboard.isProgramSaved() is False
    assert not dashboard.running()
    assert dashboard.programState() == "STOPPED swing.script"
    dashboard.play()
    robot.until(moving)
    assert robot.look(lit)
    assert robot.look(name) == "swing"
    assert dashboard.running()
    assert dashboard.programState() == "PLAYING swing.script"
    dashboard.pause()
    robot.until(steady)
    assert dashboard.programState() == "PAUSED swing.script"
    assert not dashboard.running()
    dashboard.play()
    robot.until(moving)
    dashboard.stop()
    robot.until(steady)
    assert dashboard.programState() == "STOPPED swing.script"
    cell.wait(lambda: "Failed to execute: stop" in refusal(dashboard.stop))
    with pytest.raises(RuntimeError, match="Failed to execute: pause"):
        dashboard.pause()


@covers(
    "DashboardClient",
    powerOff="a moving arm stands, then its drives are off and its program over",
    powerOn="drives on, brakes engaged; the arm refuses programs",
    brakeRelease="the arm can move again",
    robotmode="POWER_OFF, POWER_ON, IDLE, RUNNING on the way",
)
def test_power(cell: Cell) -> None:
    dashboard, robot = cell.dashboard, cell.robot
    assert dashboard.robotmode() == "Robotmode: RUNNING"
    assert cell.control.moveJ([0.5, -1.6, 1.9, -1.8, -1.6, -2.0], 1.0, 2.0, True)
    robot.until(moving)
    dashboard.powerOff()
    robot.until(has_modes, "POWER_OFF", "STOPPED")
    assert dashboard.robotmode() == "Robotmode: POWER_OFF"
    assert not any(robot.look(trail)[-1]["target_qd"])
    dashboard.powerOn()
    assert cell.wait(lambda: dashboard.robotmode() != "Robotmode: POWER_OFF")
    cell.wait(lambda: dashboard.robotmode() == "Robotmode: IDLE")
    cell.control.reuploadScript()
    cell.wait(lambda: any("refused: robot mode idle" in line for line in robot.lines))
    dashboard.brakeRelease()
    robot.until(has_modes, "RUNNING")
    cell.control.reuploadScript()
    cell.wait(cell.control.isProgramRunning)
    assert cell.control.moveJ([0.0, -1.6, 1.9, -1.8, -1.6, -2.0], 3.0, 10.0)


@covers("RTDEReceiveInterface", isProtectiveStopped="during the stop, not after it")
@covers("RTDEControlInterface", triggerProtectiveStop="a moving arm stands at once; safety mode protective stop")
@covers(
    "DashboardClient",
    unlockProtectiveStop="refused within 5 s of the stop in the simulation's time; then the program can go on",
    safetymode="PROTECTIVE_STOP, then NORMAL",
    safetystatus="PROTECTIVE_STOP, then NORMAL",
    closeSafetyPopup="answered; the stop itself remains, and nothing else is taken away",
)
def test_protective_stop(cell: Cell) -> None:
    dashboard, robot, control = cell.dashboard, cell.robot, cell.control
    assert control.moveJ([0.8, -1.6, 1.9, -1.8, -1.6, -2.0], 1.0, 2.0, True)
    robot.until(moving)
    control.triggerProtectiveStop()
    robot.until(has_modes, "PROTECTIVE_STOP", "PAUSED")
    began = cell.receive.getTimestamp()
    cell.wait(cell.receive.isProtectiveStopped)
    assert dashboard.safetymode() == "Safetymode: PROTECTIVE_STOP"
    assert dashboard.safetystatus() == "Safetystatus: PROTECTIVE_STOP"
    with pytest.raises(RuntimeError, match="until 5s after occurrence"):
        dashboard.unlockProtectiveStop()
    robot.until(steady)
    dashboard.closeSafetyPopup()
    assert robot.look(has_modes, "PROTECTIVE_STOP")
    assert not control.moveJ([0.0, -1.6, 1.9, -1.8, -1.6, -2.0])

    cell.wait(lambda: not refusal(dashboard.unlockProtectiveStop))
    cell.in_step()
    assert cell.receive.getTimestamp() - began > 4.9
    assert not cell.receive.isProtectiveStopped()
    assert dashboard.safetymode() == "Safetymode: NORMAL"
    assert dashboard.safetystatus() == "Safetystatus: NORMAL"
    dashboard.play()
    cell.wait(control.isProgramRunning)
    assert control.moveJ([0.0, -1.6, 1.9, -1.8, -1.6, -2.0], 3.0, 10.0)


@covers("RTDEReceiveInterface", isEmergencyStopped="while the button is pressed, and then no longer")
@covers("DashboardClient", restartSafety="drives off and the stop forgotten; brakes can be released")
def test_emergency_stop(cell: Cell) -> None:
    dashboard, robot = cell.dashboard, cell.robot
    assert cell.control.moveJ([0.8, -1.6, 1.9, -1.8, -1.6, -2.0], 1.0, 2.0, True)
    robot.until(moving)
    robot.look(ControlBox.press_emergency_stop, True)
    cell.wait(cell.receive.isEmergencyStopped)
    robot.until(has_modes, "ROBOT_EMERGENCY_STOP", "POWER_OFF", "STOPPED")
    assert dashboard.safetymode() == "Safetymode: ROBOT_EMERGENCY_STOP"
    dashboard.brakeRelease()
    robot.look(ControlBox.press_emergency_stop, False)
    cell.wait(lambda: not cell.receive.isEmergencyStopped())
    assert dashboard.robotmode() == "Robotmode: POWER_OFF"
    dashboard.restartSafety()
    robot.until(has_modes, "NORMAL", "POWER_OFF")
    dashboard.brakeRelease()
    robot.until(has_modes, "RUNNING")


def shown(box: ControlBox) -> str:
    return box.popup.text if box.popup else ""


@covers(
    "DashboardClient",
    popup="a window on the pendant",
    closePopup="it is gone",
    addToLog="a line of the box's log",
)
def test_what_the_operator_sees(cell: Cell) -> None:
    cell.dashboard.popup("Fill the feeder, please")
    cell.robot.until(shown)
    assert cell.robot.look(shown) == "Fill the feeder, please"
    cell.dashboard.closePopup()
    assert cell.robot.look(shown) == ""
    cell.dashboard.addToLog("shift begins")
    assert "log: shift begins" in cell.robot.lines


def identity(box: ControlBox) -> tuple[str, str]:
    return str(box.version), box.serial


def local(box: ControlBox, is_local: bool) -> None:
    box.remote_control = not is_local


@covers(
    "DashboardClient",
    polyscopeVersion="the version that is simulated, as over RTDE",
    getSerialNumber="the box's number",
    getRobotModel="UR3",
    isInRemoteControl="true; false in local control, in which commands are refused",
    send="a line as it is",
    receive="the answer to it",
)
def test_questions(cell: Cell) -> None:
    dashboard = cell.dashboard
    assert (dashboard.polyscopeVersion(), dashboard.getSerialNumber()) == cell.robot.look(identity)
    assert dashboard.getRobotModel() == "UR3"
    assert dashboard.isInRemoteControl()
    cell.robot.look(local, True)
    assert not dashboard.isInRemoteControl()
    dashboard.powerOff()
    assert cell.robot.look(has_modes, "RUNNING")
    cell.robot.look(local, False)
    dashboard.send("get operational mode\n")
    assert dashboard.receive() == "NONE"


def test_user_roles_cannot_be_named_from_python() -> None:
    dashboard = interface("DashboardClient")("127.0.0.1")
    for role in (0, "operator", None):
        with pytest.raises(TypeError):
            dashboard.setUserRole(role)


@covers(
    "DashboardClient",
    connect="greeted",
    isConnected="whether it is",
    disconnect="hung up",
    quit="the controller hangs up, and does nothing else that comes after it",
)
def test_connection(cell: Cell) -> None:
    other = client("DashboardClient", cell.robot.host)
    assert not other.isConnected()
    other.connect()
    assert other.isConnected()
    assert other.running()
    other.disconnect()
    assert not other.isConnected()
    other.connect()
    other.quit()
    with pytest.raises(RuntimeError, match=r"End of file|reset|Broken pipe"):
        other.running()
    other.disconnect()


@covers("DashboardClient", shutdown="the control loop ends in good order")
def test_shutdown() -> None:
    with Robot("empty") as robot:
        dashboard: Any = client("DashboardClient", robot.host)
        dashboard.connect(10_000)
        dashboard.shutdown()
        robot._process.join(30)
        assert robot._process.exitcode == 0
        dashboard.disconnect()
