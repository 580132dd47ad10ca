"""What an e-Series controller tells its RTDE clients: every output field, its type, and where its value comes from.

Names, types and meanings are those of UR's RTDE guide. Frames and units are UR's: poses and twists in `base`, SI,
angles in radians, temperatures in degrees Celsius.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

from drivers.ur3e.control_box.box import ControlBox
from drivers.ur3e.control_box.modes import JointMode, RobotMode, RuntimeState, robot_status_bits, safety_status_bits
from drivers.ur3e.control_box.realtime import elbow_position, elbow_velocity
from drivers.ur3e.control_box.registers import COUNT
from drivers.ur3e.control_box.version import PolyScope
from drivers.ur3e.parameters import CYCLE, FORCE_LIMIT

Getter: TypeAlias = Callable[[ControlBox], Any]  # one value, or a sequence of as many as the type has

_FIRST_BIT, _LAST_BIT = 64, 127  # bit registers that have a field of their own
_DEVIATION = math.radians(10.0)  # assumed: between commanded and measured angle, of a protective stop
_STANDARD_BITS, _CONFIGURABLE_SHIFT = 0xFF, 8


@dataclass(frozen=True)
class Output:
    """One output field."""

    type: str
    value: Getter
    since: tuple[int, int] = (5, 0)  # PolyScope version
    shared: bool = True  # worth keeping for other clients in the same cycle; registers are read at once


def output(name: str, version: PolyScope) -> Output | None:
    """The field of that name, or None if a controller of that version has none."""
    field = OUTPUTS.get(name)
    return field if field is not None and (version.major, version.minor) >= field.since else None


def _joint_mode(box: ControlBox) -> list[int]:
    mode = box.robot_mode
    if mode < RobotMode.POWER_ON:
        return [JointMode.POWER_OFF] * 6
    return [JointMode.RUNNING if mode == RobotMode.RUNNING else JointMode.IDLE] * 6


def _status(box: ControlBox) -> int:
    running = box.runtime_state in (RuntimeState.PLAYING, RuntimeState.RESUMING)
    return robot_status_bits(box.robot_mode, running, box.teaching, False)


def _analog_types(box: ControlBox) -> int:
    """Bits 0, 1 inputs, 2, 3 outputs: 1 for voltage."""
    kinds = (*box.wiring.analog_in_voltage, *box.wiring.analog_out_voltage)
    return sum(1 << bit for bit, voltage in enumerate(kinds) if voltage)


def _bits(values: list[bool], first: int) -> int:
    return sum(1 << bit for bit, value in enumerate(values[first : first + 32]) if value)


def _torque_window(_box: ControlBox) -> list[float]:
    """[A] within which the measured current is expected; assumed, by the joints' sizes."""
    return [4.0, 4.0, 3.0, 2.0, 2.0, 2.0]


def _acceleration(box: ControlBox) -> list[float]:
    """Acceleration (6,) of the TCP by the commanded joint accelerations, without what the Jacobian's change adds."""
    controller = box.arm.controller
    x, y, z, rx, ry, rz = (controller.kinematics.jacobian() @ controller.qdd).tolist()
    return [-x, -y, z, -rx, -ry, rz]


