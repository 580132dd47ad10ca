"""What is said in a search: the goal, candidates, attempts, the result, and what is believed about a hole."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import IntEnum
from typing import ClassVar

from runtime.declaration import (
    Bool,
    Metres,
    Newtons,
    Number,
    Seconds,
    SquareMetres,
    Text,
    UInt8,
    UInt32,
    UInt64,
    message,
)
from runtime.messages.ros import Header, Pose, Wrench


class Outcome(IntEnum):
    """How an attempt ended."""

    SEATED = 1  # the pins reached their depth
    BLOCKED = 2  # contact before that depth
    ABORTED = 3  # neither: stopped, out of reach, or an error; the reason says which


class Ending(IntEnum):
    """How a search ended."""

    INSERTED = 1
    EXHAUSTED = 2  # the budget or the strategy's pattern ran out
    ABORTED = 3


@message
@dataclass(frozen=True, slots=True)
class Gaussian:
    """A two-dimensional normal distribution of a hole's offset from its nominal position, base_link frame."""

    x: Metres = 0.0
    y: Metres = 0.0
    xx: SquareMetres = math.nan  # not a number: no distribution is claimed
    xy: SquareMetres = math.nan
    yy: SquareMetres = math.nan

    __msgtype__: ClassVar[str]

    @property
    def known(self) -> bool:
        """Whether a covariance is claimed."""
        return not math.isnan(self.xx)


@message
@dataclass(frozen=True, slots=True)
class Seat:
    """Where one part went in: one piece of evidence about the holes of a board type."""

    session: Text  # session that found it
    board: UInt32  # number of the board, unlike that of any other board it is told with
    hole: Text
    x: Metres  # the candidate that succeeded
    y: Metres
    seated_x: Metres  # the TCP once the part was seated, as the robot reads it
    seated_y: Metres
    slid: Bool = False  # whether the pins dropped in on the way of a slide

    __msgtype__: ClassVar[str]


@message
@dataclass(frozen=True, slots=True)
class Waypoint:
    """A point that slid pins pass: offset from the nominal hole, base_link frame."""

    x: Metres
    y: Metres

    __msgtype__: ClassVar[str]


@message
@dataclass(frozen=True, slots=True)
class Miss:
    """One attempt of an earlier search that was blocked: where that hole was not."""

    board: UInt32
    hole: Text
    path: list[Waypoint]  # one point: a peck; more: a slide along them

    __msgtype__: ClassVar[str]


@message
@dataclass(frozen=True, slots=True)
class Place:
    """Where a hole is according to the drawing: nominal position, base_link frame."""

    hole: Text
    x: Metres
    y: Metres

    __msgtype__: ClassVar[str]


@message
@dataclass(frozen=True, slots=True)
class SearchGoal:
    """Find one hole for one part. All that a strategy may know."""

    header: Header
    search: UInt32  # number of the search within the session, from 1
    board: UInt32  # number of the board, from 1
    hole: Text
    component: Text
    nominal: Pose  # TCP (pin tips) at the top of the nominal hole, base_link frame
    feasible_radius: Metres  # radius of the disc with the area in which the part goes in
    search_radius: Metres  # the hole is expected within this distance of nominal
    max_attempts: UInt32
    seed: UInt64  # for strategies that draw random numbers
    prior: Gaussian  # the posterior store's belief about this hole; a wide one if nothing is known
    seats: list[Seat]  # every earlier insertion into boards of this type, oldest first
    misses: list[Miss] = field(default_factory=list)  # every attempt of earlier searches that was blocked
    layout: list[Place] = field(default_factory=list)  # every hole of the board, this one included

    __msgtype__: ClassVar[str]


@message
@dataclass(frozen=True, slots=True)
class Proposal:
    """The next position to try, or the next path to slide along: what a strategy yields."""

    x: Metres  # where the pins first touch the board
    y: Metres
    probability: Number = math.nan  # of success, as the strategy sees it
    belief: Gaussian = field(default_factory=Gaussian)  # what the strategy believes at this moment
    path: list[Waypoint] = field(default_factory=list)  # to slide along from (x, y) under light force; none: a peck

    __msgtype__: ClassVar[str]


@message
@dataclass(frozen=True, slots=True)
class Candidate:
    """A strategy's next position to try, or word that it has none left."""

    header: Header
    search: UInt32
    number: UInt32  # of the attempt within its search, from 1
    exhausted: Bool  # no further position: the search is over without a find
    reason: Text  # why it is exhausted
    proposal: Proposal

    __msgtype__: ClassVar[str]


@message
@dataclass(frozen=True, slots=True)
class Attempt:
    """What the arm felt at one candidate: a peck, or a slide if it had a path."""

    header: Header
    search: UInt32
    number: UInt32  # within the search, from 1
    board: UInt32
    hole: Text
    x: Metres  # commanded offset from nominal where it ended: of a seated part, where the pins dropped in
    y: Metres
    outcome: UInt8  # an Outcome
    reason: Text
    pose: Pose  # TCP at the end of the descent, base_link frame
    wrench: Wrench  # on the part at the TCP at the end of the descent, base_link frame
    depth: Metres  # of the pin tips below the board's nominal top
    peak_force: Newtons
    duration: Seconds  # from above the first place, or from where the attempt before ended, to the end of the retract
    path: list[Waypoint] = field(default_factory=list)  # commanded: first touch and the points slid along; none: a peck

    __msgtype__: ClassVar[str]


@message
@dataclass(frozen=True, slots=True)
class SearchResult:
    """How the search for one hole ended."""

    header: Header
    search: UInt32
    board: UInt32
    hole: Text
    component: Text
    ending: UInt8  # an Ending
    reason: Text
    attempts: UInt32
    x: Metres  # the candidate that succeeded; not a number if none did
    y: Metres
    seated_x: Metres
    seated_y: Metres
    duration: Seconds  # from goal to seated part or to giving up

    __msgtype__: ClassVar[str]


@message
@dataclass(frozen=True, slots=True)
class BeliefRequest:
    """Ask the posterior store what is known about a hole."""

    hole: Text
    board: UInt32  # number of the board under work; 0 if none is yet
    after_search: UInt32  # answer once this search's result is stored; 0 asks at once

    __msgtype__: ClassVar[str]


@message
@dataclass(frozen=True, slots=True)
class Belief:
    """What the posterior store knows about one hole of a board type."""

    header: Header
    board_type: Text
    hole: Text
    count: UInt32  # insertions the distribution rests on
    distribution: Gaussian
    seats: list[Seat]  # of all holes of the board type, oldest first
    misses: list[Miss] = field(default_factory=list)  # every blocked attempt, oldest first

    __msgtype__: ClassVar[str]


@message
@dataclass(frozen=True, slots=True)
class Merged:
    """Evidence that came or went by others' doing: other cells, or a person who imports or forgets."""

    header: Header
    after_search: UInt32  # of this session; it counts in all that is believed from then on
    entered: UInt32  # searches that count from now on
    withdrawn: UInt32  # searches that count no more
    seats: list[Seat]  # all that count now, oldest first
    misses: list[Miss]

    __msgtype__: ClassVar[str]


def slid_in(attempt: Attempt) -> bool:
    """Whether the pins dropped in on the way of a slide, not where they first touched the board."""
    if not attempt.path or attempt.outcome != Outcome.SEATED:
        return False
    first = attempt.path[0]
    return math.hypot(attempt.x - first.x, attempt.y - first.y) > 1e-9
