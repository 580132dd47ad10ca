"""Modes of an e-Series control box, with the numbers and bits that UR's RTDE guide gives them."""

from __future__ import annotations

from enum import IntEnum


class RobotMode(IntEnum):
    """What the arm is able to do."""

    NO_CONTROLLER = -1
    DISCONNECTED = 0
    CONFIRM_SAFETY = 1
    BOOTING = 2
    POWER_OFF = 3
    POWER_ON = 4
    IDLE = 5
    BACKDRIVE = 6
    RUNNING = 7
    UPDATING_FIRMWARE = 8


class SafetyMode(IntEnum):
    """Why the arm may or may not move."""

    NORMAL = 1
    REDUCED = 2
    PROTECTIVE_STOP = 3
    RECOVERY = 4
    SAFEGUARD_STOP = 5
    SYSTEM_EMERGENCY_STOP = 6
    ROBOT_EMERGENCY_STOP = 7
    VIOLATION = 8
    FAULT = 9


class RuntimeState(IntEnum):
    """What the program is doing."""

    STOPPING = 0
    STOPPED = 1
    PLAYING = 2
    PAUSING = 3
    PAUSED = 4
    RESUMING = 5


class JointMode(IntEnum):
    """State of one joint."""

    POWER_OFF = 239
    IDLE = 255
    RUNNING = 253
    BACKDRIVE = 238


_SAFETY_BIT = {
    SafetyMode.NORMAL: 0,
    SafetyMode.REDUCED: 1,
    SafetyMode.PROTECTIVE_STOP: 2,
    SafetyMode.RECOVERY: 3,
    SafetyMode.SAFEGUARD_STOP: 4,
    SafetyMode.SYSTEM_EMERGENCY_STOP: 5,
    SafetyMode.ROBOT_EMERGENCY_STOP: 6,
    SafetyMode.VIOLATION: 8,
    SafetyMode.FAULT: 9,
}
_EMERGENCY = (SafetyMode.SYSTEM_EMERGENCY_STOP, SafetyMode.ROBOT_EMERGENCY_STOP)
_MOVING = (SafetyMode.NORMAL, SafetyMode.REDUCED, SafetyMode.RECOVERY)


def safety_status_bits(mode: SafetyMode) -> int:
    """Bits 0-10 of RTDE's safety_status_bits: the mode's own, 7 for any emergency stop, 10 for any stop."""
    bits = 1 << _SAFETY_BIT[mode]
    if mode in _EMERGENCY:
        bits |= 1 << 7
    if mode not in _MOVING:
        bits |= 1 << 10
    return bits


def robot_status_bits(robot: RobotMode, running: bool, teach: bool, power_button: bool) -> int:
    """Bits 0-3 of RTDE's robot_status_bits: power on, program running, teach button, power button."""
    powered = robot >= RobotMode.POWER_ON
    return powered | running << 1 | teach << 2 | power_button << 3
