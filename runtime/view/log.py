"""Shows a finished session in Rerun.

Rerun's own reader decodes what was published all the time, in columns; only what happened once is decoded one by one.
"""

from __future__ import annotations

import contextlib
import json
import re
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import rerun as rr
from numpy.typing import NDArray
from rerun.chunk import McapReader

from runtime import messages as m
from runtime import topics
from runtime.bus import Envelope
from runtime.cell import Board
from runtime.declaration import type_name
from runtime.errors import InputError, LogError, PalpateError
from runtime.log.file import LogFile
from runtime.log.part import UNKNOWN_PUBLISHER
from runtime.log.writer import SESSION_RECORD
from runtime.settings import read
from runtime.topics import Topic
from runtime.view.blueprint import empty_scene
from runtime.view.board import HELD, HELD_FRAME, board_of
from runtime.view.scene import FORCE, FORCE_Z, INTERLOCK, INTERVAL, Scene, safety_state
from runtime.view.target import APPLICATION, FLUSH_TIMEOUT, has_display, target
from runtime.view.tracks import every_few, every_interval, strongest

STREAMS = (topics.TF, topics.TCP_POSE, topics.WRENCH, topics.TRACE, topics.PERMIT)
# What happened at one time is drawn in the order of cause and effect: a log keeps no order between publishers.
EVENTS = (
    topics.ROBOT_DESCRIPTION, topics.TF_STATIC, topics.SESSION, topics.ROSOUT, topics.ATTEMPT, topics.SEARCH_RESULT,
    topics.SEARCH_GOAL, topics.TRUTH, topics.ARM_STATUS, topics.CANDIDATE,
)  # fmt: skip
_BATCHES = 512  # that are decoded before they are drawn, together
_RADIUS = 2e-3  # [m] of the close-up if nothing says how far searches reach
_TIME = "message_log_time"
Event = tuple[int, Topic[Any], Any]  # stamp [ns], topic, message


def view(log: LogFile, *, web: bool = False, save: Path | None = None, say: Callable[[str], None] = print) -> None:
    """Show a log: in a window until that is closed, to a browser until Ctrl-C, or as the .rrd file `save`.

    Raises LogError for a log that is damaged, InputError for what cannot work here.
    """
    check(web=web, save=save)
    if not log.complete:
        say(f"{log.path} was never finished; it is shown as far as it goes")
    if save is not None:
        convert(log, save)
        say(f"open it with: rerun {save}")
        return
    recording = rr.RecordingStream(APPLICATION, recording_id=log.path.stem)
    with target(recording, "web" if web else "spawn") as shown:
        if shown.url:
            say(f"open {shown.url} (Ctrl-C ends it)")
        draw(log, recording)
        recording.flush(timeout_sec=FLUSH_TIMEOUT)
        recording.disconnect()
        shown.wait()


def convert(log: LogFile, file: Path) -> None:
    """Write a log as an .rrd file with the layout inside. Raises InputError if the file cannot be written."""
    recording = rr.RecordingStream(APPLICATION, recording_id=log.path.stem)
    with target(recording, "save", file):
        draw(log, recording)


def check(*, web: bool, save: Path | None) -> None:
    """Raise InputError, with the way out, for what cannot work here."""
    if not (web or save or has_display()):
        raise InputError(
            "there is no display for Rerun's window; watch in a browser with --web, "
            "or write a file for a machine with a display with --save FILE.rrd"
        )
    if save is not None and save.suffix != ".rrd":
        raise InputError(f"{save} does not end in .rrd, by which Rerun knows its files")


def draw(log: LogFile, recording: Any) -> None:
    """Draw a whole log into a recording, layout included. Raises LogError if the log is damaged."""
    log.check_sound()  # Rerun's reader would leave out what it cannot read
    wanted, refused = _wanted(log)
    events, undecoded = _events(log, [topic for topic in wanted if topic in EVENTS])
    goals = [message for _, topic, message in events if topic is topics.SEARCH_GOAL]
    radius = max((goal.search_radius for goal in goals), default=_RADIUS)
    scene = empty_scene(recording, log.path.stem, _board_of(log, goals), radius)
    for text in (*refused, *undecoded):
        scene.say(log.start, "viewer", 30, f"not shown: {text}")
    for stamp, topic, message in events:
        scene.draw(topic, message, stamp)
    for topic, batches in _batches(log, [topic for topic in wanted if topic in STREAMS], "ros2msg"):
        _COLUMNS[topic](scene, batches)
    scene.close()


