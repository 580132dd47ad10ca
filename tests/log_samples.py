"""A small session as a cell would publish it, made without simulation: the arm pecks for two holes and finds both."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from drivers.ur3e import frames
from drivers.ur3e.kinematics import Kinematics
from drivers.ur3e.parameters import GRIPPER, JOINT_NAMES, JOINTS
from drivers.ur3e.robot_model import urdf
from runtime import messages as m
from runtime import topics as t
from runtime.cell import Board, Hole
from runtime.component import component
from runtime.config import Cell
from runtime.context import Context
from runtime.local_bus import LocalBus, LocalExchange
from runtime.recorder import Recorder

PERIOD = 20_000_000  # [ns] 50 Hz
LIFT = 8e-3  # [m] above the board between attempts
DOCUMENT = {
    "component": "igbt",
    "board": {
        "type": "sample-4",
        "holes": [
            {"name": "1", "x": "-30 mm", "y": "-20 mm", "orientation": "0 deg"},
            {"name": "2", "x": "30 mm", "y": "-20 mm", "orientation": "0 deg"},
            {"name": "3", "x": "-30 mm", "y": "20 mm", "orientation": "0 deg"},
            {"name": "4", "x": "30 mm", "y": "20 mm", "orientation": "0 deg"},
        ],
    },
}
BOARD = Board(
    "sample-4",
    (
        Hole("1", -0.03, -0.02, 0.0),
        Hole("2", 0.03, -0.02, 0.0),
        Hole("3", -0.03, 0.02, 0.0),
        Hole("4", 0.03, 0.02, 0.0),
    ),
)
CELL = Cell(board=BOARD)
WHERE = {"1": (0.45e-3, -0.35e-3), "2": (-0.3e-3, 0.5e-3), "3": (0.2e-3, 0.6e-3), "4": (-0.55e-3, -0.25e-3)}
STEPS = ((0.0, 0.0), (0.3e-3, 0.0), (0.1e-3, -0.3e-3), (-0.25e-3, 0.1e-3))  # candidates that miss
Sent = tuple[str, t.Topic[Any], Any, int]  # role, topic, message, stamp


@dataclass
class _World:
    """The arm and the clock of the sample."""

    now: int = 0
    kinematics: Kinematics = field(default_factory=Kinematics)
    q: Any = field(default_factory=lambda: np.array([-0.3, -1.6, 2.0, -1.97, -1.5708, -1.87]))
    tcp: tuple[float, float, float] = (BOARD.x, BOARD.y, BOARD.z + 0.1)
    noise: Any = field(default_factory=lambda: np.random.default_rng(4))

    def __post_init__(self) -> None:
        self.kinematics.set_tcp((0.0, 0.0, GRIPPER.reach + component("igbt").grip, 0.0, 0.0, 0.0))

    def state(self, force: float, permit: bool) -> Iterator[Sent]:
        """Everything that is published 50 times a second."""
        old = self.q
        self.q = self.kinematics.inverse(self.tcp, frames.tool_down(0.0), self.q)
        stamp, speed = m.header(self.now, m.BASE_FRAME), (self.q - old) * 50
        yield "arm", t.CLOCK, m.Clock(clock=m.stamp_of(self.now)), self.now
        yield "arm", t.JOINT_STATES, m.JointState(stamp, list(JOINT_NAMES), self.q, speed, speed * 2), self.now
        x, y, z, w = frames.quaternion_of_rotation(frames.tool_down(0.0))
        pose = m.Pose(m.Point(*self.tcp), m.Quaternion(x, y, z, w))
        yield "arm", t.TCP_POSE, m.PoseStamped(stamp, pose), self.now
        yield "arm", t.TF, m.TFMessage([*self._links(stamp)]), self.now
        noise = self.noise.normal(0.0, 0.15, 6)
        wrench = m.Wrench(m.Vector3(noise[0], noise[1], -force + noise[2]), m.Vector3(*(noise[3:] * 0.05)))
        yield "arm", t.WRENCH, m.WrenchStamped(m.header(self.now, "tool0"), wrench), self.now
        yield "light_curtain", t.OSSD, m.Ossd(stamp, permit, permit, m.stamp_of(self.now + PERIOD)), self.now
        if self.now % (5 * PERIOD) == 0:
            strongest = np.array([noise[0], noise[1], -force + noise[2]])
            yield "arm", t.PEAK_FORCE, m.Float64MultiArray(m.MultiArrayLayout([], 0), strongest), self.now
        state = m.SafetyState.PERMITTED if permit else m.SafetyState.TRIPPED
        reason = "" if permit else "the light field is interrupted"
        yield (
            "interlock",
            t.PERMIT,
            m.Permit(stamp, permit, int(state), reason, m.stamp_of(self.now + 5 * PERIOD)),
            self.now,
        )
        self.now += PERIOD

    def _links(self, stamp: m.Header) -> Iterator[m.TransformStamped]:
        parent = "base_link_inertia"
        for joint, angle in zip(JOINTS, self.q.tolist(), strict=True):
            roll, pitch, yaw = (frames.rotation_of_vector(v) for v in zip(*np.diag(joint.rpy).tolist(), strict=True))
            turn = frames.rotation_of_vector((0.0, 0.0, angle))
            rotation = frames.product(frames.product(yaw, frames.product(pitch, roll)), turn)
            yield _transform(stamp, parent, joint.link, joint.origin, rotation)
            parent = joint.link

    def move(self, target: tuple[float, float, float], seconds: float, force: float = 0.0) -> Iterator[Sent]:
        """Go there in a straight line; the force rises over the way."""
        start, count = self.tcp, max(round(seconds / 0.02), 1)
        for step in range(1, count + 1):
            part = (1 - math.cos(math.pi * step / count)) / 2
            x, y, z = (a + (b - a) * part for a, b in zip(start, target, strict=True))
            self.tcp = (x, y, z)
            yield from self.state(force * max(0.0, 4 * part - 3), permit=True)

    def stand(self, seconds: float, permit: bool) -> Iterator[Sent]:
        """Stay where it is."""
        for _ in range(round(seconds / 0.02)):
            yield from self.state(0.0, permit)


def _transform(stamp: m.Header, parent: str, child: str, origin: Any, rotation: Any) -> m.TransformStamped:
    header = m.Header(stamp=stamp.stamp, frame_id=parent)
    place = m.Transform(m.Vector3(*map(float, origin)), m.Quaternion(*frames.quaternion_of_rotation(rotation)))
    return m.TransformStamped(header, child, place)


def _static(now: int) -> m.TFMessage:
    half, stamp = math.pi / 2, m.header(now)
    flange = frames.product(frames.rotation_of_vector((0, 0, -half)), frames.rotation_of_vector((0, -half, 0)))
    turned = frames.rotation_of_vector((0, 0, math.pi))
    pairs = [
        ("base_link", "base_link_inertia", turned),
        ("wrist_3_link", "flange", flange),
        ("flange", "tool0", frames.transpose(flange)),
        ("tool0", "gripper", frames.IDENTITY),
    ]
    return m.TFMessage([_transform(stamp, parent, child, (0, 0, 0), turn) for parent, child, turn in pairs])


def messages(holes: tuple[str, ...] = ("1", "2")) -> Iterator[Sent]:
    """The session's messages in order: role, topic, message, stamp [ns]."""
    world = _World()
    session = "20260101-120000"
    yield "arm", t.ROBOT_DESCRIPTION, m.String(urdf()), 0
    yield "arm", t.TF_STATIC, _static(0), 0
    yield "launcher", t.SESSION, m.SessionState(m.header(0), session, int(m.Phase.STARTING), "starting"), 0
    yield from world.stand(0.2, permit=False)
    yield (
        "launcher",
        t.SESSION,
        m.SessionState(m.header(world.now), session, int(m.Phase.RUNNING), "running"),
        world.now,
    )
    seats = [
        m.Seat("20251231-090000", board, name, x + 4e-5 * board, y - 5e-5 * board, x, y)
        for board in (1, 2, 3)
        for name, (x, y) in WHERE.items()
    ]
    for number, name in enumerate(holes, 1):
        if number == 2:
            yield from _interruption(world)
        yield from _search(world, number, name, seats, session)
    done = m.SessionState(m.header(world.now), session, int(m.Phase.DONE), "all boards are done")
    yield "assembly", t.SESSION, done, world.now


