"""An attempt: how it is done, what is felt while it lasts, and what came of it. Written against `Arm` alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from drivers.ur3e import frames
from drivers.ur3e.arm import NORMAL, PROTECTIVE_STOP, Arm
from drivers.ur3e.frames import Quaternion, Vector
from drivers.ur3e.parameters import CYCLE
from runtime.component import Component
from runtime.errors import ArmError
from runtime.messages import Outcome
from runtime.messages.attendance import PROTECTIVE_STOP_WORDS
from runtime.quantity import Acceleration, Duration, Force, Length, Positive, Speed

_STOP_DECELERATION = 2.0  # [m/s2] 5 mm/s are gone after 2 cycles
_YIELD = 0.02  # [m/s] at most along compliant axes
_DEVIATION = (5e-3, 0.1)  # [m], [rad] along the others: the lateral force ends the slide long before
_EASE = (0.1, 0.3)  # [s] at least and at most, for chamfers to pull, and pins to come free of the wall they met
_EASE_GRACE = 1.0  # [s]
_FREE = 1.0  # [N] across, at which they are: three times the sensor's noise


@dataclass(frozen=True)
class SkillSettings:
    """How an attempt is done."""

    contact_force: Annotated[Force, Positive] = 5.0  # [N] ends the descent; twice the sensor's noise sets off falsely
    contact_cycles: Annotated[int, Field(ge=1, le=50)] = 2  # running, so that one noisy sample does not end it
    descent_speed: Annotated[Speed, Positive] = 5e-3  # [m/s]
    descent_acceleration: Annotated[Acceleration, Positive] = 0.5  # [m/s2]
    retract_speed: Annotated[Speed, Positive] = 0.02  # [m/s]
    settle: Annotated[Duration, Positive] = 0.04  # [s] above the hole before the sensor is zeroed
    seated_share: Annotated[float, Field(gt=0.5, le=1.0)] = 0.9  # of the full depth at which a part counts as seated
    measure: Annotated[Duration, Positive] = 0.02  # [s] over which the wrench of a blocked contact is averaged
    gripper_time: Annotated[Duration, Positive] = 0.3  # [s] to open or to close
    depth_margin: Annotated[Length, Positive] = 0.05e-3  # [m] short of full depth at which the descent is told to end
    slide_force: Annotated[Force, Positive] = 4.0  # [N] with which sliding pins are held on the board
    slide_speed: Annotated[Speed, Positive] = 10e-3  # [m/s] along the path
    drop_depth: Annotated[Length, Positive] = 0.1e-3  # [m] below the board that was touched at which pins are in a hole
    lateral_force: Annotated[Force, Positive] = 4.0  # [N] against the slide at which pins are caught at an edge
    home_speed: Annotated[Speed, Positive] = 8e-3  # [m/s] downwards once the pins have dropped in
    home_force: Annotated[Force, Positive] = 5.0  # [N] ends that way down; above slide_force

    def __post_init__(self) -> None:
        """Raises ValueError, which the cell file's reader explains."""
        if self.home_force <= self.slide_force:
            raise ValueError(
                f"home_force is {self.home_force:g} N and must be above slide_force, {self.slide_force:g} N: "
                "pins pushed home would be stopped at once"
            )


@dataclass(frozen=True)
class Felt:
    """What one attempt felt."""

    outcome: Outcome
    reason: str
    x: float  # [m] commanded offset from nominal in base_link where the attempt ended
    y: float  # [m]
    travelled: float  # [m] of the path slid along, 0 for a peck
    tcp_position: Vector  # [m] base_link, at the end of the attempt
    tcp_quaternion: Quaternion  # x, y, z, w
    wrench: tuple[float, ...]  # (6,) [N, Nm] on the part at the TCP in base_link, at the end of the attempt
    depth: float  # [m] of the pin tips below the board's nominal top
    peak_force: float  # [N] upwards during the attempt
    duration: float  # [s] from above the first place, or from where the attempt before ended, to the end of the retract


