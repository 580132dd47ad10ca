"""The sockets: who may connect, what is read in a cycle, what waits to be sent. Nothing here blocks or speaks UR."""

from __future__ import annotations

import errno
import select
import socket
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

from drivers.ur3e.control_box.peer import Conversation, Peer, PeerError
from runtime.errors import InputError

Service: TypeAlias = tuple[int, Callable[[Peer], Conversation]]  # number of the port, and what speaks on it

_READ, _WRITE = select.EPOLLIN, select.EPOLLOUT
_BROKEN = select.EPOLLERR | select.EPOLLHUP
_SEND = 65536  # [bytes] handed to the kernel at once
_GONE = (errno.EPIPE, errno.ECONNRESET, errno.ETIMEDOUT, errno.ENOTCONN)


@dataclass(frozen=True)
class Limits:
    """What clients may cost."""

    peers: int = 32  # at one port
    accepts: int = 4  # in a cycle, over all ports
    read: int = 4096  # [bytes] from one client in a cycle
    read_total: int = 16384  # [bytes] from all clients in a cycle
    backlog: int = 1 << 20  # [bytes] that a client has not taken
    log_lines: int = 10  # in a second


class _Log:
    """Hands on a few lines a second and counts the rest."""

    def __init__(self, log: Callable[[str], None], lines: int) -> None:
        self._log = log
        self._lines = lines
        self._window = 0.0
        self._said = 0
        self.suppressed = 0

    def __call__(self, text: str) -> None:
        now = time.monotonic()
        if now - self._window >= 1.0:
            self.catch_up(now)
            self._window, self._said = now, 0
        if self._said < self._lines:
            self._said += 1
            self._log(text)
        else:
            self.suppressed += 1

    def catch_up(self, now: float) -> None:
        """Say how many lines were left out, once their second is over."""
        if self.suppressed and now - self._window >= 1.0:
            self._log(f"{self.suppressed} more lines about clients were left out")
            self.suppressed = 0


class _Connection:
    """A connected client: the `Peer` that a conversation sees."""

    __slots__ = ("_epoll", "_limit", "_out", "_socket", "closing", "conversation", "fd", "name", "open", "port", "why")

    conversation: Conversation

    def __init__(self, connected: socket.socket, name: str, port: str, epoll: select.epoll, limit: int) -> None:
        self._socket = connected
        self._epoll = epoll
        self._limit = limit
        self._out = bytearray()
        self.fd = connected.fileno()
        self.name = name
        self.port = port
        self.open = True
        self.closing = False  # to be closed once all is sent
        self.why: str | None = None  # it is to be dropped; "" if that is nothing to speak of

    @property
    def backlog(self) -> int:
        """See `Peer`."""
        return len(self._out)

    def send(self, data: bytes) -> None:
        """See `Peer`."""
        if not self.open or self.closing or self.why is not None:
            return
        out = self._out
        if out:
            if len(out) + len(data) > self._limit:
                self.why = f"does not read: {len(out)} bytes are waiting for it"
            else:
                out += data
            return
        sent = self._try(data)
        if sent < len(data) and self.why is None:
            if len(data) - sent > self._limit:
                self.why = f"does not read: {len(data) - sent} bytes are waiting for it"
                return
            out += memoryview(data)[sent:]
            self._epoll.modify(self.fd, _READ | _WRITE)

    def close(self) -> None:
        """See `Peer`."""
        self.closing = True
        if not self._out and self.why is None:
            self.why = ""

    def flush(self) -> None:
        """Send what waits, as far as the client takes it."""
        out = self._out
        if out:
            with memoryview(out) as view:
                sent = self._try(view[:_SEND])
            del out[:sent]
        if not out and self.why is None:
            if self.closing:
                self.why = ""
            else:
                self._epoll.modify(self.fd, _READ)

    def read(self, size: int) -> bytes | None:
        """What has arrived, b"" if nothing has, None if the client has gone."""
        try:
            return self._socket.recv(size) or None
        except BlockingIOError:
            return b""
        except OSError:
            return None

    def shut(self) -> None:
        """Let go of the socket."""
        self.open = False
        self._out.clear()
        self._epoll.unregister(self.fd)
        self._socket.close()

    def _try(self, data: bytes | memoryview) -> int:
        try:
            return self._socket.send(data)
        except BlockingIOError:
            return 0
        except OSError as error:
            self.why = "" if error.errno in _GONE else f"cannot be sent to: {error.strerror}"
            return 0


@dataclass
class _Listener:
    name: str
    socket: socket.socket
    converse: Callable[[Peer], Conversation]
    peers: int = 0