def _interruption(world: _World) -> Iterator[Sent]:
    yield "interlock", t.ROSOUT, _log(world.now, "interlock", 30, "the light field is interrupted"), world.now
    yield "arm", t.ARM_STATUS, m.ArmStatus(m.header(world.now), 7, 5, 0.0, "safeguard stop", "igbt"), world.now
    yield from world.stand(0.5, permit=False)
    yield "arm", t.ARM_STATUS, m.ArmStatus(m.header(world.now), 7, 1, 1.0, "ready", "igbt"), world.now


def _log(now: int, name: str, level: int, text: str) -> m.Log:
    return m.Log(stamp=m.stamp_of(now), level=level, name=name, msg=text, file="", function="", line=0)


def _search(world: _World, search: int, name: str, seats: list[m.Seat], session: str) -> Iterator[Sent]:
    hole, truth = BOARD.hole(name), WHERE[name]
    x, y, z = BOARD.x + hole.x, BOARD.y + hole.y, BOARD.z
    nominal = m.Pose(m.Point(x, y, z), m.Quaternion(1.0, 0.0, 0.0, 0.0))
    header = m.header(world.now, m.BASE_FRAME)
    began = world.now
    prior = m.Gaussian(0.1e-3, 0.0, 0.4e-3**2, 0.02e-6, 0.3e-3**2)
    goal = m.SearchGoal(header, search, 1, name, "igbt", nominal, 0.1e-3, 2e-3, 150, 7, prior, list(seats))
    yield "assembly", t.SEARCH_GOAL, goal, world.now
    yield "arm", t.TRUTH, m.Truth(header, search, 1, name, *truth, 0.0, 0.0, 0.0, 0.0, *truth), world.now
    yield "arm", t.ARM_STATUS, m.ArmStatus(header, 7, 1, 1.0, f"board 1 hole {name}", "igbt"), world.now
    yield from world.move((x, y, z + 0.05), 0.6)
    places = [*STEPS, truth]
    for number, (dx, dy) in enumerate(places, 1):
        shrink = 1.0 / number
        belief = m.Gaussian(truth[0] * (1 - shrink), truth[1] * (1 - shrink), prior.xx * shrink, 0.0, prior.yy * shrink)
        proposal = m.Proposal(dx, dy, 0.2 * number, belief)
        stamp = m.header(world.now, m.BASE_FRAME)
        yield "strategy", t.CANDIDATE, m.Candidate(stamp, search, number, False, "", proposal), world.now
        attempt_began = world.now
        seated = number == len(places)
        yield from world.move((x + dx, y + dy, z + LIFT), 0.16)
        bottom = z - 3.2e-3 if seated else z
        yield from world.move((x + dx, y + dy, bottom), 0.3, 0.5 if seated else 5.0)
        outcome = m.Outcome.SEATED if seated else m.Outcome.BLOCKED
        pose = m.Pose(m.Point(x + dx, y + dy, bottom), nominal.orientation)
        wrench = m.Wrench(m.Vector3(0.0, 0.0, 0.5 if seated else 5.1), m.Vector3(0.0, 0.0, 0.0))
        yield from world.move((x + dx, y + dy, z + LIFT), 0.2, 0.0)
        attempt = m.Attempt(
            m.header(world.now, m.BASE_FRAME), search, number, 1, name, dx, dy, int(outcome), "", pose, wrench,
            z - bottom, 5.2, (world.now - attempt_began) / 1e9,
        )  # fmt: skip
        yield "arm", t.ATTEMPT, attempt, world.now
    dx, dy = truth
    result = m.SearchResult(
        m.header(world.now), search, 1, name, "igbt", int(m.Ending.INSERTED), "", len(places), dx, dy,
        dx + 0.01e-3, dy - 0.01e-3, (world.now - began) / 1e9,
    )  # fmt: skip
    yield "assembly", t.SEARCH_RESULT, result, world.now
    seats.append(m.Seat(session, 1, name, dx, dy, dx + 0.01e-3, dy - 0.01e-3))


