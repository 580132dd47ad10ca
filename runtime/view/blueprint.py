"""How the view is laid out: arm and board, the hole in hand, states, plots and text, all at first sight."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from runtime.cell import Board
from runtime.messages import BASE_FRAME
from runtime.view.board import BOARD
from runtime.view.close_up import CLOSE_UP, bounds
from runtime.view.scene import ARM, ATTEMPTS, DURATION, FORCE, FORCE_Z, INTERLOCK, LOG, SESSION, TOTAL, Scene
from runtime.view.tracks import TIMELINE

_BACKGROUND = (24, 27, 34)
_GREEN, _AMBER, _RED, _GREY, _BLUE = 0x2E9E5BFF, 0xD99A1CFF, 0xD64541FF, 0x6B7280FF, 0x3B82F6FF
_STATES: dict[str, dict[str, int]] = {
    INTERLOCK: {
        "permitted": _GREEN,
        "muted": _BLUE,
        "locked": _AMBER,
        "tripped": _RED,
        "fault": _RED,
        "emergency_stop": _RED,
    },
    ARM: {"normal": _GREEN, "reduced": _AMBER, "safeguard stop": _RED, "protective stop": _RED, "fault": _RED},
    SESSION: {"starting": _GREY, "running": _BLUE, "done": _GREEN, "closing": _GREY, "failed": _RED},
}


def empty_scene(recording: Any, name: str, board: Board | None, radius: float) -> Scene:
    """A scene with its layout and nothing in it yet, for searches within `radius` [m]."""
    recording.set_log_time_enabled(False)
    recording.set_log_tick_enabled(False)
    recording.send_recording_name(name)
    recording.send_blueprint(blueprint(board or Board("unknown", ()), radius))
    styles(recording)
    return Scene(recording, board)


def styles(recording: Any) -> None:
    """Colours and names of lines and lanes, which Rerun keeps with the data."""
    for entity, colours in _STATES.items():
        values = list(colours)
        lane = rr.StateConfiguration(
            values=values,
            labels=[value.lower() for value in values],
            colors=np.array(list(colours.values()), dtype=np.uint32),
        )
        recording.log(entity, lane, static=True)
    recording.log(
        FORCE, rr.SeriesLines(colors=(250, 204, 21), names="|F|", widths=1.5, aggregation_policy="MinMax"), static=True
    )
    recording.log(
        FORCE_Z, rr.SeriesLines(colors=(96, 165, 250), names="Fz", widths=1.5, aggregation_policy="MinMax"), static=True
    )
    steps = {"widths": 2.0, "interpolation_mode": "StepAfter", "aggregation_policy": "Off"}
    attempts = rr.SeriesLines(colors=(235, 94, 72), names="this search", **steps)
    recording.log(ATTEMPTS, attempts, static=True)
    total = rr.SeriesLines(colors=(186, 148, 240), names="in all", **steps)
    recording.log(TOTAL, total, static=True)
    recording.log(DURATION, rr.SeriesPoints(colors=(72, 199, 116), names="search", marker_sizes=5.0), static=True)


def blueprint(board: Board, radius: float) -> Any:
    """The layout for a board and searches within `radius` [m]."""
    x, y, z = board.x, board.y, board.z
    arm = _cell("Cell", (x + 0.42, y - 0.62, z + 0.52), (0.7 * x, y, z + 0.19), [f"- /{BOARD}/names"])
    close = _cell("Board", (x + 0.05, y - 0.15, z + 0.15), (x, y - 0.01, z), [])
    x_range, y_range = bounds(radius)
    hole = rrb.Spatial2DView(
        origin=f"/{CLOSE_UP}",
        name="Hole in hand: mm from nominal, seen from above",
        background=_BACKGROUND,
        visual_bounds=rrb.VisualBounds2D(x_range=x_range, y_range=y_range),
    )
    force = _plot("Force on the tool, N", "/plots/force")
    plots = rrb.Horizontal(
        _plot("Attempts", "/plots/attempts"),
        _plot("All attempts", "/plots/total"),
        _plot("Search time, s", "/plots/duration"),
    )
    lanes = [f"/{lane}" for lane in _STATES]
    states = rrb.StateTimelineView(origin="/", contents=lanes, name="Interlock, arm, session")
    columns = rrb.TextLogColumns(timeline_columns=[TIMELINE], text_log_columns=["loglevel", "body"])
    text = rrb.TextLogView(origin=f"/{LOG}", name="Log", columns=columns)
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                rrb.Horizontal(arm, close, column_shares=[5.5, 4.5]), states, text, row_shares=[5.8, 2.0, 2.2]
            ),
            rrb.Vertical(hole, force, plots, row_shares=[5.6, 2.2, 2.2]),
            column_shares=[6.0, 4.0],
        ),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        auto_views=False,
    )


def _cell(name: str, position: tuple[float, float, float], target: tuple[float, float, float], less: list[str]) -> Any:
    """A 3D view of arm and board, seen from `position` [m] towards `target` [m]."""
    return rrb.Spatial3DView(
        origin="/",
        contents=["/robot/**", "/cell/**", "/tf/**", *less],
        spatial_information=rrb.SpatialInformation(target_frame=BASE_FRAME),
        name=name,
        # as Rerun reads them, a URDF's shapes are wire frames
        defaults=[shape.from_fields(fill_mode="solid") for shape in (rr.Cylinders3D, rr.Boxes3D)],
        eye_controls=rrb.EyeControls3D(position=position, look_target=target, eye_up=(0.0, 0.0, 1.0)),
        background=_BACKGROUND,
        line_grid=rrb.LineGrid3D(visible=True, spacing=0.1, color=[70, 74, 84]),
    )


def _plot(name: str, origin: str) -> Any:
    return rrb.TimeSeriesView(origin=origin, name=name, plot_legend=rrb.PlotLegend(visible=origin == "/plots/force"))
