"""The close-up of one hole: offsets from its nominal position in millimetres, seen from above."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from runtime.belief import ellipse
from runtime.messages import Attempt, Candidate, Gaussian, Outcome, SearchGoal, Truth

CLOSE_UP = "hole"
BLOCKED = (235, 94, 72)
SEATED = (72, 199, 116)
ABORTED = (150, 150, 158)
NEXT = (255, 214, 64)
BELIEF = (96, 165, 250)
EARLIER = (186, 148, 240)
TRUE = (150, 205, 160, 110)
GRID = (88, 92, 104)
TEXT = (205, 208, 216)
_COLOURS = {Outcome.BLOCKED: BLOCKED, Outcome.SEATED: SEATED, Outcome.ABORTED: ABORTED}
_CIRCLE = np.linspace(0.0, 2 * math.pi, 73)
_MM = 1e3


def bounds(radius: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """What the view shows [mm] of searches within `radius` [m]: x range, y range (2D views have y downwards)."""
    reach = radius * _MM
    return (-1.2 * reach, 1.2 * reach), (-1.32 * reach, 1.2 * reach)


class CloseUp:
    """Draws the search in hand."""

    def __init__(self, recording: Any) -> None:
        self._recording = recording
        self._attempts: list[Attempt] = []
        self._radius = 0.0  # [m]

    def begin(self, goal: SearchGoal) -> None:
        """A new hole: its search radius, what is believed, and where parts went in before."""
        self._attempts = []
        for name in ("attempts", "slides", "next", "true"):
            self._log(name, rr.Clear(recursive=False))
        if goal.search_radius != self._radius:
            self._radius = goal.search_radius
            self._background()
        reach = self._radius * _MM
        title = f"board {goal.board}, hole {goal.hole}"
        self._log("title", _label((0.0, 1.25 * reach), title, TEXT))
        self._belief(goal.prior)
        earlier = [(seat.x * _MM, seat.y * _MM) for seat in goal.seats if seat.hole == goal.hole]
        self._log("earlier_seats", _points(earlier, EARLIER, 0.016 * reach, 3.0))

    def truth(self, truth: Truth, feasible_radius: float) -> None:
        """Where the TCP must really go, as the simulation knows."""
        centre = (truth.offset_x * _MM, truth.offset_y * _MM)
        rings = [_ring(centre, feasible_radius * _MM)]
        self._log("true", rr.LineStrips2D(rings, colors=TRUE, radii=0.008 * self._radius * _MM, draw_order=2.0))

    def candidate(self, candidate: Candidate) -> None:
        """The next position to try, and what the strategy believes."""
        if candidate.exhausted:
            self._log("next", rr.Clear(recursive=False))
            return
        place = candidate.proposal
        reach = self._radius * _MM
        lines = [_ring((place.x * _MM, place.y * _MM), 0.045 * reach)]
        if place.path:
            lines.append(_way([(place.x, place.y), *((point.x, point.y) for point in place.path)]))
        self._log("next", rr.LineStrips2D(lines, colors=NEXT, radii=0.011 * reach, draw_order=40.0))
        if place.belief.known:
            self._belief(place.belief)

    def attempt(self, attempt: Attempt) -> None:
        """What was felt."""
        self._attempts.append(attempt)
        colours = [_COLOURS.get(Outcome(item.outcome), ABORTED) for item in self._attempts]
        places = [(item.x * _MM, item.y * _MM) for item in self._attempts]
        reach = self._radius * _MM
        self._log("attempts", _points(places, colours, 0.024 * reach, 30.0))
        slid = [_way(_slid(item)) for item in self._attempts if item.path]
        shades = [colour for colour, item in zip(colours, self._attempts, strict=True) if item.path]
        if slid:
            self._log("slides", rr.LineStrips2D(slid, colors=shades, radii=0.006 * reach, draw_order=25.0))
        self._log("next", rr.Clear(recursive=False))

    def _belief(self, belief: Gaussian) -> None:
        if not belief.known:
            self._log("belief", rr.Clear(recursive=False))
            return
        rings = [ellipse(belief, sigma) * (_MM, -_MM) for sigma in (1.0, 2.0)]  # 2D views have y downwards
        reach = self._radius * _MM
        widths = [0.009 * reach, 0.005 * reach]
        self._log("belief", rr.LineStrips2D(rings, colors=[BELIEF, (*BELIEF, 150)], radii=widths, draw_order=10.0))

    def _background(self) -> None:
        reach = self._radius * _MM
        step = 10 ** math.floor(math.log10(reach)) / (1 if reach / 10 ** math.floor(math.log10(reach)) >= 2 else 2)
        ticks = [count * step for count in range(1, int(reach / step + 1e-9) + 1)]
        rings = [_ring((0.0, 0.0), tick) for tick in ticks if tick < reach * 0.999]
        cross = [[(-reach, 0.0), (reach, 0.0)], [(0.0, -reach), (0.0, reach)]]
        fine = 0.003 * reach
        self._log("grid/lines", rr.LineStrips2D([*cross, *rings], colors=GRID, radii=fine, draw_order=0.0))
        edge = rr.LineStrips2D([_ring((0.0, 0.0), reach)], colors=TEXT, radii=2 * fine, draw_order=1.0)
        self._log("grid/search_radius", edge)
        labels = [f"{tick:g} mm" for tick in ticks]
        self._log("grid/scale", _labels([_seen((tick, 0.0)) for tick in ticks], labels, GRID))
        self._legend(reach)

    def _legend(self, reach: float) -> None:
        entries = [
            ("blocked", BLOCKED),
            ("seated", SEATED),
            ("next", NEXT),
            ("belief (1, 2 sd)", BELIEF),
            ("earlier seats", EARLIER),
            ("true place", TRUE[:3]),
        ]
        places = [_seen((-1.25 * reach, (1.2 - 0.15 * index) * reach)) for index in range(len(entries))]
        self._log("legend", _labels(places, [text for text, _ in entries], [colour for _, colour in entries]))

    def _log(self, name: str, what: Any) -> None:
        self._recording.log(f"{CLOSE_UP}/{name}", what)


def _seen(place: tuple[float, float]) -> tuple[float, float]:
    """Turn y, which 2D views draw downwards."""
    return (place[0], -place[1])


def _ring(centre: tuple[float, float], radius: float) -> NDArray[np.float64]:
    return np.stack([centre[0] + radius * np.cos(_CIRCLE), -(centre[1] + radius * np.sin(_CIRCLE))], axis=1)


def _slid(attempt: Attempt) -> list[tuple[float, float]]:
    """What of its path [m] an attempt slid along: all, or up to the point nearest to where the pins dropped in."""
    way = [(point.x, point.y) for point in attempt.path]
    if attempt.outcome == Outcome.BLOCKED:
        return way
    end = (attempt.x, attempt.y)
    detours = [math.dist(a, end) + math.dist(end, b) - math.dist(a, b) for a, b in pairwise(way)]
    last = min(range(len(detours)), key=detours.__getitem__) if detours else 0
    return [*way[: last + 1], end]


def _way(points: list[tuple[float, float]]) -> NDArray[np.float64]:
    return np.array([_seen((x * _MM, y * _MM)) for x, y in points])


def _points(places: list[tuple[float, float]], colours: Any, radius: float, order: float) -> Any:
    return rr.Points2D([_seen(place) for place in places], colors=colours, radii=radius, draw_order=order)


def _labels(places: list[tuple[float, float]], labels: list[str], colours: Any) -> Any:
    return rr.Points2D(places, labels=labels, colors=colours, radii=1e-4, show_labels=True, draw_order=50.0)


def _label(place: tuple[float, float], text: str, colour: Any) -> Any:
    return _labels([_seen(place)], [text], colour)