def context(exchange: LocalExchange, role: str) -> Context:
    """A plugin's surroundings on an exchange."""
    return Context(role, LocalBus(exchange, role), CELL, "20260101-120000")


def publish(exchange: LocalExchange, sent: Iterator[Sent]) -> int:
    """Send messages as the plugins they come from, each of which says its last word. Returns how many were sent."""
    contexts: dict[str, Context] = {}
    count = 0
    for role, topic, message, stamp in sent:
        if role not in contexts:
            contexts[role] = context(exchange, role)
            contexts[role].ready()
        contexts[role].clock.advance(stamp)
        contexts[role].bus.publisher(topic).send(message, stamp)
        count += 1
    end = max((plugin.clock.now for plugin in contexts.values()), default=0)
    for plugin in contexts.values():
        plugin.clock.advance(end)
        plugin.close()
        plugin.bus.close()
    return count + len(contexts)


def record(path: Path, sent: Iterator[Sent] | None = None, **settings: Any) -> int:
    """Record messages (a sample session by default) through a bus. Returns how many were sent."""
    exchange = LocalExchange()
    surroundings = context(exchange, "recorder")
    metadata = {"palpate.session": {"session": "20260101-120000", "settings": json.dumps(DOCUMENT)}}
    recorder = Recorder(path, **{"metadata": metadata, "attachments": {"sample.toml": "component = 'igbt'"}} | settings)
    failures: list[BaseException] = []

    def run() -> None:
        try:
            recorder.run(surroundings)
        except BaseException as error:
            failures.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    while exchange.wait_for({"recorder"}, 0.05) and thread.is_alive():
        pass
    count = publish(exchange, messages() if sent is None else sent) if thread.is_alive() else 0
    surroundings.stop()
    thread.join()
    if failures:
        raise failures[0]
    return count


def rerun_home(folder: Path) -> dict[str, str]:
    """Environment in which Rerun counts and sends nothing, and leaves the user's settings alone."""
    home = folder / "home"
    file = home / ".config" / "rerun" / "analytics.json"
    if not file.exists():
        file.parent.mkdir(parents=True)
        settings = {
            "analytics_enabled": False,
            "analytics_id": "",
            "metadata": {},
            "config_file_path": str(file),
            "data_dir_path": str(home / "data"),
        }
        file.write_text(json.dumps(settings))
    return {"HOME": str(home), "XDG_CONFIG_HOME": str(home / ".config"), "XDG_RUNTIME_DIR": str(home)}


def rerun(folder: Path, *arguments: str, timeout: float = 60.0) -> str:
    """Run Rerun's command line tool. Returns what it says."""
    done = subprocess.run(
        [sys.executable, "-m", "rerun", *arguments],
        env={**os.environ, **rerun_home(folder)},
        capture_output=True,
        text=True,
        timeout=timeout,
        check=True,
    )
    return done.stdout + done.stderr
