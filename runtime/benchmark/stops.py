"""What a log says of an arm that was stopped: when its commanded speed began to fall, and when it stood still."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from runtime.errors import LogError
from runtime.log.file import LogFile
from runtime.messages import NANOSECONDS, nanoseconds_of
from runtime.topics import PERMIT, TRACE

STANDING = 0.01  # [rad/s] a joint that is measured slower stands still: 5 mm/s half a metre from its axis


@dataclass(frozen=True)
class Stop:
    """What became of one broken beam. Times [s] since it broke."""

    moving: bool  # whether the arm was commanded to move when it broke
    command: float = 0.0  # until the first control cycle from which on the commanded speed falls
    standstill: float = 0.0  # until the commanded speed is zero, and every joint is measured to stand
    failure: str = ""  # why this was no stop; empty if it was one

    def later(self, delay: float) -> Stop:
        """The same, with the beam broken so much earlier [s]."""
        return replace(self, command=self.command + delay, standstill=self.standstill + delay)


@dataclass(frozen=True)
class Motion:
    """Speed of the fastest joint in every control cycle of a session."""

    start: int  # [ns] session time at which the first cycle begins
    period: int  # [ns]
    commanded: NDArray[np.float64]  # (cycles,) [rad/s]
    measured: NDArray[np.float64]  # (cycles,) [rad/s]

    def cycle_from(self, moment: int) -> int:
        """Number of the first cycle that begins at session time `moment` [ns] or later."""
        return -((self.start - moment) // self.period)

    def stop(self, beam: int, reset: int) -> Stop | None:
        """What became of a beam that broke at session time `beam` [ns], with a reset at `reset`; None: not recorded.

        The command comes with the first cycle of the unbroken fall that ends at zero. From then on nothing may be
        commanded until the reset.
        """
        first, end = self.cycle_from(beam), self.cycle_from(reset)
        if not 0 < first < end <= len(self.commanded):
            return None
        before = self.commanded[first - 1 : end - 1]
        commanded, measured = self.commanded[first:end], self.measured[first:end]
        moving = bool(before[0] > 0)
        halted = _after_last(commanded > 0)
        still = max(halted, _after_last(measured > STANDING))
        if not moving and halted:
            return Stop(moving, failure="the arm began to move after the beam had broken")
        if still == len(commanded):
            return Stop(moving, failure="the arm did not stand still before the reset")
        falling = _after_last(commanded[:halted] >= before[:halted])
        return Stop(moving, self._since(beam, first + falling), self._since(beam, first + still))

    def _since(self, moment: int, cycle: int) -> float:
        return (self.start + cycle * self.period - moment) / NANOSECONDS


def _after_last(where: NDArray[np.bool_]) -> int:
    """Index behind the last that is true; 0 if none is."""
    found = np.flatnonzero(where)
    return int(found[-1]) + 1 if len(found) else 0


def motion_of(log: LogFile) -> Motion:
    """The motion that a log's trace has. Raises LogError if cycles are missing."""
    targets, positions = [], []
    start = period = cycles = 0
    for _, trace in log.read(TRACE):
        first = nanoseconds_of(trace.header.stamp)
        if not cycles:
            period = round(trace.period * NANOSECONDS)
            start = first - period
        if first != start + (cycles + 1) * period:
            raise LogError(f"{log.path}: {TRACE.name} has a gap at {first / NANOSECONDS:.3f} s")
        targets.append(np.asarray(trace.target).reshape(-1, 6))
        positions.append(np.asarray(trace.position).reshape(-1, 6))
        cycles += len(targets[-1])
    if not cycles:
        raise LogError(f"{log.path}: {TRACE.name} is empty: there is no arm to judge")
    return Motion(start, period, _speeds(np.vstack(targets), period), _speeds(np.vstack(positions), period))


def _speeds(angles: NDArray[np.float64], period: int) -> NDArray[np.float64]:
    """Of the fastest joint (cycles,) [rad/s], from angles (cycles, 6)."""
    speeds: NDArray[np.float64] = np.abs(np.diff(angles, axis=0, prepend=angles[:1])).max(axis=1) / (
        period / NANOSECONDS
    )
    return speeds


@dataclass(frozen=True)
class Permits:
    """The interlock's words in a session."""

    said: tuple[int, ...]  # [ns] session time of each
    granted: tuple[bool, ...]

    def refused(self, begin: int, end: int) -> bool:
        """Whether motion was refused within [begin, end) [ns], and never granted."""
        words = self.granted[bisect_left(self.said, begin) : bisect_left(self.said, end)]
        return len(words) > 0 and not any(words)


def permits_of(log: LogFile) -> Permits:
    """The permits that a log has."""
    words = [(stamp, permit.granted) for stamp, permit in log.read(PERMIT)]
    return Permits(tuple(stamp for stamp, _ in words), tuple(granted for _, granted in words))
