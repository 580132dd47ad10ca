"""The arm's own safety functions: emergency stop, safeguard stop, protective stop, and the power that goes with them.

    input                          stop category     afterwards
    emergency stop button          1: brake, then    button released: safety mode normal, power stays off
                                   power off
    safeguard input open           2: brake along    input closed: the same motion goes on
                                   the path, hold
    protective stop (force, speed, 0: at once        unlocked no earlier than 5 s later, the program stays paused
    joint limit, unreachable)

The safety mode shown is that of the first row that applies.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from drivers.ur3e.arm import PROTECTIVE_STOP
from drivers.ur3e.control_box.modes import RobotMode, SafetyMode
from drivers.ur3e.parameters import CYCLE
from drivers.ur3e.simulated_arm import SimulatedArm

# Assumed: how long an arm takes to switch its drives on, and to release its brakes, shortened for those who wait.
SWITCH_ON_TIME, BRAKE_TIME = 0.6, 0.6  # [s]


@dataclass
class Power:
    """The arm's drives and brakes: what is wanted, and how far it is."""

    mode: RobotMode = RobotMode.RUNNING
    _goal: RobotMode = RobotMode.RUNNING
    _left: float = 0.0  # [s] of the step under way

    def want(self, goal: RobotMode) -> None:
        """Head for POWER_OFF, IDLE or RUNNING. Less power is a matter of standing still; more takes its time."""
        self._goal = goal

    def advance(self, standing: bool) -> None:
        """A control cycle passes; power is taken from the drives only once the arm stands."""
        if self._goal == self.mode:
            self._left = 0.0
            return
        if self._goal < self.mode:
            if standing:
                self.mode = self._goal
            return
        if self._left <= 0.0:
            self._left = SWITCH_ON_TIME if self.mode < RobotMode.IDLE else BRAKE_TIME
        self._left -= CYCLE
        if self.mode == RobotMode.POWER_OFF:
            self.mode = RobotMode.POWER_ON
        elif self._left <= 0.0:
            self.mode = RobotMode.IDLE if self.mode == RobotMode.POWER_ON else RobotMode.RUNNING


@dataclass
class SafetyBoard:
    """What the buttons and inputs say, and what follows from it."""

    arm: SimulatedArm
    power: Power = field(default_factory=Power)
    emergency: bool = False  # the button is pressed
    safeguard: bool = False  # the safeguard input is open: somebody is within reach

    @property
    def mode(self) -> SafetyMode:
        """The safety mode that clients see."""
        if self.emergency:
            return SafetyMode.ROBOT_EMERGENCY_STOP
        if self.arm.safety_mode == PROTECTIVE_STOP:
            return SafetyMode.PROTECTIVE_STOP
        if self.safeguard:
            return SafetyMode.SAFEGUARD_STOP
        return SafetyMode.NORMAL

    def permits(self, _time: int) -> bool:
        """Whether the arm may move in the next cycle."""
        return not (self.emergency or self.safeguard) and self.power.mode == RobotMode.RUNNING

    def advance(self) -> None:
        """A control cycle passes."""
        if self.emergency:
            self.power.want(RobotMode.POWER_OFF)
        self.power.advance(standing=not any(self.arm.controller.qd))