class Touch:
    """One attempt while it is under way: outcome, reason and place are filled in by whoever moves the arm."""

    def __init__(self, arm: Arm, settings: SkillSettings, x: float, y: float, top: float, full: float) -> None:
        """An attempt that begins at the offset (x, y) [m] over a board with its top at `top` [m], where a seated part's
        pins are `full` [m] deep.
        """
        self._arm, self._settings = arm, settings
        self.top, self.full = top, full
        self.outcome, self.reason = Outcome.ABORTED, "not begun"
        self.x, self.y, self.travelled = x, y, 0.0
        self.peak_force = 0.0  # [N]
        self._pose: list[float] | tuple[float, ...] = (0.0,) * 6  # UR's, base
        self._wrench: list[float] | tuple[float, ...] = (0.0,) * 6  # [N, Nm] base
        self._begun = self._last = arm.getTimestamp()
        self._deadline = self._begun
        self._limit = settings.contact_force  # [N] beyond which a force upwards is contact
        self._contacts = 0

    def begin(self) -> None:
        """The part has come over the place: what it took to bring it there is no part of the attempt."""
        self._begun = self._arm.getTimestamp()

    @property
    def deepest(self) -> float:
        """Height [m] of the TCP at which a motion down is told to end."""
        return self.top - self.full + self._settings.depth_margin

    @property
    def contact(self) -> bool:
        """Whether the force upwards exceeds that of the descent's end, and not for one cycle only."""
        return self._contacts >= self._settings.contact_cycles

    @property
    def expired(self) -> bool:
        """Whether the time that was allowed is over."""
        return self._last > self._deadline

    def allow(self, seconds: float) -> None:
        """The next motion may take so long; a safeguard stop and a reduced speed only lengthen it."""
        self._last = self._arm.getTimestamp()
        self._deadline = self._last + seconds

    def cycle(self) -> None:
        """Let a control cycle pass. Raises ArmError at a protective stop."""
        arm = self._arm
        arm.waitPeriod(arm.initPeriod())
        force = arm.getActualTCPForce()[2]
        self.peak_force = max(self.peak_force, force)
        self._contacts = self._contacts + 1 if force > self._limit else 0
        safety = arm.getSafetyMode()
        if safety == PROTECTIVE_STOP:
            self.measure()
            raise ArmError(stopped(arm))
        now = arm.getTimestamp()
        if safety != NORMAL or arm.getSpeedScaling() < 1.0:
            self._deadline += now - self._last
        self._last = now

    def descend(self, speed: float, force: float) -> None:
        """Go straight down [m/s] until contact, which is a force [N], depth or the end of the time, and stop."""
        arm = self._arm
        self._limit, self._contacts = force, 0
        arm.speedL([0.0, 0.0, -speed, 0.0, 0.0, 0.0], self._settings.descent_acceleration)
        while arm.getActualTCPPose()[2] > self.deepest and not self.contact and not self.expired:
            self.cycle()
        arm.speedStop(_STOP_DECELERATION)

    @property
    def resistance(self) -> float:
        """Force across [N]."""
        x, y = self._arm.getActualTCPForce()[:2]
        return math.hypot(x, y)

    def comply(self, selection: Sequence[int], down: float) -> None:
        """Force mode along the selected axes (6,): `down` [N] on the board, none across."""
        deviation, turn = _DEVIATION
        limits = [_YIELD if selected else deviation for selected in selection[:3]]
        self._arm.forceMode([0.0] * 6, selection, [0.0, 0.0, -down, 0.0, 0.0, 0.0], 2, [*limits, turn, turn, turn])

    def ease(self, down: float) -> None:
        """Give way across, and along z to `down` [N], until chamfers have pulled and the part hangs free in its holes.

        Giving way for longer would let the sensor's zero error push the part about within its holes: the seated pose
        along a slide in x then strays by 50 to 99 um (sd), against 28 to 38 um.
        """
        shortest, longest = _EASE
        self.allow(longest + _EASE_GRACE)
        self.comply([1, 1, 1, 0, 0, 0], down)
        try:
            cycles = 0
            while cycles * CYCLE < shortest or (cycles * CYCLE < longest and self.resistance > _FREE):
                self.cycle()
                cycles += 1
        finally:
            self._arm.forceModeStop()

    def measure(self) -> None:
        """The pose, and the mean wrench over a moment of standing still."""
        arm = self._arm
        count = max(1, round(self._settings.measure / CYCLE))
        total = [0.0] * 6
        for _ in range(count):
            arm.waitPeriod(arm.initPeriod())
            total = [a + b for a, b in zip(total, arm.getActualTCPForce(), strict=True)]
        self._wrench = [value / count for value in total]
        self._pose = arm.getActualTCPPose()

    @property
    def seated(self) -> bool:
        """Whether the part stands as deep as a seated one, where it was last measured."""
        return self.top - self._pose[2] >= self._settings.seated_share * self.full

    def felt(self) -> Felt:
        """What came of it, now that the arm is done."""
        position, rotation = frames.ros_pose(self._pose)
        return Felt(
            outcome=self.outcome,
            reason=self.reason,
            x=self.x,
            y=self.y,
            travelled=self.travelled,
            tcp_position=position,
            tcp_quaternion=frames.quaternion_of_rotation(rotation),
            wrench=tuple(frames.turn_base_wrench(self._wrench)),
            depth=self.top - position[2],
            peak_force=self.peak_force,
            duration=self._arm.getTimestamp() - self._begun,
        )


def jammed(felt: Felt, component: Component, settings: SkillSettings) -> bool:
    """Whether a part that is not seated had its pins in the holes: deeper than their chamfers, short of full depth.

    A part can jam or wedge only once its chamfers have crossed the edge (Whitney 1982, Quasi-static assembly of
    compliantly supported rigid parts): until then a chamfer or the board's face holds it, and it only lies elsewhere.
    Of 127 blocked pecks in simulated boards none ended deeper than 0.06 mm, and no seated part was short of 3.15 mm.
    What holds it, a wedged or bent pin or a hole that is closed further down, cannot be told from the depth.
    """
    crossed = max(pin.chamfer_length for pin in component.pins) + settings.drop_depth
    return felt.outcome is Outcome.BLOCKED and felt.depth > crossed


def stopped(arm: Arm) -> str:
    """Why an arm does not go on."""
    return f"{PROTECTIVE_STOP_WORDS} (safety mode {arm.getSafetyMode()})"
