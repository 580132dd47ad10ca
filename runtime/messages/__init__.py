"""Every message type, declared once and statically typed; `runtime.declaration` says how.

ROS types come from `rosbags`; `palpate_msgs` holds only what ROS has no type for. Lengths are metres, angles radians,
forces newtons, torques newton metres, times seconds. Positions on a board are offsets from the nominal hole, in the
frame of the cell's base (`base_link`), because the robot knows no other.
"""

from __future__ import annotations

from functools import cache

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from runtime.declaration import declared, definition
from runtime.messages.arm import ArmStatus, ControlTrace, Truth
from runtime.messages.attendance import AnswerGiven, Choice, Intervention, InterventionAnswer, InterventionReply, Need
from runtime.messages.ros import (
    BASE_FRAME,
    NANOSECONDS,
    Clock,
    Float64MultiArray,
    Header,
    JointState,
    Log,
    MultiArrayDimension,
    MultiArrayLayout,
    Point,
    Pose,
    PoseStamped,
    Quaternion,
    String,
    TFMessage,
    Time,
    Transform,
    TransformStamped,
    Vector3,
    Wrench,
    WrenchStamped,
    header,
    nanoseconds_of,
    stamp_of,
)
from runtime.messages.safety import (
    CurtainCommand,
    CurtainState,
    EmergencyStop,
    Muting,
    Ossd,
    Permit,
    Reset,
    ResetEdge,
    SafetyState,
)
from runtime.messages.search import (
    Attempt,
    Belief,
    BeliefRequest,
    Candidate,
    Ending,
    Gaussian,
    Merged,
    Miss,
    Outcome,
    Place,
    Proposal,
    SearchGoal,
    SearchResult,
    Seat,
    Waypoint,
    slid_in,
)
from runtime.messages.session import (
    Phase,
    PlayerCommand,
    PlayerState,
    PublisherCount,
    PublisherCounts,
    SessionState,
    SnapshotReply,
    SnapshotRequest,
)

__all__ = [
    "BASE_FRAME",
    "NANOSECONDS",
    "AnswerGiven",
    "ArmStatus",
    "Attempt",
    "Belief",
    "BeliefRequest",
    "Candidate",
    "Choice",
    "Clock",
    "ControlTrace",
    "CurtainCommand",
    "CurtainState",
    "EmergencyStop",
    "Ending",
    "Float64MultiArray",
    "Gaussian",
    "Header",
    "Intervention",
    "InterventionAnswer",
    "InterventionReply",
    "JointState",
    "Log",
    "Merged",
    "Miss",
    "MultiArrayDimension",
    "MultiArrayLayout",
    "Muting",
    "Need",
    "Ossd",
    "Outcome",
    "Permit",
    "Phase",
    "Place",
    "PlayerCommand",
    "PlayerState",
    "Point",
    "Pose",
    "PoseStamped",
    "Proposal",
    "PublisherCount",
    "PublisherCounts",
    "Quaternion",
    "Reset",
    "ResetEdge",
    "SafetyState",
    "SearchGoal",
    "SearchResult",
    "Seat",
    "SessionState",
    "SnapshotReply",
    "SnapshotRequest",
    "String",
    "TFMessage",
    "Time",
    "Transform",
    "TransformStamped",
    "Truth",
    "Vector3",
    "Waypoint",
    "Wrench",
    "WrenchStamped",
    "header",
    "nanoseconds_of",
    "slid_in",
    "stamp_of",
    "typestore",
]


@cache
def typestore() -> Typestore:
    """ROS 2 Jazzy's types and palpate's own, which decode to the classes of this package."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, cls in declared().items():
        store.register(get_types_from_msg(definition(cls), name))
        store.types[name] = cls
    return store
