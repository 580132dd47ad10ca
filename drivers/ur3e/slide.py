"""Sliding: pins held on the board by a light force follow a path until they drop in, and are then pushed home.

Force mode presses along z while `speedL` moves across: the axes that are not compliant follow the program's motion
(URScript manual, force_mode), and ur-rtde runs both in threads of their own. Once the pins have sunk in, x and y give
way as well, so that the chamfers can pull the part over its holes; then force mode ends and `speedL` goes down until
depth or contact, as in a peck. How deep that came decides, never the drop.

Speed and force were chosen by the strip that is swept: 3264 slides over simulated holes, two parts, three directions,
eight at each of 17 distances from the holes' centre. At 10 mm/s all went in up to 0.9 of the clearance across, at
3 mm/s up to 0.9 to 1.0 of it: slower is hardly wider. With force mode as soft as ur-rtde makes it (gain 0.5, damping
0.025) it is 0.8 or more at 10 mm/s, while at 15 mm/s some pins run past their holes. 3 N sweep less than 4 N, and 5 N
press up to 9 N. The price of speed is that a drop is felt later: 0.1 mm past the centre at 10 mm/s, 0.2 to 0.4 mm with
the soft one. Whoever learns from the place of a drop has to allow for that, along the way of the slide.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from itertools import pairwise

from drivers.ur3e import frames
from drivers.ur3e.arm import Arm
from drivers.ur3e.touch import SkillSettings, Touch
from runtime.errors import InputError
from runtime.messages import Outcome

_ACCELERATION = 2.0  # [m/s2] across
_RETURN = 0.02  # [s] in which a deviation from the path is taken back
_AGAIN = 0.1e-3  # [m] pins caught twice within it are stuck
_GRACE = 1.0  # [s] a motion may take longer than its distance and speed say


class Polyline:
    """A path of straight lines through points [m]."""

    def __init__(self, points: Sequence[tuple[float, float]]) -> None:
        """Raises InputError if there is no point."""
        if not points:
            raise InputError("a slide needs a path of at least one point")
        self.points = [(float(x), float(y)) for x, y in points]
        self._starts = [0.0]  # [m] along the path at which each point is
        for (ax, ay), (bx, by) in pairwise(self.points):
            self._starts.append(self._starts[-1] + math.hypot(bx - ax, by - ay))

    @property
    def length(self) -> float:
        """[m]"""
        return self._starts[-1]

    def at(self, travelled: float) -> tuple[float, float]:
        """The point [m] that far [m] along the path, or its nearest end."""
        index = min(max(bisect_right(self._starts, travelled) - 1, 0), len(self.points) - 1)
        if index == len(self.points) - 1:
            return self.points[-1]
        (x, y), (dx, dy) = self.points[index], self.direction(travelled)
        along = max(travelled - self._starts[index], 0.0)
        return x + along * dx, y + along * dy

    def direction(self, travelled: float) -> tuple[float, float]:
        """Unit vector of the way on from there; that of the last line at the end, zero for a path without length."""
        index = bisect_right(self._starts, max(travelled, 0.0)) - 1
        while index >= len(self.points) - 1 or self._starts[index + 1] == self._starts[index]:
            index -= 1
            if index < 0:
                return 0.0, 0.0
        (ax, ay), (bx, by) = self.points[index], self.points[index + 1]
        length = self._starts[index + 1] - self._starts[index]
        return (bx - ax) / length, (by - ay) / length

    def progress(self, x: float, y: float, travelled: float) -> float:
        """How far [m] along the path somebody at (x, y) [m] is who was at `travelled`: never back, and no corner cut.

        From line to line: the projection onto the present one, and beyond its end that onto the next.
        """
        while travelled < self.length:
            (px, py), (dx, dy) = self.at(travelled), self.direction(travelled)
            end = self._starts[bisect_right(self._starts, travelled)]
            along = travelled + (x - px) * dx + (y - py) * dy
            if along < end:
                return max(travelled, along)
            travelled = end
        return travelled


class Slide:
    """The part of an attempt that begins with the pins on the board. Ends with force mode off and the arm at rest."""

    def __init__(
        self, arm: Arm, settings: SkillSettings, touch: Touch, nominal: tuple[float, float], path: Polyline
    ) -> None:
        """`path` is one of offsets from `nominal` [m], base_link."""
        self._arm, self._settings, self._touch = arm, settings, touch
        self._nominal, self._path = nominal, path
        self._level = self._height()  # [m] of the board where it was touched

    def run(self) -> None:
        """Slide until the part is seated, is stuck, or the path ends. Raises ArmError if stopped."""
        touch = self._touch
        caught = -math.inf
        try:
            while self._follow():
                if self._push_home():
                    touch.outcome, touch.reason = Outcome.SEATED, ""
                    return
                if touch.travelled - caught < _AGAIN:
                    touch.outcome, touch.reason = Outcome.BLOCKED, "the pins are caught at an edge"
                    return
                caught = touch.travelled
                self._level = self._height()
            if touch.expired:
                touch.outcome, touch.reason = Outcome.ABORTED, "the slide did not reach the end of its path in its time"
            else:
                touch.outcome, touch.reason = Outcome.BLOCKED, ""
        finally:
            self._arm.forceModeStop()

    def _follow(self) -> bool:
        """Go on along the path until the pins drop in, are caught, or arrive, and stop. Whether they may be in."""
        arm, settings, touch, path = self._arm, self._settings, self._touch, self._path
        touch.comply([0, 0, 1, 0, 0, 0], settings.slide_force)
        touch.allow((path.length - touch.travelled) / settings.slide_speed + _GRACE)
        resisted = 0
        try:
            while touch.travelled < path.length and not touch.expired:
                arm.speedL(self._twist(), _ACCELERATION)
                touch.cycle()
                touch.travelled = path.progress(*self._offset(), touch.travelled)
                touch.x, touch.y = path.at(touch.travelled)
                resisted = resisted + 1 if touch.resistance > settings.lateral_force else 0
                if resisted >= settings.contact_cycles or self._dropped():
                    return True
                self._level = max(self._level, self._height())
        finally:
            arm.speedStop(_ACCELERATION)
        touch.measure()
        return self._dropped()

    def _dropped(self) -> bool:
        return self._height() < self._level - self._settings.drop_depth

    def _push_home(self) -> bool:
        """Give way across until the part hangs free in its holes, then down until depth or contact. Whether it is in.

        Giving way all the time would let the sensor's zero error push the part about within its holes: the seated pose
        along a slide in x then strays by 50 to 99 um (sd), against 28 to 38 um.
        """
        touch, settings = self._touch, self._settings
        touch.ease(settings.slide_force)
        touch.allow(touch.full / settings.home_speed + _GRACE)
        touch.descend(settings.home_speed, settings.home_force)
        touch.measure()
        return touch.seated

    def _height(self) -> float:
        """Of the pin tips [m]."""
        return self._arm.getActualTCPPose()[2]

    def _offset(self) -> tuple[float, float]:
        """Where the TCP is, from nominal [m]. The commanded one will not do: pressing moves it by 50 um across."""
        x, y, _ = frames.turn_base(self._arm.getActualTCPPose()[:3])
        return x - self._nominal[0], y - self._nominal[1]

    def _twist(self) -> list[float]:
        """Along the path, and back to it from beside it; (6,) base."""
        travelled, speed = self._touch.travelled, self._settings.slide_speed
        (x, y), (px, py) = self._offset(), self._path.at(travelled)
        dx, dy = self._path.direction(travelled)
        aside = (dx * (py - y) - dy * (px - x)) / _RETURN
        aside = min(max(aside, -speed), speed)
        return frames.turn_base_wrench([dx * speed - dy * aside, dy * speed + dx * aside, 0.0, 0.0, 0.0, 0.0])
