"""THE MAP: every topic and service of a cell, with its type, rate, publisher and meaning.

     light_curtain --ossd--> interlock --permit--> arm
     assembly --goal--> strategy --candidate--> arm --attempt--> strategy, posterior, assembly
     assembly --request--> posterior --belief--> assembly (into the next goal)
     assembly --intervention--> a person --answer--> assembly --answered--> arm, launcher (in an attended cell)
     everything --> recorder, viewer

Names of the arm's topics are those of UR's ROS 2 driver. A publisher is the role of a plugin in the cell.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from runtime import messages as m

MessageT = TypeVar("MessageT")
RequestT = TypeVar("RequestT")
ReplyT = TypeVar("ReplyT")

ANYBODY = "any"  # publisher of what more than one role says

_topics: dict[str, Topic[Any]] = {}
_services: dict[str, Service[Any, Any]] = {}


@dataclass(frozen=True)
class Topic(Generic[MessageT]):
    """A stream of messages of one type."""

    name: str
    type: type[MessageT]
    publisher: str  # role, or ANYBODY
    rate: str  # in session time
    meaning: str
    latched: bool = False  # a late subscriber gets the last message
    hidden: bool = False  # only recorder and viewer may read it

    def __post_init__(self) -> None:
        _topics[self.name] = self


@dataclass(frozen=True)
class Service(Generic[RequestT, ReplyT]):
    """A question that one plugin answers."""

    name: str
    request: type[RequestT]
    reply: type[ReplyT]
    server: str  # role
    meaning: str

    def __post_init__(self) -> None:
        _services[self.name] = self


JOINT_STATES = Topic("/joint_states", m.JointState, "arm", "25 Hz", "measured joint angles, speeds and motor torques")
WRENCH = Topic(
    "/force_torque_sensor_broadcaster/wrench",
    m.WrenchStamped,
    "arm",
    "25 Hz",
    "wrench on the tool at the flange, frame tool0, payload compensated, zeroed before each attempt",
)
TCP_POSE = Topic("/tcp_pose_broadcaster/pose", m.PoseStamped, "arm", "25 Hz", "pose of the TCP in base_link")
TF = Topic("/tf", m.TFMessage, "arm", "25 Hz", "poses of the arm's links")
TF_STATIC = Topic("/tf_static", m.TFMessage, "arm", "once", "poses of what does not move", latched=True)
ROBOT_DESCRIPTION = Topic("/robot_description", m.String, "arm", "once", "the arm as URDF", latched=True)
CLOCK = Topic("/clock", m.Clock, "arm", "12.5 Hz (50 Hz by wire), and at every wait for a permit", "session time")
ARM_STATUS = Topic("/arm/status", m.ArmStatus, "arm", "on change", "mode and activity of the arm", latched=True)
TRACE = Topic("/arm/trace", m.ControlTrace, "arm", "10 Hz", "every 500 Hz control cycle: joints and wrench")
PEAK_FORCE = Topic(
    "/arm/peak_force",
    m.Float64MultiArray,
    "arm",
    "10 Hz",
    "x, y, z [N] of the strongest force on the tool since the last one, frame tool0: what Rerun plots of a log that it "
    "opens by itself, for it plots no wrenches; everybody else reads wrench or trace",
)
ATTEMPT = Topic("/attempt", m.Attempt, "arm", "per attempt", "what the arm felt at a candidate")
TRUTH = Topic("/truth", m.Truth, "arm", "per search, simulation only", "where hole and pins really are", hidden=True)

OSSD = Topic("/safety/ossd", m.Ossd, "light_curtain", "per clock", "the light curtain's two outputs")
RESET = Topic("/safety/reset", m.Reset, ANYBODY, "per press", "the reset button")
EMERGENCY_STOP = Topic(
    "/safety/emergency_stop", m.EmergencyStop, ANYBODY, "on change", "an emergency stop device, pressed or released"
)
MUTING = Topic("/safety/muting", m.Muting, "light_curtain", "on change", "the two muting sensors")
PERMIT = Topic(
    "/safety/permit", m.Permit, "interlock", "per message to it", "whether the arm may move, until when, how it stops"
)

SEARCH_GOAL = Topic("/search/goal", m.SearchGoal, "assembly", "per search", "find this hole for this part")
CANDIDATE = Topic("/search/candidate", m.Candidate, "strategy", "per attempt", "the next position to try")
SEARCH_RESULT = Topic("/search/result", m.SearchResult, "assembly", "per search", "how a search ended")
BELIEF = Topic("/posterior/belief", m.Belief, "posterior", "per search", "what is now believed about a hole")
MERGED = Topic(
    "/posterior/merged",
    m.Merged,
    "posterior",
    "on change",
    "evidence that came or went by others' doing since the search before",
)

INTERVENTION = Topic(
    "/intervention/request", m.Intervention, "assembly", "on change", "what an attended cell needs now", latched=True
)
ANSWER_GIVEN = Topic("/intervention/answered", m.AnswerGiven, "assembly", "per answer", "what a person told it to do")

SESSION = Topic("/session/state", m.SessionState, ANYBODY, "on change", "phase of the session", latched=True)
COUNTS = Topic("/session/counts", m.PublisherCounts, ANYBODY, "once, at close", "what each plugin has published")
ROSOUT = Topic("/rosout", m.Log, ANYBODY, "on occasion", "log text of all plugins")

ASK_BELIEF = Service("/posterior/ask", m.BeliefRequest, m.Belief, "posterior", "what is known about a hole")
ANSWER = Service(
    "/intervention/answer", m.InterventionAnswer, m.InterventionReply, "assembly", "a person's answer to what is needed"
)
PLAYER_CONTROL = Service(
    "/player/control", m.PlayerCommand, m.PlayerState, "player", "pause, step, seek and pace a log that is played back"
)
LIGHT_FIELD = Service(
    "/light_curtain/field",
    m.CurtainCommand,
    m.CurtainState,
    "light_curtain",
    "break or clear the simulated light field, press the reset button, or see how it is",
)
SNAPSHOT = Service(
    "/recorder/snapshot", m.SnapshotRequest, m.SnapshotReply, "recorder", "write down what is kept in memory"
)


def topics() -> dict[str, Topic[Any]]:
    """Every topic of the map by name."""
    return dict(_topics)


def known_topic(name: str) -> Topic[Any] | None:
    """The topic of that name, if the map has one."""
    return _topics.get(name)


def known_service(name: str) -> Service[Any, Any] | None:
    """The service of that name, if the map has one."""
    return _services.get(name)


def services() -> dict[str, Service[Any, Any]]:
    """Every service of the map by name."""
    return dict(_services)
