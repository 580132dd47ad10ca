"""Search patterns as offsets from their start [m], in the order in which they are tried. Pure geometry.

Equation numbers are the paper's. Every pattern begins at its start, (0, 0).
"""

from __future__ import annotations

import math
from collections.abc import Iterator

Offset = tuple[float, float]  # [m]


def line(stride: float, angle: float, cycles: int) -> Iterator[Offset]:
    """Eqs. 10-11: P_i = P_{i-1} + stride * i * (-1)^i along `angle` [rad]: 0, -s, +s, -2s, +2s, ...; i to `cycles`."""
    along = 0.0
    for i in range(cycles + 1):
        along += stride * i * (-1) ** i
        yield along * math.cos(angle), along * math.sin(angle)


def line_as_printed(stride: float, angle: float, cycles: int) -> Iterator[Offset]:
    """Eq. 18: P_i = P_{i-1} + stride * (-1)^i: oscillates between 0 and -s and reaches nothing else."""
    for i in range(cycles + 1):
        along = -stride * (i % 2)
        yield along * math.cos(angle), along * math.sin(angle)


def spiral_by_angle(step: float, pitch: float, radius: float) -> Iterator[Offset]:
    """Eqs. 12-17 as printed: an Archimedean spiral in constant angular steps theta_d = `step` [rad], to `radius`.

    `pitch` [m] per turn is r / t of Eqs. 12-13: r_cur of Eq. 15 = step * i * pitch / turn, up to and including r.
    Close-set at the centre, with gaps that grow outwards.
    """
    i = 0
    while (distance := pitch * step * i / (2 * math.pi)) <= radius * (1 + 1e-12):
        yield distance * math.cos(step * i), distance * math.sin(step * i)
        i += 1


def spiral_by_arc(arc: float, pitch: float, radius: float) -> Iterator[Offset]:
    """The spiral of Eqs. 12-17 in steps of constant length `arc` [m] along it, to `radius`.

    Beyond the first turns every point lies within half the diagonal of an arc x pitch cell of a tried one. With arc
    1.5 and pitch 1.2 feasible radii the widest gap anywhere is 0.97 of the feasible radius.
    """
    growth = pitch / (2 * math.pi)  # [m/rad]
    yield 0.0, 0.0
    angle = 4.5  # [rad] of the second point: begun earlier or later, the first turn leaves gaps about the centre
    while (distance := growth * angle) <= radius:
        yield distance * math.cos(angle), distance * math.sin(angle)
        angle += arc / math.hypot(distance, growth)


def spiral_as_printed(step: float, pitch: float, radius: float) -> Iterator[Offset]:
    """Eqs. 19-22 as printed: P_i = P_{i-1} + r_i (cos theta_i, sin theta_i), from r_0 = theta_0 = 0.

    Delta theta is `step` [rad] and Delta r is pitch * step / turn. Adds up the spiral instead of following it: strides
    grow with i and the centre drifts. Ends when r_i > `radius`. With P_0 in place of P_{i-1} it is `spiral_by_angle`.
    """
    x = y = 0.0
    i = 0
    while (distance := pitch * step * i / (2 * math.pi)) <= radius * (1 + 1e-12):
        x, y = x + distance * math.cos(step * i), y + distance * math.sin(step * i)
        yield x, y
        i += 1


def lattice(spacing: float, radius: float) -> list[Offset]:
    """Triangular lattice with this `spacing` [m], within `radius`, by distance from the start, then by angle.

    Discs of radius spacing / sqrt(3) about its points cover the plane.
    """
    rows = math.ceil(2 * radius / (math.sqrt(3) * spacing))
    points = []
    for row in range(-rows, rows + 1):
        y = row * spacing * math.sqrt(3) / 2
        columns = math.ceil(radius / spacing) + 1
        points += [((column + (row % 2) / 2) * spacing, y) for column in range(-columns, columns + 1)]
    inside = [point for point in points if math.hypot(*point) <= radius]
    return sorted(inside, key=lambda point: (round(math.hypot(*point) / spacing, 6), math.atan2(point[1], point[0])))
