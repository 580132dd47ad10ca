"""What each message looks like in Rerun: one handler per topic, for live views and finished logs alike.

Entities:   robot/, cell/   3D: the arm, the board, the part in the gripper
            hole/           2D: the search in hand
            plots/          lines over session time
            interlock, arm, session    lanes of states
            log             text
"""

from __future__ import annotations

import logging
import math
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
from rerun.urdf import UrdfTree

from runtime import messages as m
from runtime import topics
from runtime.bus import Envelope
from runtime.cell import Board
from runtime.component import COMPONENTS
from runtime.errors import BusError
from runtime.topics import Topic
from runtime.view_board import HELD, HELD_FRAME, BoardScene, board_of, draw_part
from runtime.view_close_up import CloseUp
from runtime.view_tracks import TIMELINE, Tracks

INTERVAL = 50_000_000  # [ns] of session time between two samples of what is published all the time
ROBOT = "robot"
PEAK_CYCLES = 10  # control cycles of 2 ms of which one force is drawn
FORCE_Z, FORCE = "plots/force/Fz", "plots/force/F"
ATTEMPTS = "plots/attempts/this_search"
TOTAL = "plots/total/attempts"
DURATION = "plots/duration/search"
LOG = "log"
INTERLOCK, ARM, SESSION = "interlock", "arm", "session"
_SAFETY_MODES = {  # UR RTDE guide, safety_mode
    1: "normal", 2: "reduced", 3: "protective stop", 4: "recovery", 5: "safeguard stop", 6: "emergency stop",
    7: "emergency stop", 8: "violation", 9: "fault",
}  # fmt: skip
_LEVELS = {10: "DEBUG", 20: "INFO", 30: "WARN", 40: "ERROR", 50: "CRITICAL"}  # rcl_interfaces/msg/Log


