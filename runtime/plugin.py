"""What a plugin author implements: a strategy, or a driver.

A plugin is a frozen dataclass. Its fields are its settings, filled from the cell file's table of the same name
(`[strategies.spiral]`), and checked there for key, type, unit and range. The first line of its docstring is what
`palpate plugins` shows.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, TypeAlias, runtime_checkable

from runtime.messages import Attempt, Proposal, SearchGoal

if TYPE_CHECKING:
    from runtime.context import Context

Search: TypeAlias = Generator[Proposal, Attempt, None]
"""One search for one hole: yields the next position, is sent what the arm felt there, ends when it knows no more."""


@runtime_checkable
class Strategy(Protocol):
    """Decides where to try next. Pure: the same goal and the same attempts give the same proposals.

    `search` has no bus, no clock and no thread, and draws random numbers only from `goal.seed`:

        def search(self, goal):
            for ring in itertools.count():
                for angle in (0.0, 2.1, 4.2):
                    attempt = yield Proposal(ring * 1e-4 * cos(angle), ring * 1e-4 * sin(angle))

    The search is closed when a part is seated or the goal's `max_attempts` are spent.
    """

    def search(self, goal: SearchGoal) -> Search:
        """Begin a search for one hole."""
        ...


@dataclass(frozen=True)
class SearchRecord:
    """How one search went."""

    board: int  # from 1
    hole: str
    seated: bool
    attempts: int
    search_time: float  # [s] of all attempts together
    part_time: float  # [s] from the goal until the part was let go
    travelled: float  # [m] between the positions of successive attempts
    offset: tuple[float, float]  # [m] of the true place from nominal: what the search was for


@dataclass(frozen=True)
class BareRun:
    """A job that a simulated arm did by itself: no bus, no log, no other plugin."""

    session_time: float  # [s]
    machine_time: float  # [s]
    physics_time: float  # [s] of machine time within the physics engine
    searches: tuple[SearchRecord, ...]
    attempts: tuple[Attempt, ...]  # of all searches, in order


@dataclass(frozen=True)
class Punctuality:
    """How well a simulated controller keeps its time on the network, with two clients connected."""

    packages: int  # that the first client received
    missing: int  # that it should have received too
    on_time_share: float  # of packages that arrived within 1 ms of when they were due
    gap_max: float  # [s] the longest between two packages
    commands: int  # that the second client gave
    command_p50: float  # [s] half of them were done within this
    command_p99: float  # [s]
    cycles: int  # of the control loop
    overruns: int  # of them began more than a cycle late


@runtime_checkable
class Driver(Protocol):
    """Owns one device, or one service of the cell, in a process of its own."""

    def run(self, context: Context) -> None:
        """Work until `context.stopping`; return with the device halted."""
        ...
