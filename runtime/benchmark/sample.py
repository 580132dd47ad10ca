"""What is sent and written in a measurement: joint states as an arm of six joints publishes them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from runtime.bus import encode
from runtime.messages import Header, JointState, Time
from runtime.topics import ANYBODY, Topic

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
NUMBERS = 1_000_000_000  # messages that can be told apart, since their number travels as nanoseconds
LOG_TOPICS = 10


@dataclass(frozen=True)
class MeasuredTopic(Topic[JointState]):
    """A topic of a measurement, which stays out of the map."""

    def __post_init__(self) -> None:
        """Leave the map alone."""


def topic(name: str) -> MeasuredTopic:
    """A topic of joint states."""
    return MeasuredTopic(name, JointState, ANYBODY, "as measured", "a topic of a measurement")


PING = topic("/bench/ping")
PONG = topic("/bench/pong")
LOGGED = tuple(topic(f"/bench/joint_states_{number}") for number in range(LOG_TOPICS))


def joint_names() -> list[str]:
    """Names of the joints, as ROS has them."""
    return [f"{joint}_joint" for joint in JOINTS]


def joint_state(number: int) -> JointState:
    """The message of this number."""
    angles = np.linspace(-1.5, 1.5, len(JOINTS)) + 1e-6 * number
    stamp = Header(stamp=Time(sec=0, nanosec=number), frame_id="")
    return JointState(stamp, joint_names(), angles, 0.1 * angles, 10.0 * angles)


def payloads(count: int) -> list[bytes]:
    """Different joint states as CDR, 316 bytes each."""
    return [encode(joint_state(number)) for number in range(count)]