class Scene:
    """Draws a session into a recording."""

    def __init__(self, recording: Any, board: Board | None = None, interval: int = INTERVAL) -> None:
        self._recording = recording
        self._interval = interval
        self._tracks = Tracks(recording)
        self._board = BoardScene(recording, board) if board is not None else None
        self._close_up = CloseUp(recording)
        self._goal: m.SearchGoal | None = None
        self._total = 0
        self._states: dict[str, str] = {}
        self._holding = ""  # component in the gripper
        self._shown: dict[str, int] = {}  # stamp of the last sample by topic [ns]
        self._peak: tuple[int, m.Vector3] | None = None  # strongest force since the last sample
        self._traced = False
        self._now = -1
        self._handlers: dict[str, tuple[Topic[Any], Callable[[Any, int], None]]] = {}
        for topic, handler in self._all_handlers():
            self._handlers[topic.name] = (topic, handler)

    def _all_handlers(self) -> list[tuple[Topic[Any], Callable[[Any, int], None]]]:
        return [
            (topics.ROBOT_DESCRIPTION, self._robot),
            (topics.TF, self._frames),
            (topics.TF_STATIC, self._fixed_frames),
            (topics.TCP_POSE, self._tcp),
            (topics.WRENCH, self._wrench),
            (topics.TRACE, self._trace),
            (topics.SEARCH_GOAL, self._begin),
            (topics.TRUTH, self._truth),
            (topics.CANDIDATE, self._candidate),
            (topics.ATTEMPT, self._attempt),
            (topics.SEARCH_RESULT, self._finish),
            (topics.ARM_STATUS, self._arm),
            (topics.PERMIT, self._permit),
            (topics.SESSION, self._session),
            (topics.ROSOUT, self._rosout),
        ]

    @property
    def topics(self) -> list[Topic[Any]]:
        """What there is something to show of."""
        return [topic for topic, _ in self._handlers.values()]

    def show(self, envelope: Envelope) -> None:
        """Draw one message; those with nothing to show are passed over."""
        if envelope.topic not in self._handlers:
            return
        topic, handler = self._handlers[envelope.topic]
        if topic in (topics.TF, topics.TCP_POSE) and not self._due(envelope):
            return
        try:
            message = envelope.read(topic)
        except BusError as error:
            self._say(envelope.stamp, "viewer", 30, f"a message is not shown: {error}")
            return
        if envelope.stamp != self._now:
            self._now = envelope.stamp
            self._recording.set_time(TIMELINE, duration=np.timedelta64(envelope.stamp, "ns"))
        handler(message, envelope.stamp)

    def flush(self) -> None:
        """Hand over what has been gathered."""
        self._tracks.flush()

    def _due(self, envelope: Envelope) -> bool:
        last = self._shown.get(envelope.topic)
        if last is not None and last <= envelope.stamp < last + self._interval:
            return False
        self._shown[envelope.topic] = envelope.stamp
        return True

    def _robot(self, message: m.String, _: int) -> None:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "robot.urdf"
            path.write_text(message.data, encoding="utf-8")
            try:
                tree = UrdfTree.from_file_path(path, entity_path_prefix=ROBOT)
            except Exception as error:  # rerun raises several types
                self._say(self._now, "viewer", 30, f"the robot's description cannot be drawn: {error}")
                return
            self._recording.send_chunks(tree.stream(include_joint_transforms=False))
            for joint in tree.joints():
                if joint.joint_type == "fixed":
                    self._recording.log(f"tf/{joint.child_link}", joint.compute_transform(0.0), static=True)

    def _frames(self, message: m.TFMessage, stamp: int) -> None:
        for item in message.transforms:
            child = item.child_frame_id
            self._tracks.frame(f"tf/{child}", item.header.frame_id, child, stamp, item.transform)

    def _fixed_frames(self, message: m.TFMessage, _: int) -> None:
        for item in message.transforms:
            t, r = item.transform.translation, item.transform.rotation
            transform = rr.Transform3D(
                translation=(t.x, t.y, t.z),
                quaternion=(r.x, r.y, r.z, r.w),
                parent_frame=item.header.frame_id,
                child_frame=item.child_frame_id,
            )
            self._recording.log(f"tf/{item.child_frame_id}", transform, static=True)

    def _tcp(self, message: m.PoseStamped, stamp: int) -> None:
        self._tracks.pose(HELD, m.BASE_FRAME, HELD_FRAME, stamp, message.pose)

    def _wrench(self, message: m.WrenchStamped, stamp: int) -> None:
        """Of each interval the strongest force is shown, so that no contact is missed."""
        if self._traced:
            return
        force = message.wrench.force
        if self._peak is None or _size(force) > _size(self._peak[1]):
            self._peak = (stamp, force)
        last = self._shown.setdefault(topics.WRENCH.name, stamp)
        if stamp - last >= self._interval or stamp <= last:
            self._shown[topics.WRENCH.name] = stamp
            at, strongest = self._peak
            self._tracks.number(FORCE, at, _size(strongest))
            self._tracks.number(FORCE_Z, at, strongest.z)
            self._peak = None

    def _trace(self, message: m.ControlTrace, _stamp: int) -> None:
        """The strongest force of every few control cycles; finer than the wrench topic, which is no longer needed."""
        self._traced = True
        forces = message.wrench.reshape(-1, 6)[:, :3]  # (cycles, 3) [N]
        sizes = np.linalg.norm(forces, axis=1)
        first, period = m.nanoseconds_of(message.header.stamp), round(message.period * m.NANOSECONDS)
        for start in range(0, len(sizes), PEAK_CYCLES):
            row = start + int(sizes[start : start + PEAK_CYCLES].argmax())
            at = first + row * period
            self._tracks.number(FORCE, at, float(sizes[row]))
            self._tracks.number(FORCE_Z, at, float(forces[row, 2]))

    def _begin(self, goal: m.SearchGoal, stamp: int) -> None:
        self._goal = goal
        if self._board is None:
            self._board = BoardScene(self._recording, board_of([goal]))
        self._board.begin(goal)
        self._close_up.begin(goal)
        self._recording.log(ATTEMPTS, rr.Scalars(0.0))
        self._say(stamp, "assembly", 20, f"board {goal.board} hole {goal.hole}: search {goal.search} begins")

    def _truth(self, truth: m.Truth, _: int) -> None:
        self._close_up.truth(truth, self._goal.feasible_radius if self._goal is not None else 0.1e-3)

    def _candidate(self, candidate: m.Candidate, _: int) -> None:
        self._close_up.candidate(candidate)

    def _attempt(self, attempt: m.Attempt, stamp: int) -> None:
        self._total += 1
        self._close_up.attempt(attempt)
        self._recording.log(ATTEMPTS, rr.Scalars(float(attempt.number)))
        self._recording.log(TOTAL, rr.Scalars(float(self._total)))
        if attempt.outcome == m.Outcome.ABORTED:
            self._say(stamp, "arm", 30, f"attempt {attempt.number} aborted: {attempt.reason}")

    def _finish(self, result: m.SearchResult, stamp: int) -> None:
        if self._goal is not None and self._board is not None:
            self._board.finish(self._goal, result)
        self._recording.log(DURATION, rr.Scalars(result.duration))
        if result.ending == m.Ending.INSERTED:  # of the others the assembly itself tells
            text = f"board {result.board} hole {result.hole}: seated after {result.attempts} attempts"
            self._say(stamp, "assembly", 20, text)

    def _arm(self, status: m.ArmStatus, _: int) -> None:
        if status.holding != self._holding:
            self._holding = status.holding
            self._recording.log(f"{HELD}/part", rr.Clear(recursive=True))
            if status.holding in COMPONENTS:
                draw_part(self._recording, f"{HELD}/part", HELD_FRAME, COMPONENTS[status.holding])
        self._state(ARM, _SAFETY_MODES.get(status.safety_mode, f"safety mode {status.safety_mode}"))

    def _permit(self, permit: m.Permit, _: int) -> None:
        self._state(INTERLOCK, m.SafetyState(permit.state).name.lower())

    def _session(self, state: m.SessionState, stamp: int) -> None:
        if self._state(SESSION, m.Phase(state.phase).name.lower()):
            self._say(stamp, "session", 20, state.text)

    def _rosout(self, line: m.Log, stamp: int) -> None:
        self._say(stamp, line.name, line.level, line.msg)

    def _state(self, entity: str, state: str) -> bool:
        """Show a state if it is a new one."""
        if self._states.get(entity) == state:
            return False
        self._states[entity] = state
        self._recording.log(entity, rr.StateChange(state=state))
        return True

    def _say(self, stamp: int, who: str, level: int, text: str) -> None:
        self._recording.set_time(TIMELINE, duration=np.timedelta64(max(stamp, 0), "ns"))
        self._now = stamp
        name = _LEVELS.get(level, logging.getLevelName(level))
        self._recording.log(f"{LOG}/{who}", rr.TextLog(f"{who}: {text}", level=name))


def _size(force: m.Vector3) -> float:
    return math.sqrt(force.x * force.x + force.y * force.y + force.z * force.z)
