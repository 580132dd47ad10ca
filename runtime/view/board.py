"""The board in 3D: its nominal holes, the hole that is searched for, and the parts that have been inserted."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import rerun as rr

from runtime.cell import Board, Hole
from runtime.component import COMPONENTS, Component
from runtime.messages import BASE_FRAME, Ending, Point, Pose, Quaternion, SearchGoal, SearchResult

BOARD = "cell/board"
HELD = "cell/held"
HELD_FRAME = "tcp"
MARGIN = 0.025  # [m] of board around the outermost holes
AT_ORIGIN = Pose(Point(0.0, 0.0, 0.0), Quaternion(0.0, 0.0, 0.0, 1.0))
_IN_BASE = rr.CoordinateFrame(BASE_FRAME)
_PLATE = (28, 92, 62)
_HOLE = (222, 184, 92)
_CURRENT = (255, 196, 0)
_PIN = (205, 208, 212)
_BODIES = {"box": (38, 40, 46), "cylinder": (44, 66, 120)}
_RING = 9e-3  # [m] radius of the mark around the current hole


class BoardScene:
    """Draws one board at a time."""

    def __init__(self, recording: Any, board: Board) -> None:
        self._recording = recording
        self._board = board
        self._number = 0  # of the board that lies there
        for name in ("plate", "names", "holes", "current"):
            recording.log(f"{BOARD}/{name}", _IN_BASE, static=True)
        self._plate()

    def begin(self, goal: SearchGoal) -> None:
        """A search begins: mark its hole, and clear the board if it is a new one."""
        if goal.board != self._number:
            self._number = goal.board
            self._recording.log(f"{BOARD}/parts", rr.Clear(recursive=True))
        self._holes(COMPONENTS.get(goal.component))
        p = goal.nominal.position
        ring = [
            (p.x + _RING * math.cos(a), p.y + _RING * math.sin(a), p.z + 5e-4) for a in np.linspace(0, 2 * math.pi, 49)
        ]
        self._recording.log(f"{BOARD}/current", rr.LineStrips3D([ring], colors=_CURRENT, radii=6e-4))

    def finish(self, goal: SearchGoal, result: SearchResult) -> None:
        """A search is over: put the part where it went in."""
        self._recording.log(f"{BOARD}/current", rr.Clear(recursive=False))
        component = COMPONENTS.get(result.component)
        if result.ending == Ending.INSERTED and component is not None:
            p, q = goal.nominal.position, goal.nominal.orientation
            seat = Point(p.x + result.seated_x, p.y + result.seated_y, p.z - component.depth)
            draw_part(self._recording, f"{BOARD}/parts/{result.hole}", BASE_FRAME, component, Pose(seat, q))

    def _plate(self) -> None:
        board = self._board
        xs, ys = [hole.x for hole in board.holes], [hole.y for hole in board.holes]
        half = ((max(xs) - min(xs)) / 2 + MARGIN, (max(ys) - min(ys)) / 2 + MARGIN, board.thickness / 2)
        centre = (
            board.x + (max(xs) + min(xs)) / 2,
            board.y + (max(ys) + min(ys)) / 2,
            board.z - board.thickness / 2,
        )
        plate = rr.Boxes3D(centers=[centre], half_sizes=[half], colors=_PLATE, fill_mode="solid")
        self._recording.log(f"{BOARD}/plate", plate, static=True)
        names = [(board.x + hole.x, board.y + hole.y - 0.012, board.z + 1e-3) for hole in board.holes]
        labels = rr.Points3D(
            names, labels=[hole.name for hole in board.holes], radii=1e-4, colors=_HOLE, show_labels=True
        )
        self._recording.log(f"{BOARD}/names", labels, static=True)
        self._holes(None)

    def _holes(self, component: Component | None) -> None:
        """The nominal pattern of every hole: discs on the board's top, since the plate hides what is inside it."""
        radius = component.hole_radius if component is not None else 1e-3
        centres = [place for hole in self._board.holes for place in _pattern(self._board, hole, component)]
        discs = rr.Cylinders3D(centers=centres, radii=[radius], lengths=[2e-4], colors=_HOLE, fill_mode="solid")
        self._recording.log(f"{BOARD}/holes", discs)


def _pattern(board: Board, hole: Hole, component: Component | None) -> list[tuple[float, float, float]]:
    """Centres [m] of one part's holes in base_link. The part hangs tool down, so its y axis is mirrored."""
    yaw = hole.orientation or 0.0
    cosine, sine = math.cos(yaw), math.sin(yaw)
    points = component.holes if component is not None else ((0.0, 0.0),)
    return [
        (board.x + hole.x + cosine * x + sine * y, board.y + hole.y + sine * x - cosine * y, board.z) for x, y in points
    ]


def draw_part(recording: Any, entity: str, frame: str, component: Component, pose: Pose = AT_ORIGIN) -> None:
    """Body and pins of a part whose component frame (z out of the pins) is at `pose` in `frame`."""
    body, pins = component.body, component.pins
    q = pose.orientation
    turned = [(q.x, q.y, q.z, q.w)]
    x, y, z = body.size
    centre = [_placed(pose, (0.0, 0.0, -(body.standoff + z / 2)))]
    looks = {"colors": _BODIES[body.shape], "fill_mode": "solid", "quaternions": turned}
    if body.shape == "box":
        solid = rr.Boxes3D(centers=centre, sizes=[(x, y, z)], **looks)
    else:
        solid = rr.Cylinders3D(centers=centre, radii=[x / 2], lengths=[z], **looks)
    leads = rr.Boxes3D(
        centers=[_placed(pose, (pin.x, pin.y, -pin.length / 2)) for pin in pins],
        sizes=[(2 * pin.half_x, 2 * pin.half_y, pin.length) for pin in pins],
        quaternions=turned * len(pins),
        colors=_PIN,
        fill_mode="solid",
    )
    for name, shape in (("body", solid), ("pins", leads)):
        # the frame holds for all times, since Rerun looks for one even where there is nothing to draw yet
        recording.log(f"{entity}/{name}", rr.CoordinateFrame(frame), static=True)
        recording.log(f"{entity}/{name}", shape)


def _placed(pose: Pose, point: tuple[float, float, float]) -> tuple[float, float, float]:
    """A point [m] of the posed frame in the frame around it."""
    p, q = pose.position, pose.orientation
    axis, v = np.array([q.x, q.y, q.z]), np.array(point)
    x, y, z = v + 2 * np.cross(axis, np.cross(axis, v) + q.w * v)
    return (p.x + float(x), p.y + float(y), p.z + float(z))


def board_of(goals: list[SearchGoal]) -> Board:
    """The board as far as search goals tell: for logs that hold no cell file."""
    nominal = {goal.hole: goal.nominal for goal in goals}
    positions = [pose.position for pose in nominal.values()]
    x = sum(position.x for position in positions) / len(positions)
    y = sum(position.y for position in positions) / len(positions)
    holes = tuple(
        Hole(name, pose.position.x - x, pose.position.y - y, _yaw(pose)) for name, pose in sorted(nominal.items())
    )
    return Board("unknown", holes, x, y, positions[0].z)


def _yaw(pose: Pose) -> float:
    """Orientation [rad] about the board's normal of a part that hangs tool down."""
    return 2 * math.atan2(pose.orientation.y, pose.orientation.x)