def _board_of(log: LogFile, goals: list[m.SearchGoal]) -> Board | None:
    """The board of the settings that the launcher records, or as far as search goals tell."""
    with contextlib.suppress(PalpateError, ValueError, KeyError):
        settings = json.loads(log.metadata[SESSION_RECORD]["settings"])
        return read(Board, settings["board"], SESSION_RECORD)
    return board_of(goals) if goals else None


def _wanted(log: LogFile) -> tuple[list[Topic[Any]], list[str]]:
    """The topics of a log that there is something to show of, and why others cannot be shown."""
    types = {topic.name: topic.type for topic in log.topics}
    recorded = [topic for topic in (*EVENTS, *STREAMS) if topic.name in types]
    if topics.TRACE in recorded and topics.WRENCH in recorded:
        recorded.remove(topics.WRENCH)  # the trace has it, and finer
    wanted = [topic for topic in recorded if types[topic.name] == type_name(topic.type)]
    return wanted, [f"{topic.name} carries {types[topic.name]}" for topic in recorded if topic not in wanted]


def _events(log: LogFile, wanted: list[Topic[Any]]) -> tuple[list[Event], list[str]]:
    """What happened once, earliest first, and why messages cannot be shown."""
    events: list[Event] = []
    failures: dict[str, None] = {}
    latched = set()  # what later files of a log repeat
    for topic, batches in _batches(log, wanted, "raw"):
        payloads = _column(batches, "McapMessage:data").flatten()
        contents, ends = payloads.flatten().to_numpy().tobytes(), payloads.value_lengths().to_numpy().cumsum().tolist()
        for stamp, start, end in zip(_stamps(batches).tolist(), [0, *ends], ends, strict=False):
            payload = contents[start:end]
            if topic.latched and (topic, stamp, payload) in latched:
                continue
            latched.add((topic, stamp, payload))
            try:
                message = log.decode(Envelope(topic.name, type_name(topic.type), payload, stamp, 0, UNKNOWN_PUBLISHER))
            except LogError as error:
                failures[str(error)] = None
            else:
                events.append((stamp, topic, message))
    ranks = {topic: rank for rank, topic in enumerate(EVENTS)}
    events.sort(key=lambda event: (event[0], ranks[event[1]]))
    return events, list(failures)


def _batches(log: LogFile, wanted: list[Topic[Any]], decoder: str) -> Iterator[tuple[Topic[Any], list[pa.RecordBatch]]]:
    """Rows of the topics of a log, many at a time; types that Rerun does not know come as records."""
    by_name = {topic.name: topic for topic in wanted}
    gathered: dict[Topic[Any], list[pa.RecordBatch]] = defaultdict(list)
    for file in log.files if wanted else ():
        reader = McapReader(
            file,
            timeline_type="duration_ns",
            decoders=[decoder] if decoder == "raw" else [decoder, "ros2_reflection"],
            include_topic_regex=[f"^{re.escape(name)}$" for name in by_name],
            recover=not log.complete,
        )
        try:
            for chunk in reader.stream():
                topic = by_name.get(chunk.entity_path)
                if topic is not None and not chunk.is_static:
                    gathered[topic].append(chunk.to_record_batch())
                    if len(gathered[topic]) == _BATCHES:
                        yield topic, gathered.pop(topic)
        except (RuntimeError, ValueError, OSError) as error:
            raise LogError(f"{file} is damaged: {str(error).splitlines()[0]}") from None
    yield from gathered.items()


def _column(batches: list[pa.RecordBatch], ending: str) -> Any:
    """One column of all batches, by the end of its name: the component that it holds."""
    [name] = [name for name in batches[0].schema.names if name.endswith(ending)]
    return pa.concat_arrays([batch.column(name) for batch in batches])


def _field(batches: list[pa.RecordBatch], *path: str) -> Any:
    """One field of the messages of all batches, of a type that Rerun does not know."""
    [name] = [name for name in batches[0].schema.names if name.endswith(":message")]
    return pa.concat_arrays([pc.struct_field(batch.column(name).flatten(), path) for batch in batches])


