"""All joint angles that put the flange at a pose, in closed form.

Joints 2, 3 and 4 have parallel axes, so the arm decouples: the wrist's centre gives the first joint, the tool's axis
the fifth and sixth, and a planar two-link triangle the rest. Up to eight configurations: shoulder left or right, wrist
up or down, elbow up or down. Frames are UR's: `base`, and the flange as UR's DH parameters have it, which is `tool0`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from drivers.ur3e import frames
from drivers.ur3e.frames import Rotation, Vector
from drivers.ur3e.parameters import JOINTS

# Denavit-Hartenberg lengths [m] from the joints' origins (UR's article on the DH parameters of its arms).
D1 = JOINTS[0].origin[2]
A2, A3 = JOINTS[2].origin[0], JOINTS[3].origin[0]
D4, D5, D6 = JOINTS[3].origin[2], -JOINTS[4].origin[1], JOINTS[5].origin[1]

_ROUNDING = 1e-9  # by which a cosine may exceed 1 at the edge of reach
_ALIGNED = 1e-9  # sine of the fifth joint below which the sixth cannot be told from the fourth


def inverse(position: Vector, rotation: Rotation, tie: float = 0.0) -> Iterator[tuple[float, ...]]:
    """Every configuration (6,) [rad], each angle in (-pi, pi]. `tie` [rad] is the sixth joint where any would do."""
    px, py, pz = position
    r = rotation
    wx, wy = px - D6 * r[2], py - D6 * r[5]
    reach = math.hypot(wx, wy)
    for shoulder in _both(_arc_cosine(D4, reach)):
        q1 = math.atan2(wy, wx) + math.pi / 2 + shoulder
        s1, c1 = math.sin(q1), math.cos(q1)
        for q5 in _both(_arc_cosine(px * s1 - py * c1 - D4, D6)):
            s5, c5 = math.sin(q5), math.cos(q5)
            q6 = tie
            if abs(s5) >= _ALIGNED:
                # The tool's x and y axes seen along the common axis of joints 2 to 4.
                q6 = math.atan2((-r[1] * s1 + r[4] * c1) / s5, (r[0] * s1 - r[3] * c1) / s5)
            s6, c6 = math.sin(q6), math.cos(q6)
            # Directions of the fourth link's x and y axes in base.
            x4 = tuple(c5 * (r[k] * c6 - r[k + 1] * s6) - s5 * r[k + 2] for k in (0, 3, 6))
            along = tuple(r[k] * s6 + r[k + 1] * c6 for k in (0, 3, 6))
            # From the second joint to the end of the third link, in the plane the arm bends in.
            ex, ey, ez = (
                p - D6 * r[k + 2] + D5 * along[i] for i, (k, p) in enumerate(zip((0, 3, 6), (px, py, pz), strict=True))
            )
            x, z = ex * c1 + ey * s1, ez - D1
            bend = x4[0] * c1 + x4[1] * s1
            for q3 in _both(_arc_cosine(x * x + z * z - A2 * A2 - A3 * A3, 2 * A2 * A3)):
                q2 = math.atan2(z, x) - math.atan2(A3 * math.sin(q3), A2 + A3 * math.cos(q3))
                q4 = math.atan2(x4[2], bend) - q2 - q3
                yield tuple(math.remainder(q, 2 * math.pi) for q in (q1, q2, q3, q4, q5, q6))


def nearest(position: Vector, rotation: Rotation, near: Sequence[float]) -> tuple[float, ...] | None:
    """The configuration (6,) [rad] within the joints' limits that is nearest to `near`, or None if there is none."""
    best: tuple[float, tuple[float, ...]] | None = None
    for q in inverse(position, rotation, near[5]):
        turned = [_turned(a, b, joint.reach) for a, b, joint in zip(q, near, JOINTS, strict=True)]
        distance = sum((a - b) ** 2 for a, b in zip(turned, near, strict=True))
        if best is None or distance < best[0]:
            best = (distance, tuple(turned))
    return best[1] if best else None


def flange(
    position: Vector, rotation: Rotation, tcp_position: Sequence[float], tcp_rotation: Rotation
) -> tuple[Vector, Rotation]:
    """Where the flange is, in the frame in which the TCP is at `position` and `rotation`."""
    turned = frames.product(rotation, frames.transpose(tcp_rotation))
    x, y, z = frames.rotate(turned, tcp_position)
    return (position[0] - x, position[1] - y, position[2] - z), turned


def _turned(angle: float, near: float, reach: float) -> float:
    candidates = [angle + turn * 2 * math.pi for turn in (-2, -1, 0, 1, 2)]
    allowed = [candidate for candidate in candidates if abs(candidate) <= reach + 1e-9] or [angle]
    return min(allowed, key=lambda candidate: abs(candidate - near))


def _arc_cosine(adjacent: float, hypotenuse: float) -> float | None:
    if abs(hypotenuse) < 1e-12:
        return None
    cosine = adjacent / hypotenuse
    if abs(cosine) > 1 + _ROUNDING:
        return None
    return math.acos(min(max(cosine, -1.0), 1.0))


def _both(angle: float | None) -> tuple[float, ...]:
    return () if angle is None else (angle, -angle)
