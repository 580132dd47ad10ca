"""A control box that notes what it is told, around a real arm, and a client that keeps what it is sent."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import Enum

from drivers.ur3e.control_box.events import Event
from drivers.ur3e.control_box.modes import RobotMode, RuntimeState, SafetyMode
from drivers.ur3e.control_box.registers import Wiring
from drivers.ur3e.control_box.version import PolyScope
from drivers.ur3e.scene import Scene
from drivers.ur3e.simulated_arm import SimulatedArm
from runtime.cell import Board, Hole
from runtime.component import component


class LoadOutcome(Enum):
    LOADED = 1
    NOT_FOUND = 2
    BROKEN = 3


@dataclass
class SixAxes:
    """Electrical values that can be told apart."""

    joint_current: Sequence[float] = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
    target_current: Sequence[float] = (1.1, 1.2, 1.3, 1.4, 1.5, 1.6)
    target_moment: Sequence[float] = (2.1, 2.2, 2.3, 2.4, 2.5, 2.6)
    joint_temperature: Sequence[float] = (25.5, 25.0, 24.5, 24.0, 23.5, 23.0)
    joint_voltage: Sequence[float] = (48.0, 48.25, 48.5, 48.75, 49.0, 49.25)
    main_voltage: float = 47.5
    robot_voltage: float = 48.0
    robot_current: float = 0.75
    io_current: float = 0.0625
    momentum: float = 0.125
    tool_temperature: float = 29.5
    tool_current: float = 0.03125
    tool_acceleration: Sequence[float] = (0.5, -0.25, 9.75)


def make_arm() -> SimulatedArm:
    return SimulatedArm(Scene(Board("single", (Hole("h1", 0.0, 0.0),)), component("capacitor")), 1, noise=None)


@dataclass
class NotingBox:
    """What a command changes at once is changed; the rest is noted."""

    arm: SimulatedArm = field(default_factory=make_arm)
    version: PolyScope = field(default_factory=PolyScope)
    serial: str = "20245300001"
    electrics: SixAxes = field(default_factory=SixAxes)
    wiring: Wiring = field(default_factory=Wiring)
    robot_mode: RobotMode = RobotMode.RUNNING
    safety_mode: SafetyMode = SafetyMode.NORMAL
    runtime_state: RuntimeState = RuntimeState.STOPPED
    payload_inertia: Sequence[float] = (0.01, 0.02, 0.03, 0.0, 0.0, 0.0)
    speed_slider: float = 0.97
    speed_scaling: float = 0.5
    teaching: bool = False
    execution_time: float = 0.0004
    program_name: str = ""
    loaded_program: str = ""
    operational_mode: str = "NONE"
    remote_control: bool = True
    unlocks: bool = True
    events: deque[Event] = field(default_factory=deque)
    calls: list[str] = field(default_factory=list)
    programs: list[tuple[str, str]] = field(default_factory=list)
    lines: list[str] = field(default_factory=list)

    @property
    def time(self) -> float:
        return 60.0 + self.arm.time * 1e-9

    @property
    def log(self) -> Callable[[str], None]:
        return self.lines.append

    def run_script(self, text: str, origin: str) -> None:
        self.programs.append((text, origin))

    def power_on(self) -> None:
        self.robot_mode = RobotMode.IDLE

    def power_off(self) -> None:
        self.robot_mode = RobotMode.POWER_OFF

    def brake_release(self) -> None:
        self.robot_mode = RobotMode.RUNNING

    def unlock_protective_stop(self, at_once: bool = False) -> bool:  # noqa: ARG002
        if self.unlocks:
            self.safety_mode = SafetyMode.NORMAL
        return self.unlocks

    def restart_safety(self) -> None:
        self.robot_mode = RobotMode.POWER_OFF

    def set_speed_slider(self, fraction: float) -> None:
        self.speed_slider = fraction

    def load_program(self, name: str) -> LoadOutcome:
        if name == "broken.script":
            return LoadOutcome.BROKEN
        if name != "cell/insert.script":
            return LoadOutcome.NOT_FOUND
        self.loaded_program = name
        return LoadOutcome.LOADED

    def play(self) -> bool:
        able = bool(self.loaded_program)
        if able:
            self.runtime_state = RuntimeState.PLAYING
        return able

    def pause(self) -> bool:
        able = self.runtime_state is RuntimeState.PLAYING
        if able:
            self.runtime_state = RuntimeState.PAUSED
        return able

    def stop(self) -> bool:
        able = self.runtime_state is not RuntimeState.STOPPED
        self.runtime_state = RuntimeState.STOPPED
        return able

    def show_popup(self, text: str) -> None:
        self.calls.append(f"popup {text}")

    def close_popup(self) -> None:
        self.calls.append("close popup")

    def close_safety_popup(self) -> None:
        self.calls.append("close safety popup")

    def add_to_log(self, text: str) -> None:
        self.calls.append(f"log {text}")

    def set_operational_mode(self, mode: str) -> None:
        self.operational_mode = mode

    def clear_operational_mode(self) -> None:
        self.operational_mode = "NONE"

    def shutdown(self) -> None:
        self.calls.append("shutdown")


@dataclass
class KeepingPeer:
    name: str = "127.0.0.1:51234"
    backlog: int = 0
    sent: bytearray = field(default_factory=bytearray)
    closed: bool = False

    def send(self, data: bytes) -> None:
        self.sent += data

    def close(self) -> None:
        self.closed = True

    def take(self) -> bytes:
        """What has been sent since this was last asked."""
        data = bytes(self.sent)
        self.sent.clear()
        return data
