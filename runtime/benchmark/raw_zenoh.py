"""Plain zenoh-python, without palpate's bus: what that is measured against."""

from __future__ import annotations

import json
import queue
from typing import Any

import zenoh

from runtime.benchmark.ends import End, Ports
from runtime.benchmark.sample import joint_state
from runtime.bus import decode, encode
from runtime.messages import JointState
from runtime.network.meeting_point import LOOPBACK

_BACKLOG = 100_000  # messages that may wait in a channel


class ZenohEnd:
    """Plain zenoh-python with rosbags, client of a router or peer of the other end.

    Messages come by a callback that puts them into a queue, or from Zenoh's own channel. The latter is the fastest way
    into a Python thread, but holds one subscription and cannot stop waiting.
    """

    def __init__(self, near: bool, ports: Ports, *, callback: bool = True, routed: bool = True) -> None:
        way = f"bench/{'callback' if callback else 'channel'}/{'routed' if routed else 'peer'}"
        out, incoming = (f"{way}/ping", f"{way}/pong") if near else (f"{way}/pong", f"{way}/ping")
        here, there = ([], [f"tcp/{LOOPBACK}:{ports.router}"]) if routed else ([f"tcp/{LOOPBACK}:{ports.peer}"], [])
        if near and not routed:
            here, there = there, here
        settings = {
            "mode": "client" if routed else "peer",
            "connect/endpoints": there,
            "listen/endpoints": here,
            "scouting/multicast/enabled": False,
            "timestamping/enabled": True,
            "transport/link/tx/queue/congestion_control/block/wait_before_close": 60_000_000,  # [us]
        }
        config = zenoh.Config()
        for name, value in settings.items():
            config.insert_json5(name, json.dumps(value))
        self._session = zenoh.open(config)
        self._queue: queue.SimpleQueue[zenoh.Sample] = queue.SimpleQueue()
        handler: Any = self._queue.put if callback else zenoh.handlers.FifoChannel(_BACKLOG)
        self._subscriber = self._session.declare_subscriber(incoming, handler)
        self._take = self._from_queue if callback else self._from_channel
        self._publisher = self._session.declare_publisher(out, congestion_control=zenoh.CongestionControl.BLOCK)
        self.message = joint_state

    @property
    def heard(self) -> bool:
        """Whether the other end listens."""
        status: Any = self._publisher.matching_status  # zenoh's stub calls it a bool, which it is not
        return bool(status.matching)

    def send(self, message: JointState) -> None:
        """Put."""
        self._publisher.put(encode(message))

    def receive(self, timeout: float) -> JointState | None:
        """Take from the queue or the channel."""
        sample = self._take(timeout)
        return None if sample is None else decode(bytes(sample.payload), JointState)

    def _from_queue(self, timeout: float) -> Any | None:
        try:
            return self._queue.get(timeout=timeout)
        except queue.Empty:
            return None

    def _from_channel(self, timeout: float) -> Any | None:  # noqa: ARG002 - Zenoh's channel knows no time limit
        return self._subscriber.recv()

    def close(self) -> None:
        """Close the session."""
        self._session.close()


def channel_end(near: bool, ports: Ports) -> End:
    """Raw Zenoh by its channel."""
    return ZenohEnd(near, ports, callback=False)


def peer_end(near: bool, ports: Ports) -> End:
    """Raw Zenoh by its channel, without a router."""
    return ZenohEnd(near, ports, callback=False, routed=False)
