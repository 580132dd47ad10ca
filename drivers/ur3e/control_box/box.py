"""The control box: one arm, its safety, its programs, its inputs and outputs; a step each 2 ms. No socket in sight.

    a cycle:  programs (a step of every URScript thread) -> controller -> physics -> sensors -> what clients read

Everything happens in the thread that calls `cycle`. What the box has to say to the operator goes
to `log`, line by line.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from drivers.ur3e import frames
from drivers.ur3e.arm import GRIPPER_PIN
from drivers.ur3e.compliance import hand_guided
from drivers.ur3e.control_box.electrics import Electrics
from drivers.ur3e.control_box.events import ErrorCode, Event, Popup, SafetyModeChanged
from drivers.ur3e.control_box.modes import RobotMode, RuntimeState, SafetyMode
from drivers.ur3e.control_box.programs import LoadResult, Programs
from drivers.ur3e.control_box.registers import Registers, Wiring
from drivers.ur3e.control_box.safety import SafetyBoard
from drivers.ur3e.control_box.version import PolyScope
from drivers.ur3e.simulated_arm import SimulatedArm
from runtime.clock import Stopwatch
from runtime.errors import ArmError
from runtime.messages import NANOSECONDS

SERIAL = "20245300001"
BOOT_TIME = 60.0  # [s] UR's C++ client waits until a controller has been up for 40 s
TOOL_OUTPUT = 16  # bit of the tool's first digital output
TOOL_SPEED_LIMIT = 3.0  # [m/s] assumed: least restricted safety limits
_PROTECTIVE_STOP = 209  # C209: a protective stop was triggered
_HISTORY = 1500  # cycles of joint positions that a program can ask for
_STANDING = 1e-4  # [rad/s]
# Assumed: PolyScope hears of a program's end this late. ur-rtde stops its script itself and at once asks the dashboard
# to stop it, and does not bear to hear that there is nothing to stop.
_NOTICED = 1.0  # [s]


class ControlBox:
    """See the module's text. `stage` is called before every cycle: the cell around the arm."""

    def __init__(
        self,
        arm: SimulatedArm,
        *,
        version: PolyScope = PolyScope(),  # noqa: B008 - frozen
        log: Callable[[str], None] = lambda _line: None,
        stage: Callable[[ControlBox], None] = lambda _box: None,
        programs_folder: Path | None = None,
        seed: int = 0,
    ) -> None:
        self.arm = arm
        self.version, self.serial = version, SERIAL
        self.log: Callable[[str], None] = lambda text: log(printable(text))
        self.electrics = Electrics(arm)
        self.registers, self.wiring = Registers(), Wiring()
        self.safety = SafetyBoard(arm)
        arm.gate = self.safety.permits
        self.speed_slider = 1.0
        self.boot_time = BOOT_TIME
        self.execution_time = 0.0  # [s] of machine time for the last cycle
        self.events: deque[Event] = deque(maxlen=1000)
        self.popup: Popup | None = None
        self.remote_control = True
        self.operational_mode = "NONE"
        self.external_force_torque: list[float] | None = None  # (6,) [N, Nm] as an RTDE client reports it
        self.external_sensor = False  # whether a program has asked for it in place of the arm's own sensor
        self.gravity = [0.0, 0.0, 9.82]  # [m/s^2] as a program says the arm is mounted
        self.payload_inertia = [0.0] * 6  # [kg m^2] as told
        self.fed: Mapping[str, int] = {}  # packages in which each RTDE input came; the RTDE port's own count
        self.history: deque[list[float]] = deque(maxlen=_HISTORY)  # joint angles, latest last
        self.ended = False  # somebody asked for a shutdown
        self._stage = stage
        self._safety_mode = SafetyMode.NORMAL
        self._tool_output = False
        self.programs = Programs(self, programs_folder, seed)
        self.history.append(arm.getActualQ())

    # What clients read

    @property
    def time(self) -> float:
        """Controller time [s], RTDE's `timestamp`."""
        return self.boot_time + self.arm.time / NANOSECONDS

    @property
    def robot_mode(self) -> RobotMode:
        """State of drives and brakes."""
        return self.safety.power.mode

    @property
    def safety_mode(self) -> SafetyMode:
        """What, if anything, stops the arm."""
        return self.safety.mode

    @property
    def runtime_state(self) -> RuntimeState:
        """State of the program."""
        return self.programs.state

    @property
    def program_name(self) -> str:
        """Name of the program that runs or ran last."""
        return self.programs.name

    @property
    def loaded_program(self) -> str:
        """File that was loaded last."""
        return self.programs.loaded

    @property
    def speed_scaling(self) -> float:
        """Share 0..1 of the speed that program and slider ask for; below 1 in and after a stop."""
        return min(1.0, self.arm.controller.scaling / self.speed_slider) if self.speed_slider > 0 else 1.0

    @property
    def teaching(self) -> bool:
        """Whether the arm can be led by hand."""
        compliance = self.arm.controller.compliance
        return compliance is not None and compliance.dead_zone is not None

    # The cycle

    def cycle(self) -> None:
        """One control cycle."""
        watch = Stopwatch()
        self._stage(self)
        self.safety.advance()
        self.programs.advance()
        self._wire()
        arm = self.arm
        arm.controller.slider = self.speed_slider
        arm.held = self.programs.paused
        self.electrics.powered = self.robot_mode >= RobotMode.POWER_ON
        self.electrics.released = self.robot_mode == RobotMode.RUNNING
        self.electrics.tool_voltage = self.wiring.tool_voltage
        arm.sensor.external = self.external_force_torque if self.external_sensor else None
        try:
            arm.cycle()
        except ArmError as error:
            arm.protective_stop(str(error))
        if any(arm.controller.qd) and arm.safety_mode == SafetyMode.NORMAL:
            x, y, z = arm.controller.twist()[:3]
            if x * x + y * y + z * z > TOOL_SPEED_LIMIT * TOOL_SPEED_LIMIT:
                arm.protective_stop(f"the tool exceeds {TOOL_SPEED_LIMIT:g} m/s")
        self.electrics.advance()
        self.history.append(arm.getActualQ())
        self._notice_stops()
        self.execution_time = watch.seconds

    def _wire(self) -> None:
        """The gripper hangs on the tool's first digital output."""
        on = bool(self.wiring.digital_out >> TOOL_OUTPUT & 1)
        if on != self._tool_output:
            self._tool_output = on
            self.arm.setToolDigitalOut(GRIPPER_PIN, on)

    def _notice_stops(self) -> None:
        mode = self.safety_mode
        if mode == self._safety_mode:
            return
        self._safety_mode = mode
        text = self.arm.stop_reason if mode == SafetyMode.PROTECTIVE_STOP else ""
        self.events.append(SafetyModeChanged(mode, text))
        self.log(f"safety mode {mode.name.lower().replace('_', ' ')}" + (f": {text}" if text else ""))
        if mode == SafetyMode.PROTECTIVE_STOP:
            self.events.append(ErrorCode(_PROTECTIVE_STOP, 0, text, warning=True))
            self.programs.pause()
        elif mode == SafetyMode.ROBOT_EMERGENCY_STOP:
            self.programs.stop()

    # The operator's buttons and inputs

    def press_emergency_stop(self, pressed: bool) -> None:
        """Press the button, or release it."""
        self.safety.emergency = pressed

    def open_safeguard(self, is_open: bool) -> None:
        """Interrupt the safeguard input, as a light curtain does, or close it."""
        self.safety.safeguard = is_open

    def power_on(self) -> None:
        """Switch the drives on; brakes stay engaged."""
        if not self.safety.emergency and self.robot_mode < RobotMode.IDLE:
            self.safety.power.want(RobotMode.IDLE)

    def power_off(self) -> None:
        """Stop, and switch the drives off."""
        self.programs.stop()
        self.safety.power.want(RobotMode.POWER_OFF)

    def brake_release(self) -> None:
        """Get the arm ready to move, switching it on first if need be."""
        if not self.safety.emergency:
            self.safety.power.want(RobotMode.RUNNING)

    def unlock_protective_stop(self, at_once: bool = False) -> bool:
        """Release a protective stop; False within 5 s of its beginning, unless `at_once`: that wait is PolyScope's."""
        return self.arm.unlockProtectiveStop(at_once and self.safety_mode == SafetyMode.PROTECTIVE_STOP)

    def restart_safety(self) -> None:
        """Begin again with the drives off and every stop forgotten that its cause does not hold up."""
        self.power_off()
        self.arm.unlockProtectiveStop()

    def set_speed_slider(self, fraction: float) -> None:
        """The share 0..1 of the programmed speed at which motions run."""
        self.speed_slider = min(max(fraction, 0.0), 1.0)

    def shutdown(self) -> None:
        """End in good order."""
        self.programs.stop()
        self.ended = True

    # Programs

    def run_script(self, text: str, origin: str) -> None:
        """Run a program; it replaces the one that runs, unless it is a `sec` program, which runs beside it."""
        self.programs.submit(text, origin)

    def load_program(self, name: str) -> LoadResult:
        """Find a program in the programs' folder, for `play`."""
        return self.programs.load(name)

    def play(self) -> bool:
        """Go on with a paused program, or start the loaded one. False if there is none, or the arm cannot move."""
        return self.programs.play()

    def pause(self) -> bool:
        """Pause the program, braking along its path. False if none runs."""
        return self.programs.pause()

    def stop(self) -> bool:
        """End the program. False if none runs, and the pendant has noticed the end of the last one."""
        return self.programs.stop() or self.time - self.programs.ended_at < _NOTICED

    # What stands on the teach pendant

    def show(self, popup: Popup) -> None:
        """Put up a window, in place of one that is there."""
        self.popup = popup
        self.events.append(popup)
        self.log(f"popup: {popup.title + ': ' if popup.title else ''}{popup.text}")

    def show_popup(self, text: str) -> None:
        """Put up a message from the dashboard."""
        self.show(Popup("", text))

    def close_popup(self) -> None:
        """Take the window away."""
        self.popup = None

    def close_safety_popup(self) -> None:
        """Take away the window that a stop has put up: there is none here, the stop itself is the message."""

    def add_to_log(self, text: str) -> None:
        """Write a line of a client's into the log."""
        self.log(f"log: {text}")

    def set_operational_mode(self, mode: str) -> None:
        """Let the dashboard decide about manual and automatic."""
        self.operational_mode = mode

    def clear_operational_mode(self) -> None:
        """Let the operator decide again."""
        self.operational_mode = "NONE"

    # Hand guiding

    def guide_by_hand(self, frame: frames.Rotation = frames.IDENTITY, free: tuple[int, ...] = (1,) * 6) -> None:
        """Let the tool go where it is pushed, along the free axes (6,) of a frame in base_link."""
        self.arm.controller.comply(hand_guided(frame, free))

    def hold(self) -> None:
        """End hand guiding and force mode; the arm stays where it is."""
        self.arm.forceModeStop()

    @property
    def steady(self) -> bool:
        """Whether the arm stands."""
        return not any(self.arm.controller.qd) and bool(np.abs(self.arm.getActualQd()).max() < _STANDING)


def printable(text: str) -> str:
    """Text of a client's as one line that a terminal shows and does not obey."""
    return "".join(character if character.isprintable() else " " for character in text)