class Ports:
    """All ports of a control box, served from the control loop: `receive`, then the box, then `cycle`.

    No client can stop the loop or starve another: each cycle reads a bounded number of bytes, from every client in
    turn; a client that breaks its protocol, or whose conversation fails, is dropped with a line in the log.
    """

    def __init__(
        self, host: str, services: Mapping[str, Service], log: Callable[[str], None], limits: Limits | None = None
    ) -> None:
        """Listen on `host`; number 0 takes any free port. Raises InputError that names a port that is taken."""
        self._limits = limits or Limits()
        self._log = _Log(log, self._limits.log_lines)
        self._epoll = select.epoll()
        self._listeners: dict[int, _Listener] = {}
        self._connections: dict[int, _Connection] = {}
        self._all: tuple[_Connection, ...] = ()
        self._readable: deque[_Connection] = deque()  # those at the front have waited longest
        self._knocking: deque[_Listener] = deque()
        try:
            for name, (number, converse) in services.items():
                listener = _Listener(name, _listen(host, name, number), converse)
                self._listeners[listener.socket.fileno()] = listener
                self._epoll.register(listener.socket.fileno(), _READ)
        except InputError:
            self.close()
            raise

    def number(self, name: str) -> int:
        """The number of a port."""
        return int(self._named(name).socket.getsockname()[1])

    def peers(self, name: str) -> int:
        """How many clients are connected to a port."""
        return self._named(name).peers

    def receive(self, deadline: float | None = None) -> None:
        """Accept clients and hand their bytes to their conversations; no more of it once `time.perf_counter()` has
        passed the deadline, except for one client.
        """
        events = self._epoll.poll(0)
        if events:
            for fd, event in events:
                self._note(fd, event)
        if self._readable:
            self._read(deadline)
        if self._knocking:
            self._accept()

    def cycle(self) -> None:
        """Let every conversation send what is due."""
        for connection in self._all:
            if connection.why is None:
                try:
                    connection.conversation.cycle()
                except Exception as error:  # a failing conversation must not stop the control loop
                    connection.why = _reason(error)
            if connection.why is not None:
                self._drop(connection)
        if self._log.suppressed:
            self._log.catch_up(time.monotonic())

    def close(self) -> None:
        """Hang up on everyone and listen no more."""
        for connection in self._all:
            connection.flush()
            connection.why = ""
            self._drop(connection)
        for listener in self._listeners.values():
            listener.socket.close()
        self._listeners.clear()
        self._epoll.close()

    def _named(self, name: str) -> _Listener:
        return next(listener for listener in self._listeners.values() if listener.name == name)

    def _note(self, fd: int, event: int) -> None:
        connection = self._connections.get(fd)
        if connection is None:
            listener = self._listeners[fd]
            if listener not in self._knocking:
                self._knocking.append(listener)
            return
        if event & _WRITE:
            connection.flush()
            if connection.why is not None:
                self._drop(connection)
                return
        if event & (_READ | _BROKEN) and connection not in self._readable:
            self._readable.append(connection)

    def _read(self, deadline: float | None) -> None:
        left = self._limits.read_total
        while self._readable and left > 0:
            connection = self._readable.popleft()
            if not connection.open:
                continue
            data = connection.read(min(self._limits.read, left))
            if data is None:
                connection.why = connection.why or ""
            elif data and not connection.closing:
                left -= len(data)
                try:
                    connection.conversation.received(data)
                except Exception as error:
                    connection.why = _reason(error)
            if connection.why is not None:
                self._drop(connection)
            if deadline is not None and time.perf_counter() > deadline:
                return

    def _accept(self) -> None:
        left = self._limits.accepts
        while self._knocking and left > 0:
            listener = self._knocking.popleft()
            try:
                accepted, address = listener.socket.accept()
            except BlockingIOError:
                continue
            except OSError as error:  # the client has gone again, or no descriptor is left
                self._log(f"{listener.name}: cannot accept a client: {error.strerror}")
                left -= 1
                continue
            left -= 1
            self._knocking.append(listener)
            name = f"{address[0]}:{address[1]}"
            if listener.peers >= self._limits.peers:
                accepted.close()
                self._log(f"{listener.name} {name}: refused, {listener.peers} clients are connected already")
            else:
                self._welcome(listener, accepted, name)

    def _welcome(self, listener: _Listener, accepted: socket.socket, name: str) -> None:
        accepted.setblocking(False)
        accepted.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection = _Connection(accepted, name, listener.name, self._epoll, self._limits.backlog)
        self._epoll.register(connection.fd, _READ)
        try:
            connection.conversation = listener.converse(connection)
            connection.conversation.opened()
        except Exception as error:
            connection.why = _reason(error)
            self._log(f"{connection.port} {connection.name}: dropped: {connection.why}")
            connection.shut()
            return
        listener.peers += 1
        self._connections[connection.fd] = connection
        self._all = (*self._all, connection)

    def _drop(self, connection: _Connection) -> None:
        if connection.why:
            self._log(f"{connection.port} {connection.name}: dropped: {connection.why}")
        del self._connections[connection.fd]
        self._all = tuple(one for one in self._all if one is not connection)
        self._named(connection.port).peers -= 1
        connection.shut()
        try:
            connection.conversation.closed()
        except Exception as error:
            self._log(f"{connection.port} {connection.name}: {_reason(error)}")


def _listen(host: str, name: str, number: int) -> socket.socket:
    try:
        family, kind, _, _, address = socket.getaddrinfo(host, number, type=socket.SOCK_STREAM)[0]
        listening = socket.socket(family, kind)
    except OSError as error:
        raise InputError(f"cannot listen on {host!r}: {error.strerror}; name an address of this machine") from None
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind(address)
        listening.listen(128)
    except OSError as error:
        listening.close()
        if error.errno == errno.EADDRINUSE:
            raise InputError(
                f"port {number} ({name}) of {host} is taken; end the program that has it, such as another simulator, "
                "or choose another port or address"
            ) from None
        raise InputError(f"cannot listen on port {number} ({name}) of {host}: {error.strerror}") from None
    listening.setblocking(False)
    return listening


def _reason(error: Exception) -> str:
    if isinstance(error, PeerError):
        return str(error)
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    where = "" if trace is None else f" at {Path(trace.tb_frame.f_code.co_filename).name}:{trace.tb_lineno}"
    return f"an error in the simulator, please report it: {type(error).__name__}: {error}{where}"
