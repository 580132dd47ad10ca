"""What changes many times a second, in columns: Rerun takes those a hundred times faster than single values.

There are two timelines: session time, and the number of the attempt in hand, to step from attempt to
attempt. An attempt begins with its candidate, the first one of a search with the search, and lasts until the next.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from runtime.messages import Pose, Transform

TIMELINE = "session_time"
ATTEMPT_LINE = "attempt"
PEAK_CYCLES = 10  # control cycles of 2 ms of which one force is drawn


@dataclass
class AttemptLine:
    """Counts attempts over session time."""

    _begun: list[int] = field(default_factory=list)  # [ns] when each attempt began
    _ended: bool = True  # whether the last one is over

    def begin(self, stamp: int) -> None:
        """The next attempt begins, unless none was made since the last beginning."""
        if self._ended:
            self._begun.append(stamp)
            self._ended = False

    def end(self) -> None:
        """An attempt is over."""
        self._ended = True

    @property
    def number(self) -> int:
        """Of the attempt in hand, from 1; 0 before the first."""
        return len(self._begun)

    def at(self, stamps: NDArray[np.int64]) -> NDArray[np.int64]:
        """The attempt in hand at each of these times [ns]."""
        return np.searchsorted(np.array(self._begun, dtype=np.int64), stamps, side="right")


@dataclass
class _Poses:
    """Poses of one frame."""

    parent: str
    child: str
    stamps: list[int] = field(default_factory=list)  # [ns]
    positions: list[tuple[float, float, float]] = field(default_factory=list)  # [m]
    rotations: list[tuple[float, float, float, float]] = field(default_factory=list)  # quaternions x, y, z, w


@dataclass
class Tracks:
    """Columns on their way to a recording."""

    recording: Any  # rerun.RecordingStream
    attempts: AttemptLine = field(default_factory=AttemptLine)
    _poses: dict[str, _Poses] = field(default_factory=dict)
    _numbers: dict[str, tuple[list[int], list[float]]] = field(default_factory=dict)

    def frame(self, entity: str, parent: str, child: str, stamp: int, transform: Transform) -> None:
        """Where a named frame is in its parent; kept until `flush`."""
        t, r = transform.translation, transform.rotation
        self._keep(entity, parent, child, stamp, (t.x, t.y, t.z), (r.x, r.y, r.z, r.w))

    def pose(self, entity: str, parent: str, child: str, stamp: int, pose: Pose) -> None:
        """The same, from a pose."""
        p, r = pose.position, pose.orientation
        self._keep(entity, parent, child, stamp, (p.x, p.y, p.z), (r.x, r.y, r.z, r.w))

    def _keep(self, entity: str, parent: str, child: str, stamp: int, position: Any, rotation: Any) -> None:
        poses = self._poses.setdefault(entity, _Poses(parent, child))
        poses.stamps.append(stamp)
        poses.positions.append(position)
        poses.rotations.append(rotation)

    def number(self, entity: str, stamp: int, value: float) -> None:
        """A point of a plotted line; kept until `flush`."""
        stamps, values = self._numbers.setdefault(entity, ([], []))
        stamps.append(stamp)
        values.append(value)

    def flush(self) -> None:
        """Hand over what has been gathered."""
        for entity, poses in self._poses.items():
            stamps = np.array(poses.stamps, dtype=np.int64)
            self.send_poses(entity, poses.parent, poses.child, stamps, poses.positions, poses.rotations)
        for entity, (stamps_of, values) in self._numbers.items():
            self.send_numbers(entity, np.array(stamps_of, dtype=np.int64), values)
        self._poses.clear()
        self._numbers.clear()

    def send_poses(
        self, entity: str, parent: str, child: str, stamps: NDArray[np.int64], positions: Any, rotations: Any
    ) -> None:
        """Hand over poses: stamps (n,) [ns], positions (n, 3) [m], rotations (n, 4) as quaternions x, y, z, w."""
        columns = rr.Transform3D.columns(
            translation=positions,
            quaternion=rotations,
            parent_frame=[parent] * len(stamps),
            child_frame=[child] * len(stamps),
        )
        self._send(entity, stamps, columns)

    def send_numbers(self, entity: str, stamps: NDArray[np.int64], values: Any) -> None:
        """Hand over points of a line: stamps (n,) [ns], values (n,)."""
        self._send(entity, stamps, rr.Scalars.columns(scalars=values))

    def send_states(self, entity: str, stamps: NDArray[np.int64], states: list[str]) -> None:
        """Hand over changes of a state: stamps (n,) [ns]."""
        self._send(entity, stamps, rr.StateChange.columns(state=states))

    def _send(self, entity: str, stamps: NDArray[np.int64], columns: Any) -> None:
        if len(stamps):
            times = rr.TimeColumn(TIMELINE, duration=stamps.astype("timedelta64[ns]"))
            steps = rr.TimeColumn(ATTEMPT_LINE, sequence=self.attempts.at(stamps))
            self.recording.send_columns(entity, indexes=[times, steps], columns=columns)


def strongest(forces: NDArray[np.float64], starts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Rows of `forces` (n, 3) [N] with the largest force of each group of rows; groups begin at the rows `starts`."""
    if not len(starts):
        return starts
    sizes = np.linalg.norm(forces, axis=1)
    groups = np.repeat(np.arange(len(starts)), np.diff(starts, append=len(sizes)))
    rows = np.flatnonzero(sizes == np.maximum.reduceat(sizes, starts)[groups])
    _, earliest = np.unique(groups[rows], return_index=True)
    return rows[earliest]


def every_few(cycles: NDArray[np.int64]) -> NDArray[np.int64]:
    """Rows at which groups of PEAK_CYCLES control cycles begin, anew with each message; `cycles` (messages,) long."""
    within = np.arange(cycles.sum()) - np.repeat(np.cumsum(cycles) - cycles, cycles)
    return np.flatnonzero(within % PEAK_CYCLES == 0)


def every_interval(stamps: NDArray[np.int64], interval: int) -> NDArray[np.int64]:
    """Rows at which another interval [ns] of session time begins; stamps (n,) [ns]."""
    return np.flatnonzero(np.diff(stamps // interval, prepend=-1))
