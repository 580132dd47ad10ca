"""Packages of the primary and secondary client interfaces: robot states and robot messages. Big endian.

A package is a size (int32, itself included), a type (uint8) and a body. A robot state's body is a row of sub-packages
that begin the same way; a robot message's begins with a time stamp, a source and the message's type. Layouts are those
of UR's client interface guide. Safety data is left out: its layout is not published.
"""

from __future__ import annotations

import struct
from enum import IntEnum

import numpy as np

from drivers.ur3e.control_box.controller_state import (
    BUILD_DATE,
    DH_A,
    DH_ALPHA,
    DH_D,
    DH_THETA,
    EMERGENCY_STOPS,
    ControllerState,
    joint_mode,
)
from drivers.ur3e.control_box.events import (
    CompileError,
    ErrorCode,
    Event,
    Popup,
    ProgramStarted,
    ProgramStopped,
    RuntimeException,
    SafetyModeChanged,
    TextMessage,
)
from drivers.ur3e.control_box.modes import RobotMode, RuntimeState, SafetyMode
from drivers.ur3e.control_box.version import PolyScope
from drivers.ur3e.parameters import JOINTS, MOVEJ_ACCELERATION, MOVEJ_SPEED, MOVEL_ACCELERATION, MOVEL_SPEED

_ROBOT_STATE, _ROBOT_MESSAGE = 16, 20
_SYSTEM, _CONTROLLER = -2, -3  # sources of messages, as a controller sends them
_JOINT_ACCELERATION = 40.0  # [rad/s2] limit that a controller reports
_EQUIVALENT_RADIUS = 0.25  # [m] likewise
_NO_CHECKSUM = (0xFFFFFFFF,) * 6  # of a joint without individual calibration
_BOARD, _BOX, _UR3, _E_SERIES = 6, 4, 3, 3  # hardware and robot types
_BOARD_TEMPERATURE = 30.0  # [C] assumed
_BAUD_RATE, _STOP_BITS, _RX_IDLE, _TX_IDLE = 115200, 1, 1.5, 3.5  # of the tool's serial interface, which is off
_TEXT = 2048  # [bytes] of a message's text


class StateType(IntEnum):
    """Sub-packages of a robot state."""

    ROBOT_MODE_DATA = 0
    JOINT_DATA = 1
    TOOL_DATA = 2
    MASTERBOARD_DATA = 3
    CARTESIAN_INFO = 4
    KINEMATICS_INFO = 5
    CONFIGURATION_DATA = 6
    FORCE_MODE_DATA = 7
    ADDITIONAL_INFO = 8
    CALIBRATION_DATA = 9
    TOOL_COMM_INFO = 11
    TOOL_MODE_INFO = 12


class MessageType(IntEnum):
    """Robot messages."""

    TEXT = 0
    POPUP = 2
    VERSION = 3
    SAFETY_MODE = 5
    ERROR_CODE = 6
    KEY = 7
    RUNTIME_EXCEPTION = 10


class ControlMode(IntEnum):
    """How the arm is controlled."""

    POSITION = 0
    TEACH = 1
    FORCE = 2


class ReportLevel(IntEnum):
    """How bad a numbered report is."""

    WARNING = 2
    VIOLATION = 3


def _fixed_layout(kind: StateType, layout: str, *values: float) -> bytes:
    body = struct.Struct(">" + layout)
    return struct.pack(">IB", body.size + 5, kind) + body.pack(*values)


