"""URScript's sockets: the program is the client. Nothing here waits; what has not arrived is asked for again.

A name is looked up outside the control loop's way only if it is a number already, so hosts have to be IP addresses.
"""

from __future__ import annotations

import errno
import ipaddress
import re
import socket
import struct
from collections.abc import Generator
from typing import Any, TypeAlias

from drivers.ur3e.parameters import CYCLE
from drivers.ur3e.urscript.values import written
from runtime.errors import ArmError

Cycles: TypeAlias = Generator[None, None, Any]

_DEFAULT = "socket_0"
_TIMEOUT = 2.0  # [s] URScript manual
_CONNECT_TIMEOUT = 2.0  # [s] assumed
_CONNECTING = 2  # assumed: cycles that a connection takes at least, as over a network, so that the peer has accepted it
_BUFFER = 1 << 20  # [bytes] kept of what a program has not read
_AT_ONCE = 1 << 16  # [bytes] read in one go
_MOST = 30  # integers, bytes or numbers in one read, URScript manual
_SOCKETS = 20  # open at once
_READS = 10  # assumed: reads of one socket in a control cycle, so that a client that floods it cannot hold a program up
_NUMBER = re.compile(rb"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")


class _Socket:
    """One connection, read into a buffer."""

    def __init__(self, link: socket.socket) -> None:
        self.link = link
        self.buffer = b""
        self.closed = False
        self.reads = 0  # in this control cycle

    def fill(self) -> None:
        """Take in what has arrived."""
        if self.closed or len(self.buffer) >= _BUFFER:
            return
        try:
            data = self.link.recv(_AT_ONCE)
        except (BlockingIOError, InterruptedError):
            return
        except OSError:
            data = b""
        if data:
            self.buffer += data
        else:
            self.closed = True

    def take(self, count: int) -> bytes:
        """The first bytes of the buffer."""
        data, self.buffer = self.buffer[:count], self.buffer[count:]
        return data

    def send(self, data: bytes) -> bool:
        """Whether all of it went out."""
        try:
            return self.link.send(data) == len(data)
        except OSError:
            self.closed = True
            return False


