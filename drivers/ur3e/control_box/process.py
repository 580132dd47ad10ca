"""The process of a simulated controller: an order on the first line of standard input, an operator's words after it.

It has a process of its own so that nothing that is drawn or printed can disturb the control loop. Standard output
tells, as JSON lines: `ports` once it listens, `log` for what happens, `state` a few times a second. What the reader
does not take is left out rather than waited for. The end of standard input ends the controller.
"""

from __future__ import annotations

import json
import os
import signal
import sys
from pathlib import Path
from typing import Any

from drivers.ur3e.control_box.box import ControlBox, printable
from drivers.ur3e.control_box.panel import operate
from drivers.ur3e.control_box.server import RobotServer
from drivers.ur3e.control_box.simulation import simulated_box
from drivers.ur3e.control_box.version import polyscope
from drivers.ur3e.driver import MujocoUr3e
from drivers.ur3e.parameters import CYCLE
from drivers.ur3e.telemetry import Telemetry
from runtime import roles
from runtime.clock import pause
from runtime.config import Cell, cell_of, robot_of
from runtime.context import Context
from runtime.errors import InputError, PalpateError
from runtime.network.meeting_point import MeetingPoint

_INPUT_CYCLES = 2  # between looks at standard input
_STATE_CYCLES = round(0.2 / CYCLE)
_LINE = 10_000  # [bytes] longer than anything an operator says
_PATIENCE = 1000  # tries to write a line that must arrive


class _Console:
    """Standard input and output, neither of which is waited for."""

    def __init__(self) -> None:
        os.set_blocking(0, False)
        os.set_blocking(1, False)
        self._text = b""
        self.ended = False

    def say(self, **what: Any) -> bool:
        """Write one line; whether it went out. Lines are shorter than a pipe's atomic size."""
        data = json.dumps(what, allow_nan=False).encode() + b"\n"
        try:
            return os.write(1, data) == len(data)
        except OSError:
            return False

    def insist(self, **what: Any) -> None:
        """Write one line that must arrive; for before and after the control loop."""
        for _ in range(_PATIENCE):
            if self.say(**what):
                return
            pause(1e-3)

    def lines(self) -> list[str]:
        """What has been said since."""
        try:
            data = os.read(0, _LINE)
        except BlockingIOError:
            return []
        except OSError:
            data = b""
        if not data:
            self.ended = True
            return []
        *lines, self._text = (self._text + data).split(b"\n")
        self._text = self._text[-_LINE:]
        return [line.decode(errors="replace") for line in lines]


class _Reporter:
    """After every cycle: words in, state out."""

    def __init__(self, console: _Console) -> None:
        self._console = console
        self.context: Context | None = None  # where somebody watches on the bus
        self.telemetry: Telemetry | None = None
        self.server: RobotServer | None = None

    def __call__(self) -> None:
        assert self.server is not None
        server, box, console = self.server, self.server.box, self._console
        cycles = server.beat.cycles
        if cycles % _INPUT_CYCLES == 0:
            for line in console.lines():
                _obey(box, line, console)
            if console.ended:
                box.shutdown()
        if cycles % _STATE_CYCLES == 0:
            console.say(state=state_of(server))
        if self.telemetry is not None:
            self.telemetry(box.arm)

    def log(self, text: str) -> None:
        """Say what happens, on the bus too."""
        self._console.say(log=text)
        if self.context is not None and self.server is not None:
            self.context.clock.advance(self.server.box.arm.time)
            self.context.log(text)


def state_of(server: RobotServer) -> dict[str, Any]:
    """What is worth showing, in the units people read."""
    box, arm = server.box, server.box.arm
    x, y, z, rx, ry, rz = arm.getActualTCPPose()
    return {
        "time": round(box.time, 2),
        "robot_mode": box.robot_mode.name,
        "safety_mode": box.safety_mode.name,
        "runtime_state": box.runtime_state.name,
        "program": box.program_name,
        "message": printable(box.programs.spoken[-1][:80]) if box.programs.spoken else "",
        "speed": round(box.speed_scaling * box.speed_slider, 3),
        "q_deg": [round(angle * 57.29577951308232, 2) for angle in arm.getActualQ()],
        "tcp_mm": [round(1e3 * value, 3) for value in (x, y, z)],
        "tcp_rotation": [round(value, 4) for value in (rx, ry, rz)],
        "force_N": [round(value, 2) for value in arm.getActualTCPForce()[:3]],
        "holding": arm.holding,
        "clients": {
            name: server.ports.peers(name) for name in ("rtde", "dashboard", "primary", "secondary", "realtime")
        },
        "real_time": server.real_time,
        "overruns": server.beat.overruns,
        "cycles": server.beat.cycles,
    }


def _obey(box: ControlBox, line: str, console: _Console) -> None:
    try:
        done = operate(box, line)
    except InputError as error:
        done = str(error)
    if done:
        console.say(log=done)


def _serve(order: dict[str, Any], console: _Console) -> None:
    cell: Cell = cell_of(order["document"], order["where"])
    robot = robot_of(cell, order["where"])
    if not isinstance(robot, MujocoUr3e):
        raise InputError(f"{order['where']}: robot = {cell.robot!r} is not simulated; only mujoco_ur3e can be served")
    reporter = _Reporter(console)
    box = simulated_box(
        robot.setup(),
        cell,
        version=polyscope(order["polyscope"]),
        empty=order["empty"],
        log=reporter.log,
        programs_folder=Path(order["programs"]) if order["programs"] else None,
    )
    context: Context | None = None
    if order["bus_port"]:
        from runtime.network.zenoh_bus import ZenohBus

        point = MeetingPoint(order["bus_port"], cell.bus.domain)
        context = Context(roles.ARM, ZenohBus(roles.ARM, point), cell, "robot")
        telemetry = Telemetry(context)
        telemetry.activity = "robot"
        context.ready()
        telemetry.describe()
        reporter.context, reporter.telemetry = context, telemetry
    server = RobotServer(box, order["host"], after_cycle=reporter)
    reporter.server = server
    signal.signal(signal.SIGTERM, lambda _number, _frame: server.stop())
    numbers = server.numbers
    console.insist(ports=vars(numbers), version=str(box.version))
    try:
        server.run()
    finally:
        if context is not None:
            context.close()
            context.bus.close()
    console.insist(end={"cycles": server.beat.cycles, "overruns": server.beat.overruns})


def _first_line() -> bytes:
    """Byte by byte, so that nothing that follows is taken along."""
    line = b""
    while (byte := os.read(0, 1)) not in (b"", b"\n"):
        line += byte
    return line


def main() -> int:
    """Entry point of the process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for whoever started us, and ends our input
    order = json.loads(_first_line())
    console = _Console()
    try:
        _serve(order, console)
    except PalpateError as error:
        console.insist(error=str(error), wrong_input=isinstance(error, InputError))
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
