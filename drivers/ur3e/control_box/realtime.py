"""The package of the real-time client interface, port 30003: one in every cycle, always of 1220 bytes. Big endian.

The layout is that of PolyScope 5.10 and later: a size (int32, itself included) and doubles, integers among them.
"""

from __future__ import annotations

import math
import struct

from drivers.ur3e.control_box.controller_state import DH_A, DH_D, ControllerState, joint_mode

_PACKAGE = struct.Struct(">i152d")
_UNUSED = (0.0,) * 6  # used by the maker only


class RealtimePackage:
    """Makes the package once for all the clients that want it in a cycle."""

    def __init__(self, box: ControllerState) -> None:
        self._box = box
        self._time = -1.0
        self._package = b""

    def package(self) -> bytes:
        """The state of this cycle."""
        if self._time != self._box.time:
            self._time = self._box.time
            self._package = realtime_package(self._box)
        return self._package


def realtime_package(box: ControllerState) -> bytes:
    """The state as it is now."""
    arm, electrics, wiring = box.arm, box.electrics, box.wiring
    q, qd = arm.getActualQ(), arm.getActualQd()
    mass, centre = arm.payload
    return _PACKAGE.pack(
        _PACKAGE.size,
        box.time,
        *arm.getTargetQ(),
        *arm.getTargetQd(),
        *arm.controller.qdd,
        *electrics.target_current,
        *electrics.target_moment,
        *q,
        *qd,
        *electrics.joint_current,
        *electrics.joint_current,  # the control current: the drives follow it at once
        *arm.getActualTCPPose(),
        *arm.getActualTCPSpeed(),
        *arm.getActualTCPForce(),
        *arm.getTargetTCPPose(),
        *arm.getTargetTCPSpeed(),
        wiring.digital_in,
        *electrics.joint_temperature,
        box.execution_time,
        0.0,  # test value
        box.robot_mode,
        *((joint_mode(box.robot_mode),) * 6),
        box.safety_mode,
        *_UNUSED,
        *electrics.tool_acceleration,
        *_UNUSED,
        box.speed_scaling,
        electrics.momentum,
        *_UNUSED[:2],
        electrics.main_voltage,
        electrics.robot_voltage,
        electrics.robot_current,
        *electrics.joint_voltage,
        wiring.digital_out,
        box.runtime_state,
        *elbow_position(q),
        *elbow_velocity(q, qd),
        box.safety_mode,  # as safety status
        *_UNUSED[:3],
        mass,
        *centre,
        *box.payload_inertia,
    )


def elbow_position(q: list[float]) -> tuple[float, float, float]:
    """Where the elbow is (3,) [m] in `base` at joint angles `q` (6,) [rad]."""
    reach = DH_A[1] * math.cos(q[1])
    return reach * math.cos(q[0]), reach * math.sin(q[0]), DH_D[0] + DH_A[1] * math.sin(q[1])


def elbow_velocity(q: list[float], qd: list[float]) -> tuple[float, float, float]:
    """How the elbow moves (3,) [m/s] in `base` at joint speeds `qd` (6,) [rad/s]."""
    c, s = math.cos(q[0]), math.sin(q[0])
    out, across = -DH_A[1] * math.sin(q[1]) * qd[1], DH_A[1] * math.cos(q[1]) * qd[0]
    return out * c - across * s, out * s + across * c, DH_A[1] * math.cos(q[1]) * qd[1]
