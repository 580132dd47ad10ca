"""What goes wrong in the simulated cell when its file says so: to see what a cell does about it, and to test that."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from drivers.ur3e.arm import PROTECTIVE_STOP

if TYPE_CHECKING:
    from drivers.ur3e.scene import Scene
    from drivers.ur3e.simulated_arm import SimulatedArm

_NEAR = 0.5e-3  # [m] of the pin tips above the board, from where on things go wrong
_PUSH = (0.0, 120.0, 0.0, 0.0, 0.0, 0.0)  # [N, Nm] at the gripper, beyond what the arm bears
_CLOSED = 1.2e-3  # [m] below the board's top at which holes are closed


@dataclass(frozen=True)
class Mishap:
    """Something that goes wrong in one attempt, once the pins come down to the board.

    `drop`: the gripper loses its part. `push`: something pushes at the gripper with 120 N until the arm stops itself.
    `jam`: the holes are closed with solder 1.2 mm below the board's top, so that pins go in that far.
    """

    kind: Literal["drop", "push", "jam"]
    search: Annotated[int, Field(ge=1)]  # number of the search within the session
    attempt: Annotated[int, Field(ge=1)] = 1  # within the search


@dataclass
class MishapScript:
    """The mishaps of a session."""

    mishaps: Sequence[Mishap]
    scene: Scene
    _due: list[Mishap] = field(default_factory=list)  # in this attempt
    _pushing: bool = False

    @contextmanager
    def during(self, search: int, attempt: int) -> Iterator[None]:
        """Let happen what is to happen in an attempt, which lasts as long as the block."""
        self._due = [mishap for mishap in self.mishaps if (mishap.search, mishap.attempt) == (search, attempt)]
        if any(mishap.kind == "jam" for mishap in self._due):
            self.scene.close_holes(_CLOSED)
        try:
            yield
        finally:
            self._due.clear()
            self.scene.close_holes(None)

    def cycle(self, arm: SimulatedArm) -> None:
        """After every control cycle."""
        if self._pushing and arm.safety_mode == PROTECTIVE_STOP:
            self._pushing = False
            self.scene.push([0.0] * 6)
        if not self._due or arm.pose[0][2] > self.scene.board.z + _NEAR:
            return
        kinds = {mishap.kind for mishap in self._due}
        self._due.clear()
        if "drop" in kinds:
            self.scene.release()
        if "push" in kinds:
            self._pushing = True
            self.scene.push(_PUSH)