class SocketBuiltins:
    """The functions for sockets; `close_all` when the program ends."""

    def __init__(self) -> None:
        self._sockets: dict[str, _Socket] = {}

    def after_programs(self) -> None:
        """Every program has had its cycle."""
        for link in self._sockets.values():
            link.reads = 0

    def close_all(self) -> None:
        """Hang up everywhere."""
        for name in list(self._sockets):
            self.socket_close(name)

    def socket_open(self, address: str, port: float, socket_name: str = _DEFAULT) -> Cycles:
        """Connect; whether that worked. A socket of that name that is open stays, and that is True too."""
        if socket_name in self._sockets and not self._sockets[socket_name].closed:
            return True
        if len(self._sockets) >= _SOCKETS:
            raise ArmError(f"a program may have {_SOCKETS} sockets open at once")
        try:
            host = ipaddress.ip_address("127.0.0.1" if address == "localhost" else address)
        except ValueError:
            return False
        link = socket.socket(socket.AF_INET6 if host.version == 6 else socket.AF_INET)
        link.setblocking(False)
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        made = False
        try:
            begun = link.connect_ex((str(host), int(port)))
            if begun not in (0, errno.EINPROGRESS):
                return False
            for cycle in range(round(_CONNECT_TIMEOUT / CYCLE)):
                if cycle >= _CONNECTING and _connected(link):
                    made = True
                    break
                if link.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
                    return False
                yield
        finally:
            if not made:
                link.close()
        if made:
            self._sockets[socket_name] = _Socket(link)
        return made

    def socket_close(self, socket_name: str = _DEFAULT) -> None:
        """Hang up."""
        found = self._sockets.pop(socket_name, None)
        if found is not None:
            found.link.close()

    def _send(self, name: str, data: bytes) -> bool:
        found = self._sockets.get(name)
        return found is not None and found.send(data)

    def socket_send_string(self, str: object, socket_name: str = _DEFAULT) -> bool:  # noqa: A002
        """Send text as it is."""
        return self._send(socket_name, text_of(str).encode())

    def socket_send_line(self, str: object, socket_name: str = _DEFAULT) -> bool:  # noqa: A002
        """Send text and a line feed."""
        return self._send(socket_name, text_of(str).encode() + b"\n")

    def socket_send_byte(self, value: float, socket_name: str = _DEFAULT) -> bool:
        """Send one byte."""
        return self._send(socket_name, bytes([int(value) & 0xFF]))

    def socket_send_int(self, value: float, socket_name: str = _DEFAULT) -> bool:
        """Send a 32-bit integer, network order."""
        return self._send(socket_name, struct.pack(">I", int(value) & 0xFFFFFFFF))

    def _wait(self, name: str, ready: Any, timeout: float) -> Generator[None, None, _Socket | None]:
        """The socket once `ready` says so; None if it does not in time, or the peer has gone. 0: for ever."""
        found = self._sockets.get(name)
        if found is None:
            yield  # a program that tries again and again must not do so without end in one cycle
            return None
        waited = 0.0
        while found.reads >= _READS:
            waited += CYCLE
            yield
        found.reads += 1
        found.fill()
        while not ready(found):
            if found.closed or (timeout > 0 and waited >= timeout - CYCLE / 2):
                if not waited:
                    yield
                return None
            waited += CYCLE
            yield
            found.fill()
        return found

    def socket_read_binary_integer(
        self, number: float, socket_name: str = _DEFAULT, timeout: float = _TIMEOUT
    ) -> Cycles:
        """[count, values...] of 32-bit integers in network order; [0] if they do not come in time."""
        count = _count(number)
        found = yield from self._wait(socket_name, lambda s: len(s.buffer) >= 4 * count, timeout)
        if found is None:
            return [0]
        return [count, *struct.unpack(f">{count}i", found.take(4 * count))]

    def socket_read_byte_list(self, number: float, socket_name: str = _DEFAULT, timeout: float = _TIMEOUT) -> Cycles:
        """[count, bytes...]; [0] if they do not come in time."""
        count = _count(number)
        found = yield from self._wait(socket_name, lambda s: len(s.buffer) >= count, timeout)
        return [0] if found is None else [count, *found.take(count)]

    def socket_read_ascii_float(self, number: float, socket_name: str = _DEFAULT, timeout: float = _TIMEOUT) -> Cycles:
        """[count, values...] of `(1.0, 2.0, ...)`; [0] if they do not come in time."""
        count = _count(number)
        found = yield from self._wait(socket_name, lambda s: b")" in s.buffer, timeout)
        if found is None:
            return [0]
        values = [float(item) for item in _NUMBER.findall(found.take(found.buffer.index(b")") + 1))]
        return [count, *values[:count]] if len(values) >= count else [0]

    def socket_read_string(
        self,
        socket_name: str = _DEFAULT,
        prefix: str = "",
        suffix: str = "",
        interpret_escape: bool = False,  # noqa: ARG002 - escapes are not known in prefixes here
        timeout: float = _TIMEOUT,
    ) -> Cycles:
        """Text up to `suffix`, or all that is there, without prefix and suffix; empty if nothing comes in time."""
        start, end = prefix.encode(), suffix.encode()
        found = yield from self._wait(
            socket_name, lambda s: s.buffer and (not end or s.buffer.find(end, len(start)) >= 0), timeout
        )
        if found is None:
            return ""
        length = found.buffer.find(end, len(start)) + len(end) if end else len(found.buffer)
        data = found.take(length).removesuffix(end)
        return data[data.find(start) + len(start) if start in data else 0 :].decode(errors="replace")

    def socket_read_line(self, socket_name: str = _DEFAULT, timeout: float = _TIMEOUT) -> Cycles:
        """One line without its end; empty if none comes in time."""
        found = yield from self._wait(socket_name, lambda s: b"\n" in s.buffer, timeout)
        if found is None:
            return ""
        return found.take(found.buffer.index(b"\n") + 1).rstrip(b"\r\n").decode(errors="replace")

    def socket_set_var(self, name: str, value: float, socket_name: str = _DEFAULT) -> bool:
        """Send `SET name value`."""
        return self._send(socket_name, f"SET {name} {int(value)}\n".encode())

    def socket_get_var(self, name: str, socket_name: str = _DEFAULT) -> Cycles:
        """Ask `GET name`, and take the number out of the answer `name value`; 0 if none comes in time."""
        self._send(socket_name, f"GET {name}\n".encode())
        line = yield from self.socket_read_line(socket_name)
        number = _NUMBER.search(line.removeprefix(name).encode())
        return int(float(number[0])) if number else 0


def text_of(value: object) -> str:
    """What a socket or a message shows of a value: text as it is, all else as a script writes it."""
    return value if isinstance(value, str) else written(value)


def _connected(link: socket.socket) -> bool:
    try:
        link.getpeername()
    except OSError:
        return False
    return True


def _count(number: float) -> int:
    count = int(number)
    if not 1 <= count <= _MOST:
        raise ArmError(f"1 to {_MOST} values can be read at once, not {count}")
    return count