def _stamps(batches: list[pa.RecordBatch]) -> NDArray[np.int64]:
    """Session times (rows,) [ns]."""
    return np.asarray(_column(batches, _TIME).to_numpy().astype(np.int64))


def _vectors(batches: list[pa.RecordBatch], ending: str, size: int) -> NDArray[np.float32]:
    """Vectors (rows, size)."""
    return np.asarray(_column(batches, ending).flatten().flatten().to_numpy().reshape(-1, size))


def _frames(scene: Scene, batches: list[pa.RecordBatch]) -> None:
    """Where the arm's links are."""
    stamps = _stamps(batches)
    positions, rotations = _vectors(batches, ":translation", 3), _vectors(batches, ":quaternion", 4)
    names = [_column(batches, ending).flatten().dictionary_encode() for ending in (":child_frame", ":parent_frame")]
    [children, parents] = [encoded.dictionary.to_pylist() for encoded in names]
    [child_of, parent_of] = [encoded.indices.to_numpy() for encoded in names]
    for index, child in enumerate(children):
        rows = np.flatnonzero(child_of == index)
        rows = rows[every_interval(stamps[rows], INTERVAL)]
        parent = parents[parent_of[rows[0]]]
        scene.tracks.send_poses(f"tf/{child}", parent, child, stamps[rows], positions[rows], rotations[rows])


def _tcp(scene: Scene, batches: list[pa.RecordBatch]) -> None:
    """Where the part in the gripper is."""
    stamps = _stamps(batches)
    rows = every_interval(stamps, INTERVAL)
    positions, rotations = _vectors(batches, ":translations", 3), _vectors(batches, ":quaternions", 4)
    scene.tracks.send_poses(HELD, m.BASE_FRAME, HELD_FRAME, stamps[rows], positions[rows], rotations[rows])


def _trace(scene: Scene, batches: list[pa.RecordBatch]) -> None:
    """Forces of every control cycle."""
    wrenches = _field(batches, "wrench")
    cycles = wrenches.value_lengths().to_numpy().astype(np.int64) // 6
    forces = wrenches.flatten().to_numpy().reshape(-1, 6)[:, :3]
    seconds, rest = (_field(batches, "header", "stamp", part).to_numpy() for part in ("sec", "nanosec"))
    first = seconds.astype(np.int64) * m.NANOSECONDS + rest
    periods = np.rint(_field(batches, "period").to_numpy() * m.NANOSECONDS).astype(np.int64)
    rows = strongest(forces, every_few(cycles))
    message = np.searchsorted(np.cumsum(cycles), rows, side="right")
    stamps = first[message] + (rows - (np.cumsum(cycles) - cycles)[message]) * periods[message]
    _plot(scene, stamps, forces[rows])


def _wrench(scene: Scene, batches: list[pa.RecordBatch]) -> None:
    """The strongest force of each interval, of an arm that records no control cycles."""
    forces = np.stack([_field(batches, "wrench", "force", axis).to_numpy() for axis in "xyz"], axis=1)
    stamps = _stamps(batches)
    rows = strongest(forces, every_interval(stamps, INTERVAL))
    _plot(scene, stamps[rows], forces[rows])


def _plot(scene: Scene, stamps: NDArray[np.int64], forces: NDArray[np.float64]) -> None:
    scene.tracks.send_numbers(FORCE, stamps, np.linalg.norm(forces, axis=1))
    scene.tracks.send_numbers(FORCE_Z, stamps, forces[:, 2])


def _permits(scene: Scene, batches: list[pa.RecordBatch]) -> None:
    """When the interlock's state changed."""
    numbers = _field(batches, "state").to_numpy().astype(np.int64)
    rows = np.flatnonzero(np.diff(numbers, prepend=-1))
    states = [safety_state(number) for number in numbers[rows].tolist()]
    if states[0] == scene.states.get(INTERLOCK):
        rows, states = rows[1:], states[1:]
    if states:
        scene.states[INTERLOCK] = states[-1]
        scene.tracks.send_states(INTERLOCK, _stamps(batches)[rows], states)


_COLUMNS: dict[Topic[Any], Callable[[Scene, list[pa.RecordBatch]], None]] = {
    topics.TF: _frames,
    topics.TCP_POSE: _tcp,
    topics.TRACE: _trace,
    topics.WRENCH: _wrench,
    topics.PERMIT: _permits,
}
