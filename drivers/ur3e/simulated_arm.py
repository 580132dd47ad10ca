# ruff: noqa: N802 - names are those of UR's RTDE as ur-rtde's clients spell them
"""The arm interface on the simulated cell. Session time advances in cycles of 2 ms and in no other way."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

from drivers.ur3e import frames
from drivers.ur3e.arm import GRIPPER_PIN, NORMAL, PROTECTIVE_STOP, SAFEGUARD_STOP
from drivers.ur3e.compliance import DEFAULT_DAMPING, DEFAULT_GAIN, Compliance
from drivers.ur3e.force_torque import ForceTorqueNoise, ForceTorqueSensor
from drivers.ur3e.measured_arm import MeasuredArm
from drivers.ur3e.motion import Servo, Speed
from drivers.ur3e.parameters import (
    CONTACT_THRESHOLD,
    CYCLE_NS,
    FORCE_LIMIT,
    GRIPPER,
    JOINTS,
    MOVEJ_ACCELERATION,
    MOVEJ_SPEED,
    MOVEL_ACCELERATION,
    MOVEL_SPEED,
    UNLOCK_DELAY,
)
from drivers.ur3e.scene import Scene

_HISTORY = 200  # cycles that `toolContact` looks back
_SEATED = 1e-3  # [m] below the board's top: a part let go there stays standing


def _always(_: int) -> bool:
    return True


class SimulatedArm(MeasuredArm):
    """Implements `Arm` on a scene.

    `gate` is asked before every cycle, with the session time [ns] at which it begins, whether motion is permitted in
    it; it may block until it knows. Without permission a safeguard stop, category 2, begins in that very cycle: the
    speed is taken back along the path as fast as the joints brake, the position is held, and the same motion goes on
    afterwards. `observe` is called after every cycle.
    """

    def __init__(
        self,
        scene: Scene,
        seed: int = 0,
        *,
        noise: ForceTorqueNoise | None = ForceTorqueNoise(),  # noqa: B008 - frozen
        gate: Callable[[int], bool] | None = None,
        observe: Callable[[SimulatedArm], None] | None = None,
    ) -> None:
        super().__init__(scene, ForceTorqueSensor(seed, noise))
        self.stop_reason = ""  # why the last protective stop happened
        self.stops = 0  # how many protective stops there have been
        self.stop_mode = SAFEGUARD_STOP  # safety mode to show without permission; the stop itself is the same
        self.held = False  # the program is paused: motion is braked along its path, without a safety stop
        self.torque: list[float] | None = None  # (6,) [Nm] in place of the servos, gravity apart
        self._damping, self._gain = DEFAULT_DAMPING, DEFAULT_GAIN  # of force mode
        self.gate = gate or _always
        self._observe = observe
        self._history: deque[tuple[float, ...]] = deque(maxlen=_HISTORY)
        self._stopped_at = 0
        self.setPayload(GRIPPER.mass, GRIPPER.centre_of_mass)
        self.sensor.update(self._reading.tolist(), self._tool_rotation())

    def cycle(self) -> None:
        """One control cycle: permission, setpoints, physics, sensor. Raises ArmError if the motion cannot go on."""
        permitted = self.gate(self.time)
        controller = self.controller
        if self.safety_mode != PROTECTIVE_STOP:
            self.safety_mode = NORMAL if permitted else self.stop_mode
            if self.torque is not None:
                self._drive(permitted)
            compliance = controller.compliance
            controller.step(permitted and not self.held, None if compliance is None else self.wrench)
        else:
            controller.brake()
        self._target_q[:] = controller.q
        self._target_qd[:] = controller.qd
        scene = self.scene
        scene.step()
        self.time += CYCLE_NS
        sensor = self.sensor
        sensor.update(self._reading.tolist(), self._tool_rotation())
        wrench = sensor.wrench
        self._history.append((wrench[0], wrench[1], wrench[2]))
        if self.safety_mode != PROTECTIVE_STOP:
            self._guard(wrench)
        if self._observe is not None:
            self._observe(self)

    def _drive(self, permitted: bool) -> None:
        """The servos give way to torques; without permission, or at a pause, they take hold of the arm again."""
        if permitted and not self.held:
            self.controller.follow(self._q)
            self.scene.drive(self.torque)
        else:
            self.end_torque()

    def end_torque(self) -> None:
        """Let the servos take over from torques, where the arm is."""
        if self.torque is not None:
            self.torque = None
            self.scene.drive(None)
            self.controller.follow(self._q)

    def _guard(self, wrench: Sequence[float]) -> None:
        """Protective stops: too much force, a joint too fast or too far, or force mode pushed off its path."""
        x, y, z = wrench[0], wrench[1], wrench[2]
        if x * x + y * y + z * z > FORCE_LIMIT * FORCE_LIMIT:
            self.protective_stop(f"the force at the wrist exceeds {FORCE_LIMIT:.0f} N")
            return
        controller = self.controller
        if self.torque is not None:
            for joint, angle, speed in zip(JOINTS, self._q.tolist(), self._qd.tolist(), strict=True):
                if abs(speed) > joint.speed:
                    self.protective_stop(f"{joint.name} exceeds its speed limit")
                elif abs(angle) > joint.reach:
                    self.protective_stop(f"{joint.name} exceeds its position limit")
        if controller.compliance is not None:
            (x, y, z), rotation = self.pose
            a, b, c = controller.position
            turn = frames.vector_of_rotation(frames.product(rotation, frames.transpose(controller.rotation)))
            if controller.compliance.deviates([x - a, y - b, z - c, *turn]):
                self.protective_stop("force mode deviates further than its limits allow")

    def protective_stop(self, reason: str) -> None:
        """Brake as hard as the joints can, category 0, and stand until `unlockProtectiveStop`."""
        self.end_torque()
        self.controller.halt()
        if self.safety_mode != PROTECTIVE_STOP:
            self.safety_mode, self.stop_reason, self._stopped_at = PROTECTIVE_STOP, reason, self.time
            self.stops += 1

    def unlockProtectiveStop(self, at_once: bool = False) -> bool:
        """Release a protective stop; refused, False, within 5 s of its beginning, as the dashboard server does.

        `at_once` does without that wait.
        """
        if not at_once and self.safety_mode == PROTECTIVE_STOP and (self.time - self._stopped_at) * 1e-9 < UNLOCK_DELAY:
            return False
        self.safety_mode = NORMAL
        return True

    def _finish(self) -> bool:
        while not self.controller.idle and self.safety_mode != PROTECTIVE_STOP:
            self.cycle()
        return self.safety_mode != PROTECTIVE_STOP

    def _begin(self) -> bool:
        """Whether a new motion may start; one that has not ended is stopped first."""
        if not self.controller.idle:
            self.stopL()
        return self.safety_mode != PROTECTIVE_STOP

    # Motions

    def moveJ(
        self,
        q: Sequence[float],
        speed: float = MOVEJ_SPEED,
        acceleration: float = MOVEJ_ACCELERATION,
        asynchronous: bool = False,
    ) -> bool:
        """See `Arm`."""
        if not self._begin():
            return False
        self.controller.move_joints(q, speed, acceleration)
        return True if asynchronous else self._finish()

    def moveL(
        self,
        pose: Sequence[float],
        speed: float = MOVEL_SPEED,
        acceleration: float = MOVEL_ACCELERATION,
        asynchronous: bool = False,
    ) -> bool:
        """See `Arm`."""
        if not self._begin():
            return False
        self.controller.move_linear(frames.ros_pose(pose), speed, acceleration)
        return True if asynchronous else self._finish()

    def speedL(self, xd: Sequence[float], acceleration: float = 0.25, time: float = 0.0) -> bool:
        """See `Arm`."""
        if self.safety_mode == PROTECTIVE_STOP:
            return False
        self.controller.set_speed(frames.turn_base_wrench(xd), acceleration, time)
        return True

    def speedStop(self, a: float = 10.0) -> bool:
        """See `Arm`."""
        if isinstance(self.controller.motion, Speed):
            self.stopL(a)
        return self.safety_mode != PROTECTIVE_STOP

    def stopL(self, a: float = 10.0, asynchronous: bool = False) -> None:
        """See `Arm`."""
        if not self.controller.idle:
            self.controller.set_speed([0.0] * 6, a)
            if not asynchronous:
                self._finish()

    def servoL(
        self, pose: Sequence[float], speed: float, acceleration: float, time: float, lookahead_time: float, gain: float
    ) -> bool:
        """See `Arm`. `speed`, `acceleration` and `time` are not used, as in UR's servo functions of today."""
        del speed, acceleration, time
        if self.safety_mode == PROTECTIVE_STOP:
            return False
        self.controller.set_servo(frames.ros_pose(pose), lookahead_time, gain)
        return True

    def servoStop(self, a: float = 10.0) -> bool:
        """See `Arm`."""
        if isinstance(self.controller.motion, Servo):
            self.stopL(a)
        return self.safety_mode != PROTECTIVE_STOP

    def forceMode(
        self,
        task_frame: Sequence[float],
        selection_vector: Sequence[int],
        wrench: Sequence[float],
        type: int,  # noqa: A002
        limits: Sequence[float],
    ) -> bool:
        """See `Arm`."""
        if self.safety_mode == PROTECTIVE_STOP:
            return False
        origin, frame = frames.ros_pose(task_frame)
        now = self.controller.compliance
        compliance = Compliance(frame, selection_vector, wrench, limits, type, origin)
        if now is None or not now.same_axes(compliance):
            compliance.tune(self._damping, self._gain)
            self.controller.comply(compliance)
        else:
            now.wrench, now.limits = compliance.wrench, compliance.limits
            now.tune(self._damping, self._gain)
        return True

    def forceModeSetDamping(self, damping: float) -> bool:
        """How much force mode is damped, 0..1; takes effect with the next `forceMode`."""
        self._damping = min(max(damping, 0.0), 1.0)
        return True

    def forceModeSetGainScaling(self, scaling: float) -> bool:
        """How eagerly force mode answers, 0..2; takes effect with the next `forceMode`."""
        self._gain = min(max(scaling, 0.0), 2.0)
        return True

    def forceModeStop(self) -> bool:
        """See `Arm`."""
        if self.controller.compliance is not None:
            self.controller.comply(None)
        return True

    def toolContact(self, direction: Sequence[float]) -> int:
        """See `Arm`."""
        length = math.hypot(*direction[:3])
        if length > 0:
            towards = frames.unrotate(self._tool_rotation(), frames.turn_base(direction))
            x, y, z = (-value / length for value in towards)
        count = 0
        for fx, fy, fz in reversed(self._history):
            force = x * fx + y * fy + z * fz if length > 0 else math.sqrt(fx * fx + fy * fy + fz * fz)
            if force < CONTACT_THRESHOLD:
                break
            count += 1
        return count

    # Settings

    def zeroFtSensor(self) -> bool:
        """See `Arm`."""
        self.sensor.zero()
        self._history.clear()
        self._wrench_time = -1
        return True

    def setTcp(self, tcp_offset: Sequence[float]) -> bool:
        """See `Arm`."""
        self.controller.set_tcp(tcp_offset)
        self._actual.set_tcp(tcp_offset)
        turn = frames.transpose(frames.rotation_of_vector(tcp_offset[3:6]))
        self._tool_turn = turn if any(tcp_offset[3:6]) else None
        self._pose_time = self._wrench_time = -1
        return True

    def setPayload(self, mass: float, cog: Sequence[float]) -> bool:
        """See `Arm`."""
        self.payload = (float(mass), tuple(float(value) for value in cog))
        self.sensor.set_payload(*self.payload)
        return True

    def setToolDigitalOut(self, output_id: int, signal_level: bool) -> bool:
        """See `Arm`. Closing takes the feeder's part if the pin tips' nominal place is within 2 mm of it."""
        if output_id != GRIPPER_PIN:
            return False
        scene = self.scene
        if signal_level and not scene.holding:
            station = scene.workcell
            place, _ = self.pose
            feeder = (station.feeder_x, station.feeder_y, station.feeder_z)
            if scene.part_waiting and math.dist(place, feeder) <= GRIPPER.capture:
                scene.grasp()
        elif not signal_level and scene.holding:
            (_, _, z), _ = scene.part_pose()
            if z < scene.board.z - _SEATED:
                scene.leave_standing()
            else:
                scene.release()
        return True

    def initPeriod(self) -> float:
        """See `Arm`."""
        return self.time * 1e-9

    def waitPeriod(self, t_cycle_start: Any) -> None:  # noqa: ARG002
        """See `Arm`: runs one cycle of the simulation."""
        self.cycle()
