"""The seam between sockets and protocols: bytes in, bytes out, no socket in sight."""

from __future__ import annotations

from typing import Protocol

from runtime.errors import PalpateError


class PeerError(PalpateError):
    """A client broke the protocol or a limit; it is dropped, with this reason in the log."""


class Peer(Protocol):
    """One connected client, as a protocol sees it."""

    @property
    def name(self) -> str:
        """Who it is, such as `127.0.0.1:51234`, for the log."""
        ...

    @property
    def backlog(self) -> int:
        """Bytes that the client has not taken yet."""
        ...

    def send(self, data: bytes) -> None:
        """Send without waiting: what the client does not take is kept for it. Never raises; a client whose backlog
        exceeds the limit is dropped.
        """
        ...

    def close(self) -> None:
        """Hang up once everything sent has gone out."""
        ...


class Conversation(Protocol):
    """One client's side of a port. Called from the control loop only, so nothing may wait.

    Any method may raise PeerError, which drops the client and logs the reason.
    """

    def opened(self) -> None:
        """The client has connected."""
        ...

    def received(self, data: bytes) -> None:
        """Some bytes from the client, cut anywhere."""
        ...

    def cycle(self) -> None:
        """A control cycle has ended; send what is due."""
        ...

    def closed(self) -> None:
        """The client has gone. Not a chance to send."""
        ...