_KINEMATICS = _fixed_layout(StateType.KINEMATICS_INFO, "6I24dI", *_NO_CHECKSUM, *DH_THETA, *DH_A, *DH_D, *DH_ALPHA, 0)
_CONFIGURATION = _fixed_layout(
    StateType.CONFIGURATION_DATA,
    "12d12d5d24d4i",
    *(limit for joint in JOINTS for limit in (-joint.reach, joint.reach)),
    *(limit for joint in JOINTS for limit in (joint.speed, _JOINT_ACCELERATION)),
    *(MOVEJ_SPEED, MOVEJ_ACCELERATION, MOVEL_SPEED, MOVEL_ACCELERATION, _EQUIVALENT_RADIUS),
    *(*DH_A, *DH_D, *DH_ALPHA, *DH_THETA),
    *(_BOARD, _BOX, _UR3, _E_SERIES),
)
_ADDITIONAL = _fixed_layout(StateType.ADDITIONAL_INFO, "B??B", 0, True, False, 1)
_TOOL_COMM = _fixed_layout(StateType.TOOL_COMM_INFO, "?iiiff", False, _BAUD_RATE, 0, _STOP_BITS, _RX_IDLE, _TX_IDLE)
_TOOL_MODE = _fixed_layout(StateType.TOOL_MODE_INFO, "BBB", 0, 1, 1)  # two outputs that sink
_CONSTANT = _CONFIGURATION + _ADDITIONAL + _TOOL_COMM + _TOOL_MODE

_MODE = struct.Struct(">IBQ7?bB3dB")
_JOINTS = struct.Struct(">IB" + "3d4fB" * 6)
_TOOL = struct.Struct(">IB2B2dfB2fB")
_MASTERBOARD = struct.Struct(">IB2I2B2d2B2d4fB??IB?B")
_CARTESIAN = struct.Struct(">IB12d")
_FORCE = struct.Struct(">IB7d")
_CALIBRATION = struct.Struct(">IB6d")


def robot_state(box: ControllerState) -> bytes:
    """The robot state as it is now, with every sub-package."""
    body = b"".join(
        (
            _robot_mode(box),
            _joint_data(box),
            _CARTESIAN.pack(
                _CARTESIAN.size, StateType.CARTESIAN_INFO, *box.arm.getActualTCPPose(), *box.arm.tcp_offset
            ),
            _KINEMATICS,
            *_forces(box),
            _masterboard(box),
            _tool(box),
            _CONSTANT,
        )
    )
    return struct.pack(">iB", len(body) + 5, _ROBOT_STATE) + body


def _robot_mode(box: ControllerState) -> bytes:
    state = box.runtime_state
    if box.teaching:
        control = ControlMode.TEACH
    else:
        control = ControlMode.POSITION if box.arm.controller.compliance is None else ControlMode.FORCE
    return _MODE.pack(
        _MODE.size,
        StateType.ROBOT_MODE_DATA,
        round(box.time * 1e9),
        True,  # a real robot is connected
        True,  # and enabled
        box.robot_mode >= RobotMode.POWER_ON,
        box.safety_mode in EMERGENCY_STOPS,
        box.safety_mode is SafetyMode.PROTECTIVE_STOP,
        state in (RuntimeState.PLAYING, RuntimeState.RESUMING, RuntimeState.PAUSING, RuntimeState.STOPPING),
        state is RuntimeState.PAUSED,
        box.robot_mode,
        control,
        box.speed_slider,
        box.speed_scaling,
        1.0,  # the slider's upper end
        0,
    )


def _joint_data(box: ControllerState) -> bytes:
    arm, electrics = box.arm, box.electrics
    mode = joint_mode(box.robot_mode)
    values: list[float] = []
    rows = zip(
        arm.getActualQ(),
        arm.getTargetQ(),
        arm.getActualQd(),
        electrics.joint_current,
        electrics.joint_voltage,
        electrics.joint_temperature,
        strict=True,
    )
    for row in rows:
        values += (*row, 0.0, mode)
    return _JOINTS.pack(_JOINTS.size, StateType.JOINT_DATA, *values)


def _tool(box: ControllerState) -> bytes:
    wiring, electrics = box.wiring, box.electrics
    return _TOOL.pack(
        _TOOL.size,
        StateType.TOOL_DATA,
        *(1, 1),  # both analog inputs measure voltage
        *wiring.tool_analog_in,
        electrics.robot_voltage,
        wiring.tool_voltage,
        electrics.tool_current,
        electrics.tool_temperature,
        joint_mode(box.robot_mode),
    )