OUTPUTS: dict[str, Output] = {
    "timestamp": Output("DOUBLE", lambda box: box.time),  # [s] since the controller was switched on
    "target_q": Output("VECTOR6D", lambda box: box.arm.getTargetQ()),  # [rad]
    "target_qd": Output("VECTOR6D", lambda box: box.arm.getTargetQd()),  # [rad/s]
    "target_qdd": Output("VECTOR6D", lambda box: box.arm.controller.qdd),  # [rad/s^2]
    "target_current": Output("VECTOR6D", lambda box: box.electrics.target_current),  # [A]
    "target_moment": Output("VECTOR6D", lambda box: box.electrics.target_moment),  # [Nm]
    "actual_q": Output("VECTOR6D", lambda box: box.arm.getActualQ()),
    "actual_qd": Output("VECTOR6D", lambda box: box.arm.getActualQd()),
    "actual_current": Output("VECTOR6D", lambda box: box.electrics.joint_current),
    "actual_current_window": Output("VECTOR6D", _torque_window),
    "actual_current_as_torque": Output("VECTOR6D", lambda box: box.electrics.joint_torque, (5, 23)),  # [Nm]
    "joint_control_output": Output("VECTOR6D", lambda box: box.electrics.control_output),  # [A]
    "actual_TCP_pose": Output("VECTOR6D", lambda box: box.arm.getActualTCPPose()),
    "actual_TCP_speed": Output("VECTOR6D", lambda box: box.arm.getActualTCPSpeed()),
    "actual_TCP_force": Output(
        "VECTOR6D", lambda box: box.arm.getActualTCPForce()
    ),  # [N, Nm] payload and zero corrected
    "target_TCP_pose": Output("VECTOR6D", lambda box: box.arm.getTargetTCPPose()),
    "target_TCP_speed": Output("VECTOR6D", lambda box: box.arm.getTargetTCPSpeed()),
    "actual_digital_input_bits": Output("UINT64", lambda box: box.wiring.digital_in),
    "actual_configurable_digital_input_bits": Output(
        "UINT64", lambda box: box.wiring.digital_in >> _CONFIGURABLE_SHIFT & _STANDARD_BITS
    ),
    "joint_temperatures": Output("VECTOR6D", lambda box: box.electrics.joint_temperature),  # [C]
    "actual_execution_time": Output("DOUBLE", lambda box: 1e3 * box.execution_time),  # [ms] of the last cycle
    "target_execution_time": Output("DOUBLE", lambda _box: 1e3 * CYCLE),  # [ms]
    "robot_mode": Output("INT32", lambda box: box.robot_mode),
    "joint_mode": Output("VECTOR6INT32", _joint_mode),
    "safety_mode": Output("INT32", lambda box: box.safety_mode),
    "safety_status": Output("INT32", lambda box: box.safety_mode, (5, 4)),
    "actual_tool_accelerometer": Output("VECTOR3D", lambda box: box.electrics.tool_acceleration),  # [m/s^2]
    "speed_scaling": Output("DOUBLE", lambda box: box.speed_scaling),
    "target_speed_fraction": Output("DOUBLE", lambda box: box.speed_slider),
    "actual_momentum": Output("DOUBLE", lambda box: box.electrics.momentum),  # [kg m/s]
    "actual_main_voltage": Output("DOUBLE", lambda box: box.electrics.main_voltage),  # [V]
    "actual_robot_voltage": Output("DOUBLE", lambda box: box.electrics.robot_voltage),  # [V]
    "actual_robot_current": Output("DOUBLE", lambda box: box.electrics.robot_current),  # [A]
    "actual_joint_voltage": Output("VECTOR6D", lambda box: box.electrics.joint_voltage),  # [V]
    "actual_digital_output_bits": Output("UINT64", lambda box: box.wiring.digital_out),
    "actual_configurable_digital_output_bits": Output(
        "UINT64", lambda box: box.wiring.digital_out >> _CONFIGURABLE_SHIFT & _STANDARD_BITS
    ),
    "runtime_state": Output("UINT32", lambda box: box.runtime_state),
    "elbow_position": Output("VECTOR3D", lambda box: elbow_position(box.arm.getActualQ())),  # [m]
    "elbow_velocity": Output("VECTOR3D", lambda box: elbow_velocity(box.arm.getActualQ(), box.arm.getActualQd())),
    "robot_status_bits": Output("UINT32", _status),
    "safety_status_bits": Output("UINT32", lambda box: safety_status_bits(box.safety_mode)),
    "analog_io_types": Output("UINT32", _analog_types),
    "standard_analog_input0": Output("DOUBLE", lambda box: box.wiring.analog_in[0]),  # [A] or [V]
    "standard_analog_input1": Output("DOUBLE", lambda box: box.wiring.analog_in[1]),
    "standard_analog_output0": Output("DOUBLE", lambda box: box.wiring.analog_out[0]),
    "standard_analog_output1": Output("DOUBLE", lambda box: box.wiring.analog_out[1]),
    "io_current": Output("DOUBLE", lambda box: 1e3 * box.electrics.io_current),  # [mA]
    # Euromap 67 is an extra board, which this controller has not: all its inputs and outputs are off.
    "euromap67_input_bits": Output("UINT32", lambda _box: 0),
    "euromap67_output_bits": Output("UINT32", lambda _box: 0),
    "euromap67_24V_voltage": Output("DOUBLE", lambda _box: 0.0),
    "euromap67_24V_current": Output("DOUBLE", lambda _box: 0.0),
    "tool_mode": Output("UINT32", lambda box: JointMode.RUNNING if box.robot_mode >= RobotMode.IDLE else 239),
    "tool_analog_input_types": Output("UINT32", lambda _box: 3),  # both measure voltage
    "tool_analog_input0": Output("DOUBLE", lambda box: box.wiring.tool_analog_in[0]),  # [V]
    "tool_analog_input1": Output("DOUBLE", lambda box: box.wiring.tool_analog_in[1]),
    "tool_output_voltage": Output("INT32", lambda box: box.wiring.tool_voltage),  # [V]
    "tool_output_current": Output("DOUBLE", lambda box: 1e3 * box.electrics.tool_current),  # [mA]
    "tool_temperature": Output("DOUBLE", lambda box: box.electrics.tool_temperature),  # [C]
    "tool_output_mode": Output("UINT8", lambda _box: 0, (5, 2)),  # 0: digital outputs, 1: dual pin power
    "tool_digital_output0_mode": Output("UINT8", lambda _box: 1, (5, 2)),  # 1: sinking
    "tool_digital_output1_mode": Output("UINT8", lambda _box: 1, (5, 2)),
    "tcp_force_scalar": Output("DOUBLE", lambda box: math.hypot(*box.arm.getActualTCPForce()[:3])),  # [N]
    "joint_position_deviation_ratio": Output(
        "DOUBLE",
        lambda box: (
            max(abs(a - b) for a, b in zip(box.arm.getTargetQ(), box.arm.getActualQ(), strict=True)) / _DEVIATION
        ),
    ),
    # Share of what makes a protective stop.
    "collision_detection_ratio": Output(
        "DOUBLE", lambda box: min(1.0, math.hypot(*box.arm.sensor.wrench[:3]) / FORCE_LIMIT), (5, 15)
    ),
    "time_scale_source": Output("INT32", lambda box: 0 if box.speed_scaling >= 1.0 else 1, (5, 17)),
    "payload": Output("DOUBLE", lambda box: box.arm.payload[0], (5, 6)),  # [kg]
    "payload_cog": Output("VECTOR3D", lambda box: box.arm.payload[1], (5, 6)),  # [m]
    "payload_inertia": Output("VECTOR6D", lambda box: box.payload_inertia, (5, 11)),  # [kg m^2]
    "script_control_line": Output("UINT32", lambda box: box.programs.line, (5, 6)),
    # Not corrected for the payload, at the flange, in the tool's frame.
    "ft_raw_wrench": Output("VECTOR6D", lambda box: box.arm.getFtRawWrench(), (5, 9)),
    "tcp_offset": Output("VECTOR6D", lambda box: box.arm.tcp_offset, (5, 15)),
    "actual_TCP_acceleration": Output("VECTOR6D", _acceleration, (5, 22)),  # [m/s^2, rad/s^2]
    "target_TCP_acceleration": Output("VECTOR6D", _acceleration, (5, 22)),
    # The version from which on these exist is assumed.
    "actual_robot_energy_consumed": Output("DOUBLE", lambda box: box.electrics.energy_consumed, (5, 23)),  # [J]
    "actual_robot_braking_energy_dissipated": Output("DOUBLE", lambda box: box.electrics.energy_braked, (5, 23)),  # [J]
    "encoder0_raw": Output("INT32", lambda _box: 0, (5, 23)),  # no conveyor is connected
    "encoder1_raw": Output("INT32", lambda _box: 0, (5, 23)),
    "wrench_calc_from_currents": Output("VECTOR6D", lambda box: box.electrics.wrench_from_currents, (5, 23)),
    "target_gravity": Output("VECTOR3D", lambda box: box.gravity, (5, 23)),  # [m/s^2]
    "target_base_acceleration": Output("VECTOR6D", lambda _box: (0.0,) * 6, (5, 23)),  # it stands on the floor
    "output_bit_registers0_to_31": Output("UINT32", lambda box: _bits(box.registers.output_bit, 0)),
    "output_bit_registers32_to_63": Output("UINT32", lambda box: _bits(box.registers.output_bit, 32)),
    "input_bit_registers0_to_31": Output("UINT32", lambda box: _bits(box.registers.input_bit, 0)),
    "input_bit_registers32_to_63": Output("UINT32", lambda box: _bits(box.registers.input_bit, 32)),
}


def _register(values: str, index: int) -> Getter:
    return lambda box: getattr(box.registers, values)[index]


for _index in range(COUNT):
    for _way in ("output", "input"):
        OUTPUTS[f"{_way}_int_register_{_index}"] = Output("INT32", _register(f"{_way}_int", _index), shared=False)
        OUTPUTS[f"{_way}_double_register_{_index}"] = Output(
            "DOUBLE", _register(f"{_way}_double", _index), shared=False
        )
for _index in range(_FIRST_BIT, _LAST_BIT + 1):
    for _way in ("output", "input"):
        OUTPUTS[f"{_way}_bit_register_{_index}"] = Output("BOOL", _register(f"{_way}_bit", _index), shared=False)
