"""What carries a joint state from one process to another and back in `palpate bench bus`.

Each end encodes what it sends and decodes what it receives, and works in one thread, as a plugin does.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

from runtime.benchmark.sample import PING, PONG, joint_state
from runtime.bus import Envelope
from runtime.messages import JointState
from runtime.network.zenoh_bus import ZenohBus


@dataclass(frozen=True)
class Ports:
    """Where the contenders meet on loopback."""

    router: int  # of Zenoh
    ping: int
    pong: int
    peer: int  # of Zenoh without a router


class End(Protocol):
    """One of two ends. The near one sends on ping and receives on pong, the far one the other way round."""

    def message(self, number: int) -> Any:
        """The joint state of this number in the library's own type."""
        ...

    @property
    def heard(self) -> bool:
        """Whether the other end is known to listen."""
        ...

    def send(self, message: Any) -> None:
        """Encode and send; waits rather than loses, as far as the library can."""
        ...

    def receive(self, timeout: float) -> Any | None:
        """The next message, decoded; None after `timeout` seconds if the library can stop waiting."""
        ...

    def close(self) -> None:
        """Leave."""
        ...


class PalpateEnd:
    """A plugin on palpate's bus."""

    def __init__(self, near: bool, ports: Ports) -> None:
        out, self._incoming = (PING, PONG) if near else (PONG, PING)
        self._bus = ZenohBus("near" if near else "far", ports.router)
        self._bus.subscribe(self._incoming)
        self._publisher = self._bus.publisher(out)
        self._bus.announce()
        self.message = joint_state

    @property
    def heard(self) -> bool:
        """Whether the other end listens."""
        return self._publisher.matched

    def send(self, message: JointState) -> None:
        """Publish."""
        self._publisher.send(message, message.header.stamp.nanosec)

    def receive(self, timeout: float) -> JointState | None:
        """Take from the inbox."""
        item = self._bus.inbox.receive(timeout)
        return item.read(self._incoming) if isinstance(item, Envelope) else None

    def close(self) -> None:
        """Leave the bus."""
        self._bus.close()
