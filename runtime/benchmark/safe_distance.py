"""How far a light curtain has to stand from what moves: the minimum distance of ISO 13855:2010, 6.2."""

from __future__ import annotations

from runtime.errors import InputError

_REACH, _WALK = 2.0, 1.6  # [m/s] approach speed of a hand that is near, and of a person
_NEAR = 0.5  # [m] up to which the faster one is to be taken
_LEAST = 0.1  # [m]
_FINGER, _HAND, _COARSEST = 14e-3, 40e-3, 70e-3  # [m] resolutions
_ARM = 0.85  # [m] by which an arm can reach in through a curtain too coarse to see a hand


def minimum_distance(stop_time: float, resolution: float) -> float:
    """S = K T + C [m] of a vertical curtain that is approached at a right angle.

    `stop_time` T [s]: from the beam's interruption to the end of the dangerous motion, the curtain's own response time
    included. `resolution` d [m]: of the curtain. C = 8 (d - 14 mm) up to d = 40 mm, else 850 mm. K = 2 m/s, and
    1.6 m/s where the distance would exceed 500 mm. Raises InputError for a resolution that the standard does not cover.
    """
    if not 0 < resolution <= _COARSEST:
        raise InputError(f"a resolution of {1e3 * resolution:g} mm is none of a light curtain: above 0, up to 70 mm")
    if resolution > _HAND:
        return _WALK * stop_time + _ARM
    intrusion = 8 * max(0.0, resolution - _FINGER)
    near = _REACH * stop_time + intrusion
    if near <= _NEAR:
        return max(_LEAST, near)
    return max(_NEAR, _WALK * stop_time + intrusion)
