"""What a cell is made of, as plain values: boards, holes, tolerances, the work to do. `config` fills them from TOML."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal

from pydantic import Field

from runtime.quantity import Angle, Duration, Length, NotNegative, Positive

HOLE_RADIUS_LIMIT = 2.0  # standard deviations of a plated hole's radius: wider ones are sorted out by the board's maker
WIDEST_HOLE = 1.2e-4  # [m] of a plated hole's radius beyond the drawing's: what is left around it is the board

Name = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_.-]*$")]


@dataclass(frozen=True)
class Hole:
    """One place for a part: the centre of its hole pattern on the board."""

    name: Name
    x: Length  # [m] in the board's frame
    y: Length  # [m]
    orientation: Angle | None = None  # [rad] of the part about the board's normal; polar parts need one


@dataclass(frozen=True)
class Board:
    """A board type: what the drawing says, not where the holes really are."""

    type: Name  # key under which the posterior store remembers
    holes: tuple[Hole, ...]
    x: Length = 0.30  # [m] of the board's centre in base_link
    y: Length = 0.0  # [m]
    z: Length = 0.05  # [m] of the board's top face
    thickness: Annotated[Length, Positive] = 1.6e-3  # [m]

    def hole(self, name: str) -> Hole:
        """The hole of that name."""
        return next(hole for hole in self.holes if hole.name == name)


@dataclass(frozen=True)
class Tolerances:
    """How far the real world strays from the drawing: standard deviations that the simulation draws from.

    Only the simulated world reads this. A strategy that knew it would know the answer.
    """

    board_shift: Annotated[Length, NotNegative] = 0.1e-3  # [m] per axis, drawn for each board
    board_rotation: Annotated[Angle, NotNegative] = 1e-3  # [rad] about the board's centre, drawn for each board
    hole_bias: Annotated[Length, NotNegative] = 0.2e-3  # [m] per axis, drawn once for each hole of a board type
    part_scatter: Annotated[Length, NotNegative] = 0.05e-3  # [m] per axis, clamping and bent pins, drawn for each part
    part_rotation: Annotated[Angle, NotNegative] = 2e-3  # [rad] of the part in the gripper, drawn for each part
    abnormal_hole: int = 0  # number of the hole, from 1, whose parts scatter more; 0 for none
    abnormal_factor: Annotated[float, Field(ge=1)] = 3.0  # times part_scatter at that hole
    hole_radius: Annotated[Length, Field(ge=0, le=5e-5)] = (
        0.0  # [m] of plated holes, drawn for each place of each board
    )
    # Not scatter, but errors that a learner's model may not know of:
    common_error: Annotated[Length, NotNegative] = 0.0  # [m] of all places alike, in one random direction
    hole_radius_error: Annotated[Length, Field(ge=-1e-4, le=1e-4)] = 0.0  # [m] by which all are wider than drawn
    scatter_freedom: Annotated[float, NotNegative] = 0.0  # of Student's t for part_scatter; 0: normal
    drift: Annotated[Length, NotNegative] = 0.0  # [m] of all places from board to board, in one random direction
    jump: Annotated[Length, NotNegative] = 0.0  # [m] by which one hole moves, in a random direction
    jump_hole: int = 0  # number of that hole, from 1; 0 for none
    jump_board: Annotated[int, Field(ge=1)] = 6  # the first board on which it has moved


@dataclass(frozen=True)
class SearchLimits:
    """Bounds of one search."""

    radius: Annotated[Length, Positive] = 2e-3  # [m] the hole is expected within this distance of nominal
    max_attempts: Annotated[int, Field(ge=1, le=10_000)] = 150
    prior_width: Annotated[Length, Positive] = 0.5e-3  # [m] standard deviation believed before anything is known


@dataclass(frozen=True)
class Interruption:
    """A scripted reach into the light curtain, in session time."""

    at: Annotated[Duration, NotNegative]  # [s] the beam breaks
    clear_after: Annotated[Duration, Positive] = 2.0  # [s] later the field is clear again
    reset_after: Annotated[Duration, Positive] = 1.0  # [s] after that somebody presses reset


@dataclass(frozen=True)
class CurtainFault:
    """A scripted fault of the light curtain or its wiring. Reset is pressed twice: for the fault, and for the restart.

    `channel_1_stuck` (or 2): on whatever the field, without test pulses, as a wire that touches the supply.
    `channel_1_off` (or 2): off whatever the field, as a broken wire.
    """

    at: Annotated[Duration, NotNegative]  # [s]
    kind: Literal["channel_1_stuck", "channel_2_stuck", "channel_1_off", "channel_2_off"]
    ends_after: Annotated[Duration, Positive] = 2.0  # [s] later all is well again
    reset_after: Annotated[Duration, Positive] = 1.0  # [s] after that reset is pressed, and once more as long after


@dataclass(frozen=True)
class EmergencyStopPress:
    """A scripted press of the emergency stop, in session time."""

    at: Annotated[Duration, NotNegative]  # [s]
    release_after: Annotated[Duration, Positive] = 2.0  # [s] later the device is released
    reset_after: Annotated[Duration, Positive] = 1.0  # [s] after that somebody presses reset


@dataclass(frozen=True)
class MutingPass:
    """Scripted material that passes the two muting sensors one after the other, in session time."""

    at: Annotated[Duration, NotNegative]  # [s] it reaches the first
    second_after: Annotated[Duration, NotNegative] = 0.5  # [s] later the second
    lasts: Annotated[Duration, Positive] = 4.0  # [s] that it covers each of them


@dataclass(frozen=True)
class ResetPress:
    """A scripted press of the reset button, in session time: one that is too early or too long does nothing."""

    at: Annotated[Duration, NotNegative]  # [s]
    held: Annotated[Duration, Positive] = 0.2  # [s]


@dataclass(frozen=True)
class Safety:
    """Times of the safety chain, and what happens to the simulated light curtain and the buttons beside it."""

    deadline: Annotated[Duration, Field(ge=0.002, le=1.0)] = 0.2  # [s] a permit holds no longer than this
    discrepancy: Annotated[Duration, Field(gt=0.0, le=1.0)] = 0.05  # [s] both channels must agree within it
    filter_time: Annotated[Duration, Field(gt=0.0, le=0.01)] = 1e-3  # [s] an off pulse up to this long is a test
    test_interval: Annotated[Duration, Field(ge=0.1, le=60.0)] = 1.0  # [s] each channel shows a test pulse within it
    watch: Annotated[Duration, Field(ge=0.2, le=10.0)] = 2.0  # [s] a curtain silent for longer asks for a reset
    patience: Annotated[Duration, Field(ge=1.0, le=600.0)] = 15.0  # [s] without a permit until the arm gives up
    shortest_reset: Annotated[Duration, Field(ge=0.0, le=0.5)] = 0.03  # [s] a press below this is no reset
    longest_reset: Annotated[Duration, Field(gt=0.5, le=30.0)] = 3.0  # [s] nor is one beyond this
    muting_concurrency: Annotated[Duration, Field(gt=0.0, le=10.0)] = 4.0  # [s] both muting sensors within it
    muting_limit: Annotated[Duration, Field(gt=0.0, le=600.0)] = 30.0  # [s] muting lasts no longer
    interruptions: tuple[Interruption, ...] = field(default_factory=tuple)
    curtain_faults: tuple[CurtainFault, ...] = field(default_factory=tuple)
    emergency_stops: tuple[EmergencyStopPress, ...] = field(default_factory=tuple)
    mutings: tuple[MutingPass, ...] = field(default_factory=tuple)
    resets: tuple[ResetPress, ...] = field(default_factory=tuple)


@dataclass(frozen=True)
class Attendance:
    """Whether a person is there to be asked when the cell cannot go on by itself."""

    mode: Literal["unattended", "attended"] = "unattended"  # unattended: what fails is reported, the cell goes on

    @property
    def attended(self) -> bool:
        """Whether the cell waits for an answer."""
        return self.mode == "attended"
