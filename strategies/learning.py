"""From the evidence in a goal to the belief about its hole: what every earlier search taught, in order."""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass

import numpy as np

from runtime.feasible_area import FeasibleArea
from runtime.hierarchy import BoardBelief, Expectations, Mixture, unlearned
from runtime.messages import Miss, Place, SearchGoal, Seat
from strategies.offset_grid import OffsetGrid

SWATH = 0.85  # of the feasible area that a slide catches, in
CATCH = 0.9  # of all cases
_BLOCK = 30  # boards: of those long gone only the last one or two blocks are learned from, so that work stays bounded
_REMEMBERED = 4  # beliefs kept, so that a search learns only what is new since the one before


@dataclass(frozen=True)
class _Lesson:
    """What one search taught: where the part went in, or where it did not."""

    board: int
    hole: str
    x: float  # [m] where the part came to rest; not a number: nowhere
    y: float
    noise: float  # [m] per axis
    misses: tuple[tuple[tuple[float, float], ...], ...] = ()  # [m] paths of the attempts of a search without a find


def belief_at(goal: SearchGoal, area: FeasibleArea, seat_noise: float, size_spread: float) -> Mixture:
    """What is believed about the goal's hole, given all its evidence."""
    layout = goal.layout or [Place(goal.hole, goal.nominal.position.x, goal.nominal.position.y)]
    known = {place.hole for place in layout}
    if goal.hole not in known:
        layout = [*layout, Place(goal.hole, goal.nominal.position.x, goal.nominal.position.y)]
    lessons = _lessons(goal, known, seat_noise)
    belief = _learned(tuple(layout), lessons, area, size_spread)
    return belief.on_board(goal.board).offset(goal.hole)


def _lessons(goal: SearchGoal, known: set[str], seat_noise: float) -> tuple[_Lesson, ...]:
    ours = {*known, goal.hole}
    found = [_found(seat, seat_noise, goal.feasible_radius) for seat in goal.seats if seat.hole in ours]
    lost: dict[tuple[int, str], list[Miss]] = {}
    for miss in goal.misses:
        if miss.hole in ours:
            lost.setdefault((miss.board, miss.hole), []).append(miss)
    for (board, hole), misses in lost.items():
        paths = tuple(tuple((point.x, point.y) for point in miss.path) for miss in misses)
        found.append(_Lesson(board, hole, math.nan, math.nan, 0.0, paths))
    boards = sorted({lesson.board for lesson in found})
    first = boards[max(len(boards) // _BLOCK - 1, 0) * _BLOCK] if boards else 0
    # Stable: within a board in the order of arrival, what was not found after what was.
    return tuple(sorted((lesson for lesson in found if lesson.board >= first), key=lambda lesson: lesson.board))


def _found(seat: Seat, seat_noise: float, radius: float) -> _Lesson:
    if math.isfinite(seat.seated_x) and math.isfinite(seat.seated_y):
        return _Lesson(seat.board, seat.hole, seat.seated_x, seat.seated_y, seat_noise)
    # A success tells no more than that the hole is within the area about the candidate.
    return _Lesson(seat.board, seat.hole, seat.x, seat.y, radius / 2)


_Key = tuple[tuple[Place, ...], float]
_beliefs: OrderedDict[_Key, tuple[tuple[_Lesson, ...], BoardBelief]] = OrderedDict()


def _learned(
    layout: tuple[Place, ...], lessons: tuple[_Lesson, ...], area: FeasibleArea, size_spread: float
) -> BoardBelief:
    """The belief after all lessons. What was learned before is kept and gone on from: the result is the same."""
    key = (layout, size_spread)
    done, belief = _beliefs.pop(key, ((), None))
    if belief is None or lessons[: len(done)] != done:
        done, belief = (), unlearned(layout, Expectations())
    for lesson in lessons[len(done) :]:
        belief = _taught(belief.on_board(lesson.board), lesson, area, size_spread)
    _beliefs[key] = (lessons, belief)
    while len(_beliefs) > _REMEMBERED:
        _beliefs.popitem(last=False)
    return belief


def _taught(belief: BoardBelief, lesson: _Lesson, area: FeasibleArea, size_spread: float) -> BoardBelief:
    if math.isfinite(lesson.x):
        return belief.learned(lesson.hole, (lesson.x, lesson.y), lesson.noise)
    grid = OffsetGrid(area, belief.offset(lesson.hole), size_spread)
    for path in lesson.misses:
        points = area.to_own(np.array(path))
        grid.miss(points[0])
        if len(points) > 1:
            grid.passed(points, SWATH, CATCH)
    points = area.to_metres(grid.points().reshape(-1, 2))
    return belief.learned_by(lesson.hole, points, grid.survival().ravel())
