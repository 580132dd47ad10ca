"""Force mode and hand guiding: selected axes of a task frame give way. Frame: base_link.

Admittance for each selected axis: inertia dv/dt = gain (wanted + felt) - damping v, solved implicitly. The damping is
chosen for the stiffest contact the cell has, about 90 N/mm: a touchdown at 5 mm/s overshoots 5 N by under 1 N. UR does
not publish its own; that a gain above 1 grows unstable on hard contact is as UR's manual says of its scaling.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from drivers.ur3e import frames
from drivers.ur3e.frames import Rotation, Vector
from drivers.ur3e.motion import Step
from runtime.errors import ArmError

INERTIA = (6.0, 6.0, 6.0, 0.08, 0.08, 0.08)  # [kg], [kg m^2] assumed
DAMPING = (600.0, 600.0, 600.0, 8.0, 8.0, 8.0)  # [Ns/m], [Nms/rad] assumed

POINT, FIXED, MOTION = 1, 2, 3  # types of force mode, URScript manual
DEFAULT_DAMPING = 0.005  # force_mode_set_damping, URScript manual
DEFAULT_GAIN = 1.0  # force_mode_set_gain_scaling, URScript manual
_GUIDED_DAMPING = 0.1  # assumed: of a hand-guided arm against force mode
_GUIDED_DEAD_ZONE = (6.0, 6.0, 6.0, 0.4, 0.4, 0.4)  # [N], [Nm] assumed: below the joints' friction nothing moves
_GUIDED_LIMITS = (0.5, 0.5, 0.5, 1.5, 1.5, 1.5)  # [m/s], [rad/s] assumed
_PARALLEL = 1e-3  # sine of an angle
_STANDS = 1e-4  # [m/s] below which a motion has no direction


class Compliance:
    """Force mode while it is on."""

    def __init__(
        self,
        frame: Rotation,
        selection: Sequence[int],
        wrench: Sequence[float],
        limits: Sequence[float],
        kind: int = FIXED,
        origin: Vector = (0.0, 0.0, 0.0),
    ) -> None:
        """Raises ArmError for a kind that is none of 1, 2, 3.

        `frame` and `origin` are the task frame; `selection`, `wrench` and `limits` (6,) are those of `Arm.forceMode`.
        """
        if kind not in (POINT, FIXED, MOTION):
            raise ArmError(f"force mode of type {kind} is not known; known: 1 (towards a point), 2 (fixed), 3 (motion)")
        self.kind, self.task, self.origin = kind, frame, origin
        self.frame = frame  # as it is turned at present
        self.axes = [i for i in range(6) if selection[i]]
        self.others = [i for i in range(6) if not selection[i]]
        self.wrench = [float(value) for value in wrench]
        self.limits = [abs(float(value)) for value in limits]
        self.speed = [0.0] * 6
        self.damping = DAMPING
        self.gain = DEFAULT_GAIN
        self.dead_zone: Sequence[float] | None = None

    def tune(self, damping: float, gain: float) -> None:
        """URScript's damping 0..1 and gain scaling 0..2. What they do to the numbers is assumed."""
        scale = (1 + math.log1p(damping / DEFAULT_DAMPING)) / (1 + math.log(2))
        self.damping = tuple(value * scale for value in DAMPING)  # type: ignore[assignment]
        self.gain = gain

    def same_axes(self, other: Compliance) -> bool:
        """Whether only what is asked of the axes differs, so that their speeds may go on."""
        return (self.kind, self.task, self.origin, self.axes) == (other.kind, other.task, other.origin, other.axes)

    def turn(self, position: Vector, twist: Sequence[float]) -> None:
        """Let the frame follow the TCP, as types 1 and 3 do (URScript manual, force_mode).

        1: the frame's y axis points from the TCP to the origin of the task frame. 3: its x axis is the TCP's velocity
        projected into the task frame's x-y plane, as long as there is one.
        """
        if self.kind == POINT:
            y = tuple(b - a for a, b in zip(position, self.origin, strict=True))
            self.frame = _with_y(y, self.task) or self.frame
        elif self.kind == MOTION:
            ahead, across, _ = frames.unrotate(self.task, twist[:3])
            speed = math.hypot(ahead, across)
            if speed > _STANDS:
                c, s = ahead / speed, across / speed
                self.frame = frames.product(self.task, (c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0))

    def blend(self, step: Step, felt: Sequence[float], dt: float) -> Step:
        """The motion's displacement with the selected axes' own in its place; `felt` is the wrench (6,), base_link."""
        frame, gain, dead_zone = self.frame, self.gain, self.dead_zone
        inside = [*frames.unrotate(frame, step[:3]), *frames.unrotate(frame, step[3:])]
        force = (*frames.unrotate(frame, felt[:3]), *frames.unrotate(frame, felt[3:]))
        for i in self.axes:
            rate = dt / INERTIA[i]
            push = gain * (self.wrench[i] + force[i])
            if dead_zone is not None:
                push = math.copysign(max(abs(push) - dead_zone[i], 0.0), push)
            speed = (self.speed[i] + rate * push) / (1 + rate * self.damping[i])
            limit = self.limits[i]
            self.speed[i] = speed = min(max(speed, -limit), limit)
            inside[i] = speed * dt
        return [*frames.rotate(frame, inside[:3]), *frames.rotate(frame, inside[3:])]

    def deviates(self, step: Step) -> bool:
        """Whether a deviation (6,) of the TCP, base_link, exceeds what the axes that are not compliant allow."""
        inside = (*frames.unrotate(self.frame, step[:3]), *frames.unrotate(self.frame, step[3:]))
        return any(abs(inside[i]) > self.limits[i] for i in self.others)

    def freeze(self) -> None:
        """Stand: nothing of the motion so far goes on."""
        self.speed = [0.0] * 6


def hand_guided(frame: Rotation, free: Sequence[int]) -> Compliance:
    """Freedrive along the `free` axes (6,) of a frame: the tool goes where it is pushed, and stays where it is left."""
    guided = Compliance(
        frame, free, [0.0] * 6, [v if f else math.inf for v, f in zip(_GUIDED_LIMITS, free, strict=True)]
    )
    guided.damping = tuple(value * _GUIDED_DAMPING for value in DAMPING)  # type: ignore[assignment]
    guided.dead_zone = _GUIDED_DEAD_ZONE
    return guided


def _with_y(towards: Sequence[float], task: Rotation) -> Rotation | None:
    """A rotation whose y axis points along `towards`, its x axis as near to the task frame's as that allows."""
    length = math.hypot(*towards)
    if length < 1e-9:
        return None
    y = [value / length for value in towards]
    for axis in (0, 2):  # the task frame's z where its x is the very direction
        x = [task[axis], task[axis + 3], task[axis + 6]]
        along = sum(a * b for a, b in zip(x, y, strict=True))
        x = [a - along * b for a, b in zip(x, y, strict=True)]
        size = math.hypot(*x)
        if size > _PARALLEL:
            break
    x = [value / size for value in x]
    z = [x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]]
    return (x[0], y[0], z[0], x[1], y[1], z[1], x[2], y[2], z[2])
