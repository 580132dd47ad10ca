# ruff: noqa: N802 - names are those of UR's RTDE as ur-rtde's clients spell them
"""The arm interface on a real controller, through ur-rtde's control program on it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np

from drivers.ur3e import frames
from drivers.ur3e.arm import NORMAL, PROTECTIVE_STOP
from drivers.ur3e.kinematics import Kinematics, described
from drivers.ur3e.parameters import UNLOCK_DELAY
from drivers.ur3e.ur_connection import PLAYING
from drivers.ur3e.wired_loop import WiredLoop
from runtime.errors import ArmError
from runtime.messages import NANOSECONDS

_REACHED = 1e-3  # [m], [rad] from the commanded target: less is there
_SETTLED = 5  # cycles until what was set shows in the samples
_PROGRAM_START = 5_000_000_000  # [ns]
_TOOL_OUTPUT = 16  # bit of the first tool output


@dataclass(frozen=True)
class _FlangeWrench:
    wrench: Sequence[float]


class WiredArm(WiredLoop):
    """Implements `Arm` over a `UrConnection`; see `WiredLoop`.

    What the skill sets, TCP and payload, is read back, and set again with every start of the control program.
    """

    _tcp: tuple[float, ...] = (0.0,) * 6
    _payload: tuple[float, tuple[float, ...]] | None = None
    _followed: Callable[[float], bool] | None = None  # what ends the speed or the pose that the program follows

    @cached_property
    def _model(self) -> Kinematics:
        return Kinematics()

    @property
    def pose(self) -> tuple[frames.Vector, frames.Rotation]:
        """Position [m] and rotation of the TCP in base_link, as the controller measures it."""
        return frames.ros_pose(self._sample.actual_tcp_pose)

    @property
    def sensor(self) -> _FlangeWrench:
        """The controller's force at the TCP, taken to the flange and into the tool's frame."""
        wrench = frames.turn_base_wrench(self._sample.actual_tcp_force)
        turn = frames.rotation_of_vector(self._tcp[3:])
        tool = frames.product(self.pose[1], frames.transpose(turn))
        fx, fy, fz = frames.unrotate(tool, wrench[:3])
        tx, ty, tz = frames.unrotate(tool, wrench[3:])
        x, y, z = self._tcp[:3]
        return _FlangeWrench([fx, fy, fz, tx + y * fz - z * fy, ty + z * fx - x * fz, tz + x * fy - y * fx])

    def recover(self) -> None:
        """Release a protective stop, if there is one, and have the control program again. Raises ArmError if refused.

        The controller refuses to release it earlier than 5 s after it began.
        """
        dashboard = self._wires.dashboard
        if self._sample.safety_mode == PROTECTIVE_STOP:
            since = self._protected
            while self._time - since < (UNLOCK_DELAY + 0.5) * NANOSECONDS:
                self.cycle()
            self._call(dashboard.closeSafetyPopup)
            self._call(dashboard.unlockProtectiveStop)
            self._wait(lambda: self._sample.safety_mode == NORMAL, "release its protective stop", _PROGRAM_START)
        self._restart_program()

    def _restart_program(self) -> None:
        self._followed = None
        # The last command still stands in its register, and the new program would obey it; a kick writes 0 there.
        self._call(self._wires.control.kickWatchdog)
        self._settle()
        self._command(self._wires.control.reuploadScript, "take the control program")
        self._wait(lambda: self._sample.runtime_state == PLAYING, "start the control program", _PROGRAM_START)
        self._command(partial(self._wires.control.setWatchdog, self._watchdog), "set its watchdog")
        self.setTcp(self._tcp)
        if self._payload is not None:
            self.setPayload(*self._payload)

    # Motions

    def moveJ(
        self, q: Sequence[float], speed: float = 1.05, acceleration: float = 1.4, asynchronous: bool = False
    ) -> bool:
        """See `Arm`."""
        before = self._operation()
        if not self._motion(partial(self._wires.control.moveJ, list(q), speed, acceleration, True), "move"):
            return False
        return asynchronous or (self._finish(before) and self._arrived(q, self._sample.target_q))

    def moveL(
        self, pose: Sequence[float], speed: float = 0.25, acceleration: float = 1.2, asynchronous: bool = False
    ) -> bool:
        """See `Arm`."""
        before = self._operation()
        if not self._motion(partial(self._wires.control.moveL, list(pose), speed, acceleration, True), "move"):
            return False
        return asynchronous or (self._finish(before) and self._arrived(pose[:3], self._sample.target_tcp_pose[:3]))

    def _arrived(self, wanted: Sequence[float], there: Sequence[float]) -> bool:
        if max(abs(a - b) for a, b in zip(wanted, there, strict=True)) > _REACHED:
            raise ArmError(
                f"a motion was ended on the way: {described(*frames.ros_pose(self._sample.target_tcp_pose))}"
            )
        return True

    def speedL(self, xd: Sequence[float], acceleration: float = 0.25, time: float = 0.0) -> bool:
        """See `Arm`."""
        self._followed = self.speedStop
        return self._motion(partial(self._wires.control.speedL, list(xd), acceleration, time), "take a speed")

    def speedStop(self, a: float = 10.0) -> bool:
        """See `Arm`."""
        self._followed = None
        return self._motion(partial(self._wires.control.speedStop, self._brief(a)), "stop")

    def stopL(self, a: float = 10.0, asynchronous: bool = False) -> None:
        """See `Arm`."""
        if self._followed is not None:
            self._followed(a)
            return
        before = self._operation()
        # ur-rtde's synchronous one would brake the joints instead, and feed no watchdog meanwhile.
        self._call(partial(self._wires.control.stopL, a, True))
        if not asynchronous:
            self._finish(before)

    def servoL(
        self, pose: Sequence[float], speed: float, acceleration: float, time: float, lookahead_time: float, gain: float
    ) -> bool:
        """See `Arm`."""
        self._followed = self.servoStop
        servo = partial(self._wires.control.servoL, list(pose), speed, acceleration, time, lookahead_time, gain)
        return self._motion(servo, "follow a pose")

    def servoStop(self, a: float = 10.0) -> bool:
        """See `Arm`."""
        self._followed = None
        return self._motion(partial(self._wires.control.servoStop, self._brief(a)), "stop")

    def _brief(self, a: float) -> float:
        """A deceleration [m/s2], harder than `a` if the watchdog would bark before the arm stands."""
        return max(a, 2.0 * self._watchdog * math.hypot(*self._sample.actual_tcp_speed[:3]))

    def forceMode(
        self,
        task_frame: Sequence[float],
        selection_vector: Sequence[int],
        wrench: Sequence[float],
        type: int,  # noqa: A002
        limits: Sequence[float],
    ) -> bool:
        """See `Arm`."""
        control = self._wires.control
        press = partial(control.forceMode, list(task_frame), list(selection_vector), list(wrench), type, list(limits))
        return self._motion(press, "press")

    def forceModeStop(self) -> bool:
        """See `Arm`."""
        return self._motion(self._wires.control.forceModeStop, "end force mode")

    def toolContact(self, direction: Sequence[float]) -> int:
        """See `Arm`."""
        # The first call returns what the one before it found: ur-rtde reads before the program has answered.
        self._call(partial(self._wires.control.toolContact, list(direction)))
        self._settle()
        cycles: int = self._call(partial(self._wires.control.toolContact, list(direction)))
        return cycles

    # Settings

    def zeroFtSensor(self) -> bool:
        """See `Arm`."""
        done = self._motion(self._wires.control.zeroFtSensor, "zero its sensor")
        self._settle()
        return done

    def setTcp(self, tcp_offset: Sequence[float]) -> bool:
        """See `Arm`. Reads it back."""
        self._tcp = tuple(float(value) for value in tcp_offset)
        self._command(partial(self._wires.control.setTcp, list(self._tcp)), "set the TCP")
        there: list[float] = self._call(self._wires.control.getTCPOffset)
        if max(abs(a - b) for a, b in zip(self._tcp, there, strict=True)) > _REACHED:
            raise ArmError(f"{self._wires.address} has its TCP at {there} instead of {self._tcp} [m, rad]")
        self._settle()
        return True

    def setPayload(self, mass: float, cog: Sequence[float]) -> bool:
        """See `Arm`. Reads it back."""
        self._payload = (mass, tuple(cog))
        self._command(partial(self._wires.control.setPayload, mass, list(cog)), "set the payload")

        def told() -> bool:
            sample = self._sample
            return math.isclose(sample.payload, mass, abs_tol=1e-3) and math.dist(sample.payload_centre, cog) < _REACHED

        self._wait(told, "take over the payload")
        return True

    def setToolDigitalOut(self, output_id: int, signal_level: bool) -> bool:
        """See `Arm`. Reads it back."""
        self._send(partial(self._wires.io.setToolDigitalOut, output_id, signal_level))
        bit = 1 << (_TOOL_OUTPUT + output_id)
        self._wait(
            lambda: bool(self._sample.digital_outputs & bit) == signal_level, f"switch its tool output {output_id}"
        )
        return True

    def initPeriod(self) -> float:
        """See `Arm`."""
        return self._sample.timestamp

    def waitPeriod(self, t_cycle_start: Any) -> None:  # noqa: ARG002
        """See `Arm`: waits for the next sample."""
        self.cycle()

    def _settle(self) -> None:
        for _ in range(_SETTLED):
            self.cycle()

    # Measurements

    def getActualQ(self) -> list[float]:
        """See `Arm`."""
        return self._sample.actual_q

    def getActualQd(self) -> list[float]:
        """See `Arm`."""
        return self._sample.actual_qd

    def getTargetQ(self) -> list[float]:
        """See `Arm`."""
        return self._sample.target_q

    def getTargetQd(self) -> list[float]:
        """See `Arm`."""
        return self._sample.target_qd

    def getActualTCPPose(self) -> list[float]:
        """See `Arm`."""
        return self._sample.actual_tcp_pose[:]

    def getTargetTCPPose(self) -> list[float]:
        """See `Arm`."""
        return self._sample.target_tcp_pose[:]

    def getActualTCPSpeed(self) -> list[float]:
        """See `Arm`."""
        return self._sample.actual_tcp_speed

    def getActualTCPForce(self) -> list[float]:
        """See `Arm`."""
        return self._sample.actual_tcp_force

    def getFtRawWrench(self) -> list[float]:
        """See `Arm`."""
        return self._sample.raw_wrench

    def getJointTorques(self) -> list[float]:
        """See `Arm`: what the controller wants of the joints, less what our model of arm and gripper says of gravity.

        Asking the control program would disturb the motion in hand.
        """
        sample = self._sample
        gravity = self._model.bias(np.array(sample.target_q), np.zeros(6))
        return [moment - weight for moment, weight in zip(sample.target_moment, gravity.tolist(), strict=True)]

    def getSafetyMode(self) -> int:
        """See `Arm`; 5 also without a permit."""
        return self.safety_mode

    def getRobotMode(self) -> int:
        """See `Arm`."""
        return self._sample.robot_mode

    def getSpeedScaling(self) -> float:
        """See `Arm`."""
        return self._sample.speed_scaling * self._sample.speed_fraction

    def getTimestamp(self) -> float:
        """See `Arm`."""
        return self._sample.timestamp

    def getInverseKinematics(self, x: Sequence[float], qnear: Sequence[float] | None = None) -> list[float]:
        """See `Arm`. Uses the controller's own calibration."""
        solve = partial(self._wires.control.getInverseKinematics, list(x), list(qnear or self._sample.actual_q))
        q = self._call(solve)
        if len(q) != len(self._sample.actual_q):
            raise ArmError(f"out of reach: {described(*frames.ros_pose(x))}")
        return list(q)

    def getForwardKinematics(
        self, q: Sequence[float] | None = None, tcp_offset: Sequence[float] | None = None
    ) -> list[float]:
        """See `Arm`. Uses the controller's own calibration."""
        joints = list(self._sample.actual_q if q is None else q)
        tcp = list(self._tcp if tcp_offset is None else tcp_offset)
        if not any(tcp):
            tcp[0] = 1e-12  # [m] ur-rtde sends zeros in a package of the wrong length
        return list(self._call(partial(self._wires.control.getForwardKinematics, joints, tcp)))

    def isSteady(self) -> bool:
        """See `Arm`."""
        steady: bool = self._call(self._wires.control.isSteady)
        return steady
