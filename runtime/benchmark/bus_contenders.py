"""The contenders of `palpate bench bus`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from runtime.benchmark.ends import End, PalpateEnd, Ports
from runtime.benchmark.installed import missing
from runtime.benchmark.peers import RosEnd, ZmqEnd
from runtime.benchmark.raw_zenoh import ZenohEnd, channel_end, peer_end


@dataclass(frozen=True)
class BusContender:
    """One way to carry messages."""

    key: str  # in the figures
    label: str
    make: Callable[[bool, Ports], End]
    needs: tuple[str, ...] = ()  # modules
    install: str = ""  # what pip installs them from

    @property
    def missing(self) -> str:
        """What to do to have it; empty if it is there."""
        return missing(self.needs, self.install)


PALPATE = "palpate"
RAW = "raw"
RAW_CHANNEL = "raw_channel"
CONTENDERS = {
    contender.key: contender
    for contender in (
        BusContender(PALPATE, "palpate", PalpateEnd),
        BusContender(RAW, "raw Zenoh, callback", ZenohEnd),
        BusContender(RAW_CHANNEL, "raw Zenoh, channel", channel_end),
        BusContender("raw_peer", "raw Zenoh, no router", peer_end),
        BusContender("zmq", "pyzmq", ZmqEnd, ("zmq",), "pyzmq"),
        BusContender(
            "ros2",
            "ROS 2, rclpy",
            RosEnd,
            ("rclpy", "sensor_msgs.msg"),
            "ros-rclpy ros-rmw-fastrtps-cpp ros-sensor-msgs",
        ),
    )
}