def _masterboard(box: ControllerState) -> bytes:
    wiring, electrics = box.wiring, box.electrics
    return _MASTERBOARD.pack(
        _MASTERBOARD.size,
        StateType.MASTERBOARD_DATA,
        wiring.digital_in,
        wiring.digital_out,
        *wiring.analog_in_voltage,
        *wiring.analog_in,
        *wiring.analog_out_voltage,
        *wiring.analog_out,
        _BOARD_TEMPERATURE,
        electrics.robot_voltage,
        electrics.robot_current,
        electrics.io_current,
        box.safety_mode,
        box.safety_mode is SafetyMode.REDUCED,
        False,  # no interface for injection moulding machines
        0,
        1,  # no selector of the operational mode is connected
        True,  # nor a three-position enabling device, which counts as pressed
        1,
    )


def _forces(box: ControllerState) -> tuple[bytes, bytes]:
    """Calibration data and force mode data: the wrench at the TCP, and how far the arm is from a singularity."""
    wrench = box.arm.getActualTCPForce()
    dexterity = abs(float(np.linalg.det(box.arm.controller.kinematics.jacobian())))
    return (
        _CALIBRATION.pack(_CALIBRATION.size, StateType.CALIBRATION_DATA, *wrench),
        _FORCE.pack(_FORCE.size, StateType.FORCE_MODE_DATA, *wrench, dexterity),
    )


def version_message(version: PolyScope, time: float) -> bytes:
    """What a client is told first; `time` [s] of the controller."""
    name = b"URControl"
    return _message(
        time,
        _SYSTEM,
        MessageType.VERSION,
        struct.pack(">B", len(name)) + name,
        struct.pack(">2B2i", version.major, version.minor, version.bugfix, version.build),
        BUILD_DATE.strftime("%d-%m-%Y, %H:%M:%S").encode(),
    )


def error_message(code: int, argument: int, level: ReportLevel, text: str, time: float) -> bytes:
    """One of the controller's C-numbered reports; `time` [s] of the controller."""
    return _message(
        time, _CONTROLLER, MessageType.ERROR_CODE, struct.pack(">iiiII", code, argument, level, 0, 0), _encoded(text)
    )


def event_message(event: Event, time: float) -> bytes:
    """An event as primary clients are told of it; `time` [s] of the controller."""
    if isinstance(event, ProgramStarted):
        return _key_message("PROGRAM_XXX_STARTED", event.name, time)
    if isinstance(event, ProgramStopped):
        return _key_message("PROGRAM_XXX_STOPPED", event.name, time)
    if isinstance(event, RuntimeException | CompileError):
        place = struct.pack(">II", max(0, event.line), max(0, event.column))
        return _message(time, _CONTROLLER, MessageType.RUNTIME_EXCEPTION, place, _encoded(event.text))
    if isinstance(event, SafetyModeChanged):
        return _message(time, _CONTROLLER, MessageType.SAFETY_MODE, struct.pack(">iiBII", 0, 0, event.mode, 0, 0))
    if isinstance(event, TextMessage):
        return _message(time, _SYSTEM, MessageType.TEXT, _encoded(event.text))
    if isinstance(event, ErrorCode):
        level = ReportLevel.WARNING if event.warning else ReportLevel.VIOLATION
        return error_message(event.code, event.argument, level, event.text, time)
    return _popup_message(event, time)


def _key_message(title: str, text: str, time: float) -> bytes:
    head = struct.pack(">iiB", 0, 0, len(title)) + title.encode()
    return _message(time, _SYSTEM, MessageType.KEY, head, _encoded(text))


def _popup_message(popup: Popup, time: float) -> bytes:
    title = _encoded(popup.title)[:255]
    head = struct.pack(">IB???B", 0, 0, popup.kind == "warning", popup.kind == "error", popup.blocking, len(title))
    return _message(time, _SYSTEM, MessageType.POPUP, head, title, _encoded(popup.text))


def _message(time: float, source: int, kind: MessageType, *parts: bytes) -> bytes:
    body = b"".join(parts)
    return struct.pack(">iBQbB", len(body) + 15, _ROBOT_MESSAGE, round(time * 1e9), source, kind) + body


def _encoded(text: str) -> bytes:
    return text.encode("utf-8", "replace")[:_TEXT]
