"""RTDE on the wire: packages and types (RTDE guide of Universal Robots). Big endian; a header of size and command.

command            client to controller                 controller to client
V  version         uint16                               uint8 accepted
v  URControl       -                                    uint32 major, minor, bugfix, build
M  message         (version 2) as from the controller   text, source, level
U  data            recipe, values                       recipe, values (version 1: values alone)
O  outputs         (version 2) double frequency, names  (version 2) recipe, types
I  inputs          names                                recipe, types
S, P start, pause  -                                    uint8 accepted
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from enum import IntEnum

from drivers.ur3e.control_box.peer import PeerError

HEADER = struct.Struct(">HB")
LARGEST = 16384  # [bytes] of a package from a client; UR's guide limits recipes to 2048, its own clients do not
NOT_FOUND, IN_USE = "NOT_FOUND", "IN_USE"

# Layout of each type, and how many values it has.
LAYOUT = {
    "BOOL": "?",
    "UINT8": "B",
    "UINT32": "I",
    "UINT64": "Q",
    "INT32": "i",
    "DOUBLE": "d",
    "VECTOR3D": "3d",
    "VECTOR6D": "6d",
    "VECTOR6INT32": "6i",
    "VECTOR6UINT32": "6I",
}
COUNT = {name: int(layout[0]) if layout[0].isdigit() else 1 for name, layout in LAYOUT.items()}


class Level(IntEnum):
    """How bad a message is."""

    EXCEPTION = 0
    ERROR = 1
    WARNING = 2
    INFO = 3


def package(command: str, payload: bytes = b"") -> bytes:
    """One package."""
    return HEADER.pack(HEADER.size + len(payload), ord(command)) + payload


class PackageStream:
    """Cuts a stream of bytes into packages."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    @property
    def waiting(self) -> int:
        """Bytes that have come and have not been taken as packages yet."""
        return len(self._buffer)

    def feed(self, data: bytes) -> Iterator[tuple[str, bytes]]:
        """Command and payload of every package that is whole by now; what is not taken comes with the next call.

        Taking a package raises PeerError if its size is impossible.
        """
        self._buffer += data
        return self._whole()

    def _whole(self) -> Iterator[tuple[str, bytes]]:
        while len(self._buffer) >= HEADER.size:
            size, command = HEADER.unpack_from(self._buffer)
            if not HEADER.size <= size <= LARGEST:
                raise PeerError(f"an RTDE package of {size} bytes; from {HEADER.size} to {LARGEST} are accepted")
            if len(self._buffer) < size:
                return
            payload = bytes(self._buffer[HEADER.size : size])
            del self._buffer[:size]
            yield chr(command), payload


def names_of(data: bytes) -> list[str]:
    """The names in a recipe; a comma at the end is no name, as clients differ in it. Raises PeerError."""
    try:
        text = data.decode("ascii")
    except UnicodeDecodeError:
        raise PeerError("an RTDE recipe that is not ASCII") from None
    return text.rstrip(",").split(",") if text.rstrip(",") else []


def message(text: str, source: str, level: Level, version: int) -> bytes:
    """A text message: version 2 has lengths, version 1 the level and bare text."""
    body, origin = text.encode()[:255], source.encode()[:255]
    if version == 1:
        return package("M", bytes([level]) + body)
    return package("M", bytes([len(body)]) + body + bytes([len(origin)]) + origin + bytes([level]))
