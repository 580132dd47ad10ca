"""Shows a running session in Rerun, and leaves the cell its speed.

What is published all the time is taken a few times a second of machine time, and only the latest of it; what happens
once, attempts, goals and log lines among it, is never missed. The process sleeps in between and stands back for others.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from runtime import topics
from runtime.bus import Envelope
from runtime.clock import pause
from runtime.context import Context
from runtime.errors import InputError
from runtime.view.target import APPLICATION, FLUSH_TIMEOUT, Mode, has_display, target

if TYPE_CHECKING:
    from runtime.view.scene import Scene

REFRESH = 0.1  # [s] of machine time between two updates
NICENESS = 10  # added to that of the session
POSES = (topics.TF, topics.TCP_POSE)
POSES_KEPT = 2  # from one update to the next: a cell in real time moves in 20 steps a second
STREAMS = (topics.TRACE, topics.WRENCH, topics.PERMIT)
STREAM_KEPT = 64  # enough for a cell at full speed


@dataclass(frozen=True)
class Viewer:
    """Shows the running session."""

    mode: Mode = "spawn"
    path: str = ""  # of the .rrd file to write with mode "save"

    def run(self, context: Context) -> None:
        """Show what arrives until stopped."""
        if self.mode == "spawn" and not has_display():
            raise InputError("there is no display for Rerun's window; choose --rerun web, save or off")
        _stand_back()
        import rerun as rr

        from runtime.view.blueprint import empty_scene

        recording = rr.RecordingStream(APPLICATION, recording_id=context.session)
        with target(recording, self.mode, Path(self.path) if self.path else None, keep=True) as shown:
            cell = context.cell
            scene = empty_scene(recording, context.session, cell.board, cell.search.radius)
            bus = context.bus
            bus.subscribe(*(topic for topic in scene.topics if topic not in (*POSES, *STREAMS)))
            bus.subscribe_latest(POSES_KEPT, *POSES)
            bus.subscribe_latest(STREAM_KEPT, *STREAMS)
            context.ready()
            told = not shown.url
            while not context.stopping:
                pause(REFRESH)
                if _show(scene, context) and not told:
                    # only now: before the session begins the others may not listen yet
                    context.log(f"open {shown.url} to watch")
                    told = True
            _show(scene, context)
            scene.close()
            recording.flush(timeout_sec=FLUSH_TIMEOUT)


def _stand_back() -> None:
    """Give the session's other processes the first call on the machine; Rerun inherits it."""
    os.nice(NICENESS)  # on Linux of this thread alone, should the session have one process


def _show(scene: Scene, context: Context) -> bool:
    """Show what has come; whether anything has."""
    came, inbox = False, context.bus.inbox
    while len(inbox):
        if isinstance(item := inbox.poll(), Envelope):
            context.clock.advance(item.stamp)
            scene.show(item)
            came = True
    if came:
        scene.flush()
    return came
