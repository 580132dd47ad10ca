"""palpate robot: a simulated UR controller on its network ports, shown in the terminal, led by an operator's words."""

from __future__ import annotations

import argparse
import contextlib
import ipaddress
import json
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

from rich.console import Console
from rich.live import Live
from rich.markup import escape
from rich.table import Table

from runtime import config, roles
from runtime.commands.curtain_wire import CurtainWire
from runtime.commands.launch import viewer_mode
from runtime.config import CellFile, redacted
from runtime.crew import Crew
from runtime.errors import InputError, SessionError
from runtime.network.meeting_point import MeetingPoint
from runtime.network.zenoh_bus import ZenohRouter
from runtime.roles import Assignment

EMPTY = "empty"
PORTS = {
    "rtde": "RTDE",
    "dashboard": "dashboard server",
    "primary": "primary interface, scripts",
    "secondary": "secondary interface, scripts",
    "realtime": "real-time interface, scripts",
}
_CLOSE_TIMEOUT = 10.0  # [s]


@dataclass
class Controller:
    """The controller's process, and what it says."""

    process: subprocess.Popen[str]
    said: SimpleQueue[dict[str, Any] | None] = field(default_factory=SimpleQueue)  # None: it has ended

    def listen(self) -> None:
        """Read what it says, until it ends."""
        assert self.process.stdout is not None
        for line in self.process.stdout:
            with contextlib.suppress(ValueError):
                self.said.put(json.loads(line))
        self.said.put(None)

    def tell(self, line: str) -> None:
        """Hand on an operator's words."""
        assert self.process.stdin is not None
        with contextlib.suppress(OSError, ValueError):
            self.process.stdin.write(line.rstrip("\n") + "\n")
            self.process.stdin.flush()

    def end(self) -> None:
        """Close its input, which ends it."""
        with contextlib.suppress(OSError):
            if self.process.stdin is not None:
                self.process.stdin.close()
        try:
            self.process.wait(_CLOSE_TIMEOUT)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()


def robot_command(arguments: argparse.Namespace) -> int:
    """Serve until Ctrl-C, `quit`, or a dashboard client's `shutdown`."""
    overrides: dict[str, Any] = {} if arguments.seed is None else {"seed": arguments.seed}
    cell_file = config.load(config.DEFAULT_CELL if arguments.scene == EMPTY else arguments.scene, overrides)
    module = getattr(config.robot_of(cell_file.cell, cell_file.name), "controller", None)
    if module is None:
        raise InputError(f"{cell_file.name}: robot = {cell_file.cell.robot!r} is not simulated; nothing can be served")
    folder = Path(arguments.programs) if arguments.programs else None
    if folder is not None and not folder.is_dir():
        raise InputError(f"--programs {folder} is no folder")
    mode = viewer_mode(arguments.rerun)
    console = Console()
    _warn_of(arguments.host, console)
    with contextlib.ExitStack() as stack:
        port = 0
        if mode is not None:
            port = _watch(stack, cell_file, mode, arguments)
        order = {
            "document": cell_file.document,
            "where": cell_file.name,
            "host": arguments.host,
            "polyscope": arguments.polyscope,
            "empty": arguments.scene == EMPTY,
            "programs": str(folder.resolve()) if folder else "",
            "bus_port": port,
        }
        controller = stack.enter_context(_started(module, order))
        if arguments.curtain is not None:
            wire = CurtainWire(replace(cell_file.meeting_point, port=arguments.curtain), controller.tell)
            stack.callback(wire.close)
        _follow(controller, arguments, console)
    return 0


def _warn_of(host: str, console: Console) -> None:
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        raise InputError(f"--host {host!r} is no IP address; write one, such as 127.0.0.1 or 0.0.0.0") from None
    if not address.is_loopback:
        console.print(
            f"warning: listening on {host}: whoever reaches this machine there can run programs on the simulated robot",
            style="yellow",
            highlight=False,
            soft_wrap=True,
        )


