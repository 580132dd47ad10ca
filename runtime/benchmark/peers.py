"""What others carry messages with, where it is installed."""

from __future__ import annotations

import os
import queue
from typing import Any

from runtime.benchmark.ends import Ports
from runtime.benchmark.sample import PING, PONG, joint_names, joint_state
from runtime.bus import decode, encode
from runtime.messages import JointState
from runtime.network.meeting_point import LOOPBACK


class ZmqEnd:
    """pyzmq's push and pull sockets over TCP with rosbags."""

    def __init__(self, near: bool, ports: Ports) -> None:
        import zmq

        self._context = zmq.Context()
        self._out = self._context.socket(zmq.PUSH)
        self._incoming = self._context.socket(zmq.PULL)
        out, incoming = (ports.ping, ports.pong) if near else (ports.pong, ports.ping)
        self._incoming.bind(f"tcp://{LOOPBACK}:{incoming}")
        self._out.connect(f"tcp://{LOOPBACK}:{out}")
        self.message = joint_state

    @property
    def heard(self) -> bool:
        """Whether the other end listens."""
        return True  # a socket keeps what it cannot send yet

    def send(self, message: JointState) -> None:
        """Push."""
        self._out.send(encode(message))

    def receive(self, timeout: float) -> JointState | None:
        """Pull."""
        if not self._incoming.poll(round(timeout * 1000)):
            return None
        return decode(self._incoming.recv(), JointState)

    def close(self) -> None:
        """Close the sockets, and forget what was not sent."""
        self._context.destroy(linger=0)


class RosEnd:
    """A ROS 2 node with ROS 2's own codec, on loopback."""

    def __init__(self, near: bool, ports: Ports) -> None:
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        import rclpy
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.qos import QoSProfile, ReliabilityPolicy
        from sensor_msgs.msg import JointState as RosJointState

        self._type = RosJointState
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=1 + ports.ping % 100)
        self._node = rclpy.create_node("near" if near else "far", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._queue: queue.SimpleQueue[Any] = queue.SimpleQueue()
        out, incoming = (PING, PONG) if near else (PONG, PING)
        quality = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
        self._publisher = self._node.create_publisher(self._type, out.name, quality)
        self._node.create_subscription(self._type, incoming.name, self._queue.put, quality)

    def message(self, number: int) -> Any:
        """The same joint state in ROS 2's class."""
        ours, made = joint_state(number), self._type()
        made.header.stamp.nanosec = number
        made.header.frame_id = ours.header.frame_id
        made.name = joint_names()
        made.position, made.velocity, made.effort = (
            values.tolist() for values in (ours.position, ours.velocity, ours.effort)
        )
        return made

    @property
    def heard(self) -> bool:
        """Whether the other end listens."""
        return bool(self._publisher.get_subscription_count())

    def send(self, message: Any) -> None:
        """Publish."""
        self._publisher.publish(message)

    def receive(self, timeout: float) -> Any | None:
        """Let the executor work until there is a message."""
        if self._queue.empty():
            self._executor.spin_once(timeout_sec=timeout)
        try:
            return self._queue.get_nowait()
        except queue.Empty:
            return None

    def close(self) -> None:
        """Leave the graph."""
        self._node.destroy_node()
        self._context.try_shutdown()
