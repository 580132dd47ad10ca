"""The force-torque sensor in the wrist: what it measures besides the truth, and how the controller corrects it.

The magnitudes are chosen, since the maker states only a range and an accuracy. The sensor sits at the flange and
measures in the tool's frame.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from drivers.ur3e.frames import Rotation, Vector, unrotate
from drivers.ur3e.parameters import CYCLE, GRAVITY

_BLOCK = 4096  # cycles of noise drawn at once
_STREAM = 0x46542D73  # keeps this generator apart from others with the same seed


@dataclass(frozen=True)
class ForceTorqueNoise:
    """Imperfections of the sensor, as (force [N], torque [Nm]) pairs of standard deviations."""

    white: tuple[float, float] = (0.3, 0.010)
    correlation: float = 0.6  # of the noise from one cycle to the next
    bias: tuple[float, float] = (1.5, 0.05)  # constant for a session
    drift: tuple[float, float] = (0.02, 0.0004)  # random walk, per square root of a second
    cutoff: float = 60.0  # [Hz] of the low-pass filter


class ForceTorqueSensor:
    """Turns the true wrench in the flange into the measured one, cycle by cycle. Deterministic for a seed.

    Without `noise` it is ideal, and unfiltered.
    """

    def __init__(self, seed: int, noise: ForceTorqueNoise | None = None) -> None:
        self._noise = noise
        self._rng = np.random.default_rng([_STREAM, seed])
        self._mass = 0.0
        self._centre: Vector = (0.0, 0.0, 0.0)
        self._zero = [0.0] * 6
        self._down: Vector = (0.0, 0.0, -1.0)  # where the payload falls, in base_link
        self.external: Sequence[float] | None = None  # (6,) measured by another sensor, in place of this one
        self._smooth = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        self.raw = [0.0] * 6  # [N, Nm] measured, nothing corrected
        self.wrench = [
            0.0
        ] * 6  # [N, Nm] on the tool from outside at the flange, tool frame: payload and zero corrected
        self._block: list[list[float]] = []
        self._next = 0
        if noise is not None:
            self._gain = 1.0 - math.exp(-2 * math.pi * noise.cutoff * CYCLE)
            self._bias = self._rng.standard_normal(6) * _six(noise.bias)
            self._states: list[NDArray[np.float64]] = [np.zeros((1, 6)), np.zeros((1, 6))]

    def set_payload(self, mass: float, centre: Sequence[float]) -> None:
        """Mass [kg] and centre of mass (3,) [m] of all that hangs on the flange: what the controller believes."""
        self._mass, self._centre = mass, (centre[0], centre[1], centre[2])

    def set_gravity(self, down: Vector) -> None:
        """Where the payload falls, a unit vector in base_link: what the controller believes."""
        self._down = down

    def update(self, reading: Sequence[float], rotation: Rotation) -> None:
        """Take in one cycle: the wrench (6,) the arm exerts on the tool, and the tool's rotation in base_link."""
        if self._noise is None:
            rx, ry, rz, sx, sy, sz = (-value for value in reading)
        else:
            if self._next == len(self._block):
                self._draw(self._noise)
            a, b, c, d, e, f = self._block[self._next]
            self._next += 1
            gain = self._gain
            x, y, z, u, v, w = self._smooth
            fx, fy, fz, tx, ty, tz = reading
            x -= gain * (fx + x)
            y -= gain * (fy + y)
            z -= gain * (fz + z)
            u -= gain * (tx + u)
            v -= gain * (ty + v)
            w -= gain * (tz + w)
            self._smooth = (x, y, z, u, v, w)
            rx, ry, rz, sx, sy, sz = x + a, y + b, z + c, u + d, v + e, w + f
        if self.external is not None:
            rx, ry, rz, sx, sy, sz = self.external
        self.raw = [rx, ry, rz, sx, sy, sz]
        weight = GRAVITY * self._mass
        dx, dy, dz = self._down
        if dx or dy:
            gx, gy, gz = (weight * value for value in unrotate(rotation, self._down))
        else:
            weight *= dz
            gx, gy, gz = weight * rotation[6], weight * rotation[7], weight * rotation[8]
        cx, cy, cz = self._centre
        zx, zy, zz, zu, zv, zw = self._zero
        self.wrench = [
            rx - gx - zx,
            ry - gy - zy,
            rz - gz - zz,
            sx - (cy * gz - cz * gy) - zu,
            sy - (cz * gx - cx * gz) - zv,
            sz - (cx * gy - cy * gx) - zw,
        ]

    def zero(self) -> None:
        """Call what is measured now zero, in this orientation."""
        self._zero = [old + now for old, now in zip(self._zero, self.wrench, strict=True)]
        self.wrench = [0.0] * 6

    def at_tcp(self, offset: Sequence[float], rotation: Rotation) -> list[float]:
        """The corrected wrench (6,) moved to a TCP at `offset` [m] from the flange and turned into base_link."""
        fx, fy, fz, tx, ty, tz = self.wrench
        x, y, z = offset[0], offset[1], offset[2]
        tx, ty, tz = tx - (y * fz - z * fy), ty - (z * fx - x * fz), tz - (x * fy - y * fx)
        r = rotation
        return [
            r[0] * fx + r[1] * fy + r[2] * fz,
            r[3] * fx + r[4] * fy + r[5] * fz,
            r[6] * fx + r[7] * fy + r[8] * fz,
            r[0] * tx + r[1] * ty + r[2] * tz,
            r[3] * tx + r[4] * ty + r[5] * tz,
            r[6] * tx + r[7] * ty + r[8] * tz,
        ]

    def _draw(self, noise: ForceTorqueNoise) -> None:
        """The next block of bias, drift and low-passed noise: none of it depends on the wrench."""
        innovation = self._rng.standard_normal((_BLOCK, 6)) * (_six(noise.white) * math.sqrt(1 - noise.correlation**2))
        coloured = self._filter(0, 1.0, noise.correlation, innovation)
        smooth = self._filter(1, self._gain, 1.0 - self._gain, coloured)
        walk = self._rng.standard_normal((_BLOCK, 6)) * (_six(noise.drift) * math.sqrt(CYCLE))
        bias = self._bias + np.cumsum(walk, axis=0)
        self._bias = bias[-1]
        self._block = (smooth + bias).tolist()
        self._next = 0

    def _filter(self, index: int, gain: float, pole: float, values: NDArray[np.float64]) -> NDArray[np.float64]:
        result: Any
        result, self._states[index] = lfilter([gain], [1.0, -pole], values, axis=0, zi=self._states[index])
        filtered: NDArray[np.float64] = result
        return filtered


def _six(pair: tuple[float, float]) -> NDArray[np.float64]:
    return np.array([pair[0]] * 3 + [pair[1]] * 3)
