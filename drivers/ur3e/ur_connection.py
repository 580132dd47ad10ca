"""The wires to a UR e-Series controller through ur-rtde: connected, checked, and closed again.

ur-rtde's objects may each be used by one thread at a time. Those that only read or send (receive, IO) belong to the
arm's own loop; those that wait for an answer (control, dashboard) are called through `Caller`, and the loop goes on.
"""

from __future__ import annotations

import contextlib
import ctypes
import queue
import re
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import import_module
from types import ModuleType
from typing import Any

from runtime.clock import Stopwatch, pause
from runtime.errors import ArmError, PluginError

OLDEST = (5, 10)  # PolyScope
CONNECT_TIMEOUT = 2000  # [ms]
POWER_TIMEOUT = 60.0  # [s] from power off to released brakes
CLOSE_TIMEOUT = 3.0  # [s]
PLAYING = 2  # runtime state, RTDE guide
ANSWER_REGISTER = 19  # output integer register in which a cell's controller answers; ur-rtde reads 12 to 19

# Names out of ur-rtde's own table only: one that it does not know shifts all that follow it in a package.
_RECIPE = [
    "timestamp",
    "actual_q",
    "actual_qd",
    "target_q",
    "target_qd",
    "target_moment",
    "actual_TCP_pose",
    "actual_TCP_speed",
    "actual_TCP_force",
    "target_TCP_pose",
    "ft_raw_wrench",
    "actual_digital_input_bits",
    "actual_digital_output_bits",
    "robot_mode",
    "safety_mode",
    "speed_scaling",
    "target_speed_fraction",
    "runtime_state",
    "payload",
    "payload_cog",
    f"output_int_register_{ANSWER_REGISTER}",
]
_MODULES = ("dashboard_client", "rtde_receive", "rtde_io", "rtde_control")


class ConnectionLostError(ArmError):
    """The controller cannot be heard any more."""


@dataclass
class Call:
    """One call under way in another thread."""

    function: Callable[[], Any]
    result: Any = None
    error: Exception | None = None
    _done: threading.Event = field(default_factory=threading.Event)

    def run(self) -> None:
        """Make the call, and keep what comes of it."""
        try:
            self.result = self.function()
        except Exception as error:  # ur-rtde raises whatever its sockets do
            self.error = error
        self._done.set()

    def wait(self, timeout: float = 0.0) -> bool:
        """Whether the call has returned, after `timeout` [s] at the latest."""
        return self._done.wait(timeout)


class Caller:
    """Makes calls that wait, one after another, in a thread of its own. The thread does not outlive the process."""

    def __init__(self) -> None:
        self._calls: queue.SimpleQueue[Call | None] = queue.SimpleQueue()
        self._last: Call | None = None
        threading.Thread(target=self._work, name="ur-rtde calls", daemon=True).start()

    @property
    def idle(self) -> bool:
        """Whether every call has returned."""
        return self._last is None or self._last.wait()

    def submit(self, function: Callable[[], Any]) -> Call:
        """Have a function called."""
        self._last = Call(function)
        self._calls.put(self._last)
        return self._last

    def close(self) -> None:
        """Let the thread end after the call in hand."""
        self._calls.put(None)

    def _work(self) -> None:
        while (call := self._calls.get()) is not None:
            call.run()


@dataclass(frozen=True)
class Sample:
    """One control cycle as RTDE delivered it. Units and frames are UR's."""

    timestamp: float  # [s] controller time
    actual_q: list[float]
    actual_qd: list[float]
    target_q: list[float]
    target_qd: list[float]
    target_moment: list[float]
    actual_tcp_pose: list[float]
    actual_tcp_speed: list[float]
    actual_tcp_force: list[float]
    target_tcp_pose: list[float]
    raw_wrench: list[float]
    digital_inputs: int  # bits
    digital_outputs: int  # bits
    robot_mode: int
    safety_mode: int
    speed_scaling: float  # by the trajectory's limits
    speed_fraction: float  # the speed slider
    runtime_state: int
    payload: float  # [kg]
    payload_centre: list[float]  # (3,) [m]
    answer: int  # of the cell's controller


def _sample(receive: Any) -> Sample:
    return Sample(
        receive.getTimestamp(),
        receive.getActualQ(),
        receive.getActualQd(),
        receive.getTargetQ(),
        receive.getTargetQd(),
        receive.getTargetMoment(),
        receive.getActualTCPPose(),
        receive.getActualTCPSpeed(),
        receive.getActualTCPForce(),
        receive.getTargetTCPPose(),
        receive.getFtRawWrench(),
        receive.getActualDigitalInputBits(),
        receive.getActualDigitalOutputBits(),
        receive.getRobotMode(),
        receive.getSafetyMode(),
        receive.getSpeedScaling(),
        receive.getTargetSpeedFraction(),
        receive.getRuntimeState(),
        receive.getPayload(),
        receive.getPayloadCog(),
        receive.getOutputIntRegister(ANSWER_REGISTER),
    )


