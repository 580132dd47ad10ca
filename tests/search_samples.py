"""Searches as a cell reports them, for tests of what remembers them."""

from __future__ import annotations

import math

from search_world import attempt_at, goal_for

from runtime.messages import Attempt, Ending, Outcome, SearchResult, header

REAL = "real"


def found(search: int, hole: str = "h1", *, x: float = 1e-4, ending: Ending = Ending.INSERTED) -> SearchResult:
    seated = ending == Ending.INSERTED
    return SearchResult(
        header=header(0),
        search=search,
        board=1 + search // 10,
        hole=hole,
        component="igbt",
        ending=ending,
        reason="",
        attempts=2,
        x=x if seated else math.nan,
        y=-x if seated else math.nan,
        seated_x=x + 1e-5 if seated else math.nan,
        seated_y=math.nan,
        duration=1.0,
    )


def tries(search: int, hole: str = "h1") -> list[Attempt]:
    goal = goal_for(search=search, hole=hole, board=1 + search // 10)
    return [
        attempt_at(goal, 1, 0.0, 0.0, Outcome.BLOCKED),
        attempt_at(goal, 2, 1e-4, -1e-4, Outcome.SEATED),
    ]
