"""ur-rtde's four clients on one simulated controller, and the controller as it was before the last test.

The functions of a box run in the controller's process, between two control cycles (see `robots`).
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from robots import PATIENCE, Robot
from ur_rtde_methods import Watched, interface

from drivers.ur3e import frames
from drivers.ur3e.arm import NORMAL, PROTECTIVE_STOP
from drivers.ur3e.control_box.box import ControlBox
from drivers.ur3e.parameters import GRIPPER
from drivers.ur3e.workcell import Workcell

HOME = list(Workcell().home)  # [rad]
FAST = (3.0, 10.0)  # [rad/s], [rad/s^2] for what is not being tested
_TRAIL = 4000  # control cycles


@dataclass
class Cell:
    """One controller and its clients."""

    robot: Robot
    dashboard: Any
    receive: Any
    control: Any
    io: Any

    def wait(self, condition: Callable[[], object], patience: float = PATIENCE) -> Any:
        """Wait until clients see something; what they see."""
        deadline = time.monotonic() + patience
        while not (found := condition()):
            assert time.monotonic() < deadline, "clients did not see it"
            time.sleep(0.002)
        return found

    def in_step(self) -> None:
        """Wait until the clients have what the controller sent after this moment."""
        now = self.robot.look(clock)
        self.wait(lambda: self.receive.getTimestamp() > now)


def client(name: str, *arguments: object) -> Any:
    """A client that notes what is used of it."""
    return Watched(name, interface(name)(*arguments))


@contextmanager
def connected(robot: Robot) -> Iterator[Cell]:
    """Start a controller and connect to it."""
    with robot:
        robot.look(follow)
        dashboard = client("DashboardClient", robot.host)
        dashboard.connect(10_000)
        receive = client("RTDEReceiveInterface", robot.host)
        control = client("RTDEControlInterface", robot.host)
        io = client("RTDEIOInterface", robot.host)
        try:
            yield Cell(robot, dashboard, receive, control, io)
        finally:
            for part in (io, control, receive, dashboard):
                part.disconnect()


def restored(cell: Cell) -> Cell:
    """The cell with the arm at home, the control script running, and nothing left of the test before."""
    robot, control = cell.robot, cell.control
    if robot.look(reset) or not control.isProgramRunning():
        robot.look(stop)
        cell.wait(lambda: not control.isProgramRunning())
        control.reuploadScript()
        cell.wait(control.isProgramRunning)
    if robot.look(away, HOME) > 1e-9:
        assert control.moveJ(HOME, *FAST)
    robot.until(standing)
    robot.look(begin_trail)
    cell.in_step()
    return cell


# What happens in the controller's process.

_trail: deque[dict[str, Any]] = deque(maxlen=_TRAIL)


def follow(box: ControlBox) -> None:
    """Keep what the physics does in every cycle from now on, by the time stamp under which clients are told."""
    permits = box.arm.gate
    arm = box.arm

    def note(now: int) -> bool:
        controller = arm.controller
        _trail.append(
            {
                "time": box.time,
                "q": arm.getActualQ(),
                "qd": arm.getActualQd(),
                "target_q": controller.q.tolist(),
                "target_qd": list(controller.qd),
                "position": controller.position,
                "twist": controller.twist(),
                "raw": arm.sensor.raw[:],
                "torque": arm.getJointTorques(),
                "scaling": controller.scaling,
                "execution": box.execution_time,
            }
        )
        return permits(now)

    arm.gate = note


def clock(box: ControlBox) -> float:
    """Controller time [s]."""
    return box.time


def begin_trail(box: ControlBox) -> None:
    """Forget the cycles up to now."""
    _trail.clear()


def trail(box: ControlBox) -> list[dict[str, Any]]:
    """Every cycle since `begin_trail`, but not more than 8 s."""
    return list(_trail)


def cycle_at(box: ControlBox, timestamp: float) -> list[dict[str, Any]]:
    """The cycle of a time stamp, and the one before; nothing yet if it has only just been."""
    cycles = list(_trail)
    found = [index for index, cycle in enumerate(cycles) if abs(cycle["time"] - timestamp) < 1e-6]
    return [cycles[found[0]], cycles[found[0] - 1]] if found and found[0] else []


def reset(box: ControlBox) -> bool:
    """Take back what tests set; whether the program has to be taken back too, since something still moves."""
    arm = box.arm
    arm.scene.push([0.0] * 6)
    box.press_emergency_stop(False)
    box.open_safeguard(False)
    box.close_popup()
    if arm.safety_mode == PROTECTIVE_STOP:
        arm.safety_mode = NORMAL  # without the 5 s that a client has to wait
        box.stop()
    box.speed_slider = 1.0
    box.external_sensor, box.external_force_torque = False, None
    arm.setTcp([0.0] * 6)
    arm.setPayload(GRIPPER.mass, GRIPPER.centre_of_mass)
    arm.sensor.set_gravity((0.0, 0.0, -1.0))
    box.gravity, box.payload_inertia = [0.0, 0.0, 9.82], [0.0] * 6
    return not arm.controller.idle or arm.controller.compliance is not None or box.programs.watchdog is not None


def stop(box: ControlBox) -> None:
    """End the program."""
    box.stop()


def away(box: ControlBox, q: list[float]) -> float:
    """[rad] how far the commanded joints are from angles."""
    return max(abs(a - b) for a, b in zip(box.arm.getTargetQ(), q, strict=True))


def standing(box: ControlBox) -> bool:
    """Whether nothing moves, and what begins to move will do so at full speed."""
    return box.steady and box.arm.controller.idle and box.arm.controller.scaling == box.speed_slider


def joints(box: ControlBox) -> list[float]:
    """Measured joint angles [rad]."""
    return box.arm.getActualQ()


def tip(box: ControlBox) -> list[float]:
    """Measured pose of the TCP, in UR's base."""
    return frames.ur_pose(*box.arm.pose)


def push(box: ControlBox, wrench: list[float]) -> None:
    """Push at the gripper with a wrench (6,) in base_link."""
    box.arm.scene.push(wrench)


def modes(box: ControlBox) -> tuple[str, str, str]:
    """Robot mode, safety mode, runtime state."""
    return box.robot_mode.name, box.safety_mode.name, box.runtime_state.name


def has_modes(box: ControlBox, *wanted: str) -> bool:
    """Whether all of these are among the modes."""
    return set(wanted) <= set(modes(box))