def _watch(stack: contextlib.ExitStack, cell_file: CellFile, mode: str, arguments: argparse.Namespace) -> int:
    """Start a router and a viewer on it; tells the router's port."""
    bus = cell_file.cell.bus
    port: int = arguments.port
    router = stack.enter_context(ZenohRouter(MeetingPoint(port, bus.domain)))
    crew = stack.enter_context(Crew())
    path = "robot.rrd" if mode == "save" else ""
    document = redacted(cell_file.document, roles.VIEWER)
    if arguments.scene == EMPTY:
        document["board"] = {**document["board"], "holes": []}
    options = {"mode": mode, "path": path}
    crew.start(Assignment(roles.VIEWER, "robot", document, cell_file.name, port, bus.domain, options))
    crew.wait_until_ready(router.wait_for)
    stack.callback(crew.close)
    return port


@contextlib.contextmanager
def _started(module: str, order: dict[str, Any]) -> Iterator[Controller]:
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", module],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,  # Ctrl-C reaches this process alone, which ends the other
    )
    controller = Controller(process)
    try:
        controller.tell(json.dumps(order))
        threading.Thread(target=controller.listen, daemon=True).start()
        yield controller
    finally:
        controller.end()


def _follow(controller: Controller, arguments: argparse.Namespace, console: Console) -> None:
    """Show what the controller says until it ends. Raises InputError or SessionError with its last words."""
    threading.Thread(target=_hand_on, args=(sys.stdin, controller), daemon=True).start()
    state: dict[str, Any] = {}
    live = Live(console=console, auto_refresh=False, transient=True)
    with live if sys.stdout.isatty() else contextlib.nullcontext():
        while True:
            try:
                item = controller.said.get(timeout=0.5)
            except Empty:
                continue
            if item is None:
                code = controller.process.wait()
                if code:
                    raise SessionError(f"the controller ended with code {code}")
                return
            if "error" in item:
                raise (InputError if item["wrong_input"] else SessionError)(item["error"])
            if "ports" in item:
                _announce(item, arguments, console)
            elif "log" in item:
                console.print(item["log"], highlight=False, markup=False, soft_wrap=True)
            elif "end" in item and item["end"]["cycles"]:
                late = item["end"]["overruns"]
                console.print(f"ended after {item['end']['cycles'] * 0.002:.1f} s, {late} late cycles", highlight=False)
            elif "state" in item:
                state = item["state"]
                live.update(_table(state), refresh=sys.stdout.isatty())


def _hand_on(stream: Any, controller: Controller) -> None:
    """What is typed goes to the controller. The end of the input does not end it: it may run without a terminal."""
    for line in stream:
        controller.tell(line)


def _announce(item: dict[str, Any], arguments: argparse.Namespace, console: Console) -> None:
    lines = [f"simulated UR3e, PolyScope {item['version']}, scene {arguments.scene}, on {arguments.host}:"]
    lines += [f"  {item['ports'][name]:>5}  {what}" for name, what in PORTS.items()]
    lines.append("type `help` for the operator's panel; Ctrl-C ends")
    console.print("\n".join(lines), highlight=False, markup=False, soft_wrap=True)


def _table(state: dict[str, Any]) -> Table:
    table = Table(box=None, show_header=False, pad_edge=False)
    program = f"{state['runtime_state'].lower()} {state['program']}".strip()
    clients = ", ".join(f"{count} {name}" for name, count in state["clients"].items() if count) or "none"
    x, y, z = state["tcp_mm"]
    force = state["force_N"]
    rows = {
        "controller": f"{state['time']:.1f} s, {state['overruns']} late cycles"
        + (", real-time priority" if state["real_time"] else ""),
        "robot": f"{state['robot_mode'].lower()}, safety {state['safety_mode'].lower().replace('_', ' ')}",
        "program": f"{program}, speed {state['speed']:.0%}",
        "message": escape(state["message"]),
        "joints": "  ".join(f"{angle:7.2f}" for angle in state["q_deg"]) + "  deg",
        "TCP": f"{x:8.2f} {y:8.2f} {z:8.2f}  mm in base",
        "force": f"{force[0]:8.2f} {force[1]:8.2f} {force[2]:8.2f}  N"
        + ("   holding a part" if state["holding"] else ""),
        "clients": clients,
    }
    for name, value in rows.items():
        table.add_row(name, value)
    return table