class UrConnection:
    """ur-rtde's four interfaces to one controller, connected and checked. Raises ArmError that says what to do."""

    def __init__(self, address: str, *, power_on: bool = False) -> None:
        modules = {name: _module(name) for name in _MODULES}
        self.address = address
        self.caller = Caller()
        self.dashboard = self._open(lambda: _dashboard(modules["dashboard_client"], address))
        self._parts: list[Any] = [self.dashboard]
        try:
            self.version = self._checked_version()
            self.serial: str = self.dashboard.getSerialNumber()
            self._check_remote_control()
            self._check_safety()
            if power_on:
                self._power_on()
            self._check_robot_mode(power_on)
            self.receive = self._open(lambda: modules["rtde_receive"].RTDEReceiveInterface(address, 500.0, _RECIPE))
            self._parts.append(self.receive)
            self.io = self._open(lambda: modules["rtde_io"].RTDEIOInterface(address))
            self._parts.append(self.io)
            self.control = self._open(lambda: modules["rtde_control"].RTDEControlInterface(address, 500.0))
            self._parts.append(self.control)
        except Exception as error:
            self._disconnect()
            if isinstance(error, ArmError):
                raise
            raise ArmError(f"{address} does not answer as a UR controller does: {error}") from None

    @property
    def connected(self) -> bool:
        """Whether all is connected that has been.

        ur-rtde's control interface connects again by itself, each time with one thread more and no end to it.
        """
        return bool(self.receive.isConnected() and self.control.isConnected())

    def sample(self) -> Sample:
        """The latest control cycle. A cycle that arrives meanwhile does not mix with it."""
        while True:
            sample = _sample(self.receive)
            if self.receive.getTimestamp() == sample.timestamp:
                return sample

    def close(self, speed_fraction: float) -> None:
        """Stop the control program, so that nothing moves, then leave the speed slider at a fraction and hang up."""
        stop = self.caller.submit(self._stop_program)
        if stop.wait(CLOSE_TIMEOUT) and self.receive.isConnected():
            with contextlib.suppress(Exception):
                self.io.setSpeedSlider(speed_fraction)
        self._disconnect()

    def _stop_program(self) -> None:
        if self.control.isConnected() and self.control.isProgramRunning():
            self.control.stopScript()

    def _open(self, make: Callable[[], Any]) -> Any:
        try:
            return make()
        except Exception as error:  # ur-rtde raises whatever its sockets do
            raise ArmError(f"no connection to {self.address}: {_first_line(error)}") from None

    def _disconnect(self) -> None:
        def hang_up() -> None:
            for part in reversed(self._parts):
                try:
                    part.disconnect()
                except Exception:  # ur-rtde raises whatever its sockets do
                    _keep(part)

        if not self.caller.submit(hang_up).wait(CLOSE_TIMEOUT):
            for part in self._parts:
                _keep(part)
        self.caller.close()

    def _checked_version(self) -> str:
        version: str = self.dashboard.polyscopeVersion()
        found = re.match(r"(\d+)\.(\d+)", version)
        if found is None or (int(found[1]), int(found[2])) < OLDEST:
            oldest = ".".join(map(str, OLDEST))
            raise ArmError(f"{self.address} runs PolyScope {version!r}; {oldest} or later of an e-Series is needed")
        return version

    def _check_remote_control(self) -> None:
        if not self.dashboard.isInRemoteControl():
            raise ArmError(f"{self.address} is in local control: switch the robot to remote control on its pendant")

    def _power_on(self) -> None:
        """Power on and release the brakes, unless that is done already."""
        if "RUNNING" in self.dashboard.robotmode():
            return
        self.dashboard.powerOn()
        waited, released = Stopwatch(), False
        while "RUNNING" not in (mode := self.dashboard.robotmode()):
            if "IDLE" in mode and not released:
                self.dashboard.brakeRelease()
                released = True
            if waited.seconds > POWER_TIMEOUT:
                raise ArmError(f"{self.address} did not power on within {POWER_TIMEOUT:g} s: {mode}")
            pause(0.1)

    def _check_safety(self) -> None:
        status: str = self.dashboard.safetystatus()
        if not status.endswith("NORMAL"):
            raise ArmError(f"{self.address} is not in normal mode ({status}): clear it on the pendant")

    def _check_robot_mode(self, power_on: bool) -> None:
        mode: str = self.dashboard.robotmode()
        if not mode.endswith("RUNNING"):
            hint = "" if power_on else ", or set power_on = true"
            raise ArmError(
                f"{self.address} is not ready to move ({mode}): power the arm on and release its brakes{hint}"
            )


def _keep(part: Any) -> None:
    """Keep an object of ur-rtde for ever: its destructor would end the process over a connection that broke."""
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(part))


def _module(name: str) -> ModuleType:
    try:
        return import_module(name)
    except ImportError as error:
        raise PluginError(f"driver 'ur_rtde' needs ur-rtde: pip install 'palpate[ur]' ({error})") from None


def _dashboard(module: ModuleType, address: str) -> Any:
    client = module.DashboardClient(address)
    client.connect(CONNECT_TIMEOUT)
    return client


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]
