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
from runtime.view.board import HELD, HELD_FRAME, BoardScene, board_of, draw_part
from runtime.view.close_up import CloseUp
from runtime.view.tracks import ATTEMPT_LINE, TIMELINE, Tracks, every_few, strongest

INTERVAL = 50_000_000  # [ns] of session time between two samples of what is published all the time
ROBOT = "robot"
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
        self.tracks = Tracks(recording)
        self._board = BoardScene(recording, board) if board is not None else None
        self._close_up = CloseUp(recording)
        self._goal: m.SearchGoal | None = None
        self._total = 0
        self.states: dict[str, str] = {}  # of each lane, as it stands now
        self._holding = ""  # component in the gripper
        self._shown: dict[str, int] = {}  # interval of the last sample by topic
        self._peak: tuple[int, m.Vector3] | None = None  # strongest force since the last sample
        self._traced = False
        self._now = (-1, -1)  # session time [ns] and attempt that the recording stands at
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
        topic, _ = self._handlers[envelope.topic]
        if topic in (topics.TF, topics.TCP_POSE) and not self._due(envelope):
            return
        try:
            message = envelope.read(topic)
        except BusError as error:
            self.say(envelope.stamp, "viewer", 30, f"a message is not shown: {error}")
            return
        self.draw(topic, message, envelope.stamp)

    def draw(self, topic: Topic[Any], message: Any, stamp: int) -> None:
        """Draw one message of a topic of `topics`, sent at session time `stamp` [ns]."""
        attempts = self.tracks.attempts
        if topic is topics.SEARCH_GOAL or (topic is topics.CANDIDATE and not message.exhausted):
            attempts.begin(stamp)
        self._at(stamp)
        _, handler = self._handlers[topic.name]
        handler(message, stamp)
        if topic is topics.ATTEMPT:
            attempts.end()

    def _at(self, stamp: int) -> None:
        """Let what is drawn next be of session time `stamp` [ns] and of the attempt in hand."""
        now = (max(stamp, 0), self.tracks.attempts.number)
        if now != self._now:
            self._now = now
            self._recording.set_time(TIMELINE, duration=np.timedelta64(now[0], "ns"))
            self._recording.set_time(ATTEMPT_LINE, sequence=now[1])

    def flush(self) -> None:
        """Hand over what has been gathered."""
        self.tracks.flush()

    def close(self) -> None:
        """The session is over: hand over the rest too."""
        self._show_peak()
        self.flush()

    def _due(self, envelope: Envelope) -> bool:
        interval = envelope.stamp // self._interval
        if self._shown.get(envelope.topic) == interval:
            return False
        self._shown[envelope.topic] = interval
        return True

    def _robot(self, message: m.String, stamp: int) -> None:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "robot.urdf"
            path.write_text(message.data, encoding="utf-8")
            try:
                tree = UrdfTree.from_file_path(path, entity_path_prefix=ROBOT)
            except Exception as error:  # rerun raises several types
                self.say(stamp, "viewer", 30, f"the robot's description cannot be drawn: {error}")
                return
            self._recording.send_chunks(tree.stream(include_joint_transforms=False))
            for joint in tree.joints():
                if joint.joint_type == "fixed":
                    self._recording.log(f"tf/{joint.child_link}", joint.compute_transform(0.0), static=True)

    def _frames(self, message: m.TFMessage, stamp: int) -> None:
        for item in message.transforms:
            child = item.child_frame_id
            self.tracks.frame(f"tf/{child}", item.header.frame_id, child, stamp, item.transform)

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
        self.tracks.pose(HELD, m.BASE_FRAME, HELD_FRAME, stamp, message.pose)

    def _wrench(self, message: m.WrenchStamped, stamp: int) -> None:
        """Of each interval the strongest force is shown, so that no contact is missed."""
        if self._traced:
            return
        if self._peak is not None and stamp // self._interval != self._peak[0] // self._interval:
            self._show_peak()
        force = message.wrench.force
        if self._peak is None or _size(force) > _size(self._peak[1]):
            self._peak = (stamp, force)

    def _show_peak(self) -> None:
        if self._peak is not None:
            at, strongest_of_all = self._peak
            self.tracks.number(FORCE, at, _size(strongest_of_all))
            self.tracks.number(FORCE_Z, at, strongest_of_all.z)
            self._peak = None

    def _trace(self, message: m.ControlTrace, _stamp: int) -> None:
        """The strongest force of every few control cycles; finer than the wrench topic, which is no longer needed."""
        self._traced = True
        forces = message.wrench.reshape(-1, 6)[:, :3]  # (cycles, 3) [N]
        first, period = m.nanoseconds_of(message.header.stamp), round(message.period * m.NANOSECONDS)
        for row in strongest(forces, every_few(np.array([len(forces)]))).tolist():
            at = first + row * period
            self.tracks.number(FORCE, at, float(np.linalg.norm(forces[row])))
            self.tracks.number(FORCE_Z, at, float(forces[row, 2]))

    def _begin(self, goal: m.SearchGoal, stamp: int) -> None:
        self._goal = goal
        if self._board is None:
            self._board = BoardScene(self._recording, board_of([goal]))
        self._board.begin(goal)
        self._close_up.begin(goal)
        self._recording.log(ATTEMPTS, rr.Scalars(0.0))
        self.say(stamp, "assembly", 20, f"board {goal.board} hole {goal.hole}: search {goal.search} begins")

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
            self.say(stamp, "arm", 30, f"attempt {attempt.number} aborted: {attempt.reason}")

    def _finish(self, result: m.SearchResult, stamp: int) -> None:
        if self._goal is not None and self._board is not None:
            self._board.finish(self._goal, result)
        self._recording.log(DURATION, rr.Scalars(result.duration))
        if result.ending == m.Ending.INSERTED:  # of the others the assembly itself tells
            text = f"board {result.board} hole {result.hole}: seated after {result.attempts} attempts"
            self.say(stamp, "assembly", 20, text)

    def _arm(self, status: m.ArmStatus, _: int) -> None:
        if status.holding != self._holding:
            self._holding = status.holding
            self._recording.log(f"{HELD}/part", rr.Clear(recursive=True))
            if status.holding in COMPONENTS:
                draw_part(self._recording, f"{HELD}/part", HELD_FRAME, COMPONENTS[status.holding])
        self._state(ARM, _SAFETY_MODES.get(status.safety_mode, f"safety mode {status.safety_mode}"))

    def _permit(self, permit: m.Permit, _: int) -> None:
        self._state(INTERLOCK, safety_state(permit.state))

    def _session(self, state: m.SessionState, stamp: int) -> None:
        if self._state(SESSION, m.Phase(state.phase).name.lower()):
            self.say(stamp, "session", 20, state.text)

    def _rosout(self, line: m.Log, stamp: int) -> None:
        self.say(stamp, line.name, line.level, line.msg)

    def _state(self, entity: str, state: str) -> bool:
        """Show a state if it is a new one."""
        if self.states.get(entity) == state:
            return False
        self.states[entity] = state
        self._recording.log(entity, rr.StateChange(state=state))
        return True

    def say(self, stamp: int, who: str, level: int, text: str) -> None:
        """Add a line to the log that is shown, at session time `stamp` [ns]; levels are those of ROS."""
        self._at(stamp)
        name = _LEVELS.get(level, logging.getLevelName(level))
        self._recording.log(f"{LOG}/{who}", rr.TextLog(f"{who}: {text}", level=name))


def safety_state(number: int) -> str:
    """What the interlock's lane says in a state."""
    known = number in set(m.SafetyState)
    return m.SafetyState(number).name.lower() if known else f"state {number}"


def _size(force: m.Vector3) -> float:
    return math.sqrt(force.x * force.x + force.y * force.y + force.z * force.z)
