"""Where a cell's plugins meet, and what is needed to come in."""

from __future__ import annotations

import socket
from dataclasses import dataclass
from pathlib import Path

DEFAULT_PORT = 7447  # the router port of rmw_zenoh
LOOPBACK = "127.0.0.1"
EVERYWHERE = ("0.0.0.0", "::")  # every address of the machine


@dataclass(frozen=True)
class MeetingPoint:
    """The router of a cell, as its plugins and whoever joins them find it."""

    port: int = DEFAULT_PORT
    domain: int = 0  # ROS_DOMAIN_ID
    hosts: tuple[str, ...] = (LOOPBACK,)  # addresses that the router listens on
    keys: Path | None = None  # folder of keys; None: no TLS, and everybody who reaches it may say everything

    @property
    def host(self) -> str:
        """Where clients reach the router; on its own machine, if it listens on every address."""
        return LOOPBACK if any(host in EVERYWHERE for host in self.hosts) else self.hosts[0]

    def endpoint(self, host: str) -> str:
        """A host as Zenoh spells it."""
        return f"{'tcp' if self.keys is None else 'tls'}/{f'[{host}]' if ':' in host else host}:{self.port}"

    def __str__(self) -> str:
        return f"{self.host}:{self.port}"


def free_port() -> int:
    """A port on loopback that nobody listens on."""
    with socket.socket() as probe:
        probe.bind((LOOPBACK, 0))
        return int(probe.getsockname()[1])
