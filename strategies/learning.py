"""From the evidence in a goal to the belief about its hole: what every earlier search taught, in order."""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass

import numpy as np

from runtime.feasible_area import FeasibleArea
from runtime.hierarchy import BoardBelief, Expectations, Mixture, unlearned
from runtime.messages import Place, SearchGoal
from strategies.offset_grid import NODE_WEIGHTS, OffsetGrid, hit

Path = tuple[tuple[float, float], ...]

_BLOCK = 30  # boards: of those long gone only the last one or two blocks are learned from, so that work stays bounded
_NEAR = 2.8  # own units: attempts further apart have no place in common
_side = np.linspace(-1.5, 1.5, 21)
_AROUND = np.stack(np.meshgrid(_side, _side, indexing="ij"), axis=-1).reshape(-1, 2)  # own units, about a success
_REMEMBERED = 4  # beliefs kept, so that a search learns only what is new since the one before


@dataclass(frozen=True)
class Reading:
    """What an attempt says of where its hole is.

    A slid part comes to rest `slide_noise` [m] per axis from the middle of its hole. A pecked one stays within the
    feasible area of where it was tried, and tells no more: its pins bend.
    """

    size_spread: float  # of the feasible area's half axes, from part to part, relative
    slide_noise: float  # [m]
    swath: float = 0.9  # of the feasible area that catches pins that slide by, in
    catch: float = 0.9  # of all cases


@dataclass(frozen=True)
class _Lesson:
    """What one search taught: where the part went in, if it did, and where it did not."""

    board: int
    hole: str
    found: tuple[float, float] | None  # [m] the candidate that succeeded, or where a slid part came to rest
    slid: bool
    misses: tuple[Path, ...]  # of blocked attempts


def belief_at(goal: SearchGoal, area: FeasibleArea, reading: Reading) -> Mixture:
    """What is believed about the goal's hole, given all its evidence."""
    here = Place(goal.hole, goal.nominal.position.x, goal.nominal.position.y)
    layout = tuple(goal.layout)
    if goal.hole not in {place.hole for place in layout}:
        layout = (*layout, here)
    belief = _learned(layout, _lessons(goal, {place.hole for place in layout}), area, reading)
    return belief.on_board(goal.board).offset(goal.hole)


def _lessons(goal: SearchGoal, holes: set[str]) -> tuple[_Lesson, ...]:
    misses: dict[tuple[int, str], list[Path]] = {}
    for miss in goal.misses:
        if miss.hole in holes:
            path = tuple((point.x, point.y) for point in miss.path)
            misses.setdefault((miss.board, miss.hole), []).append(path)
    lessons = []
    for seat in goal.seats:
        if seat.hole not in holes:
            continue
        rest = (seat.seated_x, seat.seated_y)
        found = rest if seat.slid and all(map(math.isfinite, rest)) else (seat.x, seat.y)
        paths = tuple(misses.pop((seat.board, seat.hole), ()))
        lessons.append(_Lesson(seat.board, seat.hole, found, seat.slid, paths))
    lessons += [_Lesson(board, hole, None, False, tuple(paths)) for (board, hole), paths in misses.items()]
    boards = sorted({lesson.board for lesson in lessons})
    first = boards[max(len(boards) // _BLOCK - 1, 0) * _BLOCK] if boards else 0
    kept = [lesson for lesson in lessons if lesson.board >= first or lesson.board == goal.board]
    # The board at hand comes last: others that are worked on meanwhile, in other cells, may have higher numbers.
    # Stable: within a board in the order of arrival, what was not found after what was.
    return tuple(sorted(kept, key=lambda lesson: (lesson.board == goal.board, lesson.board)))


_Key = tuple[tuple[Place, ...], FeasibleArea, Reading]
_beliefs: OrderedDict[_Key, tuple[tuple[_Lesson, ...], BoardBelief]] = OrderedDict()


def _learned(
    layout: tuple[Place, ...], lessons: tuple[_Lesson, ...], area: FeasibleArea, reading: Reading
) -> BoardBelief:
    """The belief after all lessons. What was learned before is kept and gone on from: the result is the same."""
    key = (layout, area, reading)
    done, belief = _beliefs.pop(key, ((), None))
    if belief is None or lessons[: len(done)] != done:
        done, belief = (), unlearned(layout, Expectations())
    for lesson in lessons[len(done) :]:
        belief = _taught(belief.on_board(lesson.board), lesson, area, reading)
    _beliefs[key] = (lessons, belief)
    while len(_beliefs) > _REMEMBERED:
        _beliefs.popitem(last=False)
    return belief


def _taught(belief: BoardBelief, lesson: _Lesson, area: FeasibleArea, reading: Reading) -> BoardBelief:
    paths = [area.to_own(np.array(path)) for path in lesson.misses]
    if lesson.found is None:
        grid = OffsetGrid(area, belief.offset(lesson.hole), reading.size_spread)
        for path in paths:
            grid.failed(path, reading.swath, reading.catch)
        return belief.learned_by(lesson.hole, area.to_metres(grid.points().reshape(-1, 2)), grid.survival().ravel())
    if lesson.slid:
        return belief.learned(lesson.hole, lesson.found, reading.slide_noise)
    at = area.to_own(np.array(lesson.found))
    points = at + _AROUND
    likelihood = hit(area, reading.size_spread, at - points)  # (nodes, m)
    for path in paths:
        if len(path) == 1 and np.abs(path[0] - at).max() < _NEAR:
            likelihood *= 1 - hit(area, reading.size_spread, path[0] - points)
    return belief.learned_by(lesson.hole, area.to_metres(points), NODE_WEIGHTS @ likelihood)
