"""RTDE, the port on which clients read a controller's state and write its registers, up to 500 times a second."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from itertools import islice
from typing import Any

from drivers.ur3e.control_box.box import ControlBox
from drivers.ur3e.control_box.peer import Peer, PeerError
from drivers.ur3e.control_box.rtde_inputs import INPUTS, InputRecipe, input_recipe
from drivers.ur3e.control_box.rtde_outputs import Output, output
from drivers.ur3e.control_box.rtde_wire import (
    COUNT,
    IN_USE,
    LAYOUT,
    NOT_FOUND,
    Level,
    PackageStream,
    message,
    names_of,
    package,
)
from drivers.ur3e.parameters import CYCLE

HIGHEST = 1 / CYCLE  # [Hz]
_WHOLE = 1.0 - 1e-9  # of a package that is due, in spite of rounding
_LOWEST = 1.0  # [Hz]
_VERSIONS = (1, 2)
_RECIPES = 255  # a recipe's number is one byte
_UNREAD = 100_000  # [bytes] a client that is so far behind is sent nothing more until it has read
_PACKAGES = 32  # taken from one client in a control cycle: masses of small ones must not hold up the loop
_WAITING = 524_288  # [bytes] of packages that may wait for their cycle: several seconds of an honest client's
_HEARD = 10  # text messages of one client that are logged in a second
_TEXT = 255  # [characters] of a text message that are logged


class RtdePort:
    """What all RTDE clients of a controller share."""

    def __init__(self, box: ControlBox) -> None:
        self.box = box
        self.fed: Counter[str] = Counter()  # packages in which each input field has come
        self.claims: dict[str, object] = {}  # input field -> the client that writes it
        self._values: dict[str, Any] = {}  # of the present cycle, worked out so far

    def conversation(self, peer: Peer) -> RtdeConversation:
        """One client's side."""
        return RtdeConversation(self, peer)

    def cycle(self) -> None:
        """A control cycle has ended: values are to be worked out anew."""
        self._values.clear()

    def getter(self, name: str, field: Output) -> Callable[[], Any]:
        """How to read a field; what is not a mere look-up is worked out once a cycle for all clients."""
        box, values, read = self.box, self._values, field.value
        if not field.shared:
            return lambda: read(box)

        def shared() -> Any:
            try:
                return values[name]
            except KeyError:
                value = values[name] = read(box)
                return value

        return shared


@dataclass(frozen=True)
class _Inputs:
    """One recipe of inputs."""

    layout: struct.Struct
    counts: tuple[int, ...]  # values of each field
    recipe: InputRecipe

    def values(self, payload: bytes) -> list[Any]:
        """The fields' values: numbers, or tuples for vectors."""
        flat = iter(self.layout.unpack_from(payload))
        return [next(flat) if count == 1 else tuple(next(flat) for _ in range(count)) for count in self.counts]


class RtdeConversation:
    """One RTDE client."""

    def __init__(self, port: RtdePort, peer: Peer) -> None:
        self._port = port
        self._box = port.box
        self._peer = peer
        self._stream = PackageStream()
        self._version = 1  # until the client asks for another
        self._inputs: list[_Inputs] = []
        self._getters: tuple[tuple[Callable[[], Any], bool], ...] = ()  # and whether there are several values
        self._layout: struct.Struct | None = None
        self._head = b""
        self._rate = HIGHEST  # [Hz]
        self._due = 0.0  # packages
        self._started = False
        self._warned = False
        self._left = _PACKAGES  # to be taken in this cycle
        self._replies: list[bytes] = []
        self._second = 0.0  # [s] of the controller, in which text messages are counted
        self._heard = self._unheard = 0  # text messages logged and left out

    def opened(self) -> None:
        """See `Conversation`."""

    def received(self, data: bytes) -> None:
        """See `Conversation`. Packages beyond what a control cycle takes wait for the next."""
        try:
            self._take(data)
        finally:
            if self._replies:  # together, as each time of sending costs
                self._peer.send(b"".join(self._replies))
                self._replies.clear()

    def _take(self, data: bytes) -> None:
        for command, payload in islice(self._stream.feed(data), self._left):
            self._left -= 1
            act = self._COMMANDS.get(command)
            if act is None:
                raise PeerError(f"RTDE knows no command {command!r}")
            try:
                act(self, payload)
            except struct.error:
                raise PeerError(f"an RTDE package {command} of {len(payload)} bytes is not what it says") from None
        if self._stream.waiting > _WAITING:
            raise PeerError(f"sends more RTDE packages than the {_PACKAGES} that a control cycle takes")

    def closed(self) -> None:
        """See `Conversation`."""
        self._started = False
        claims = self._port.claims
        for name in [name for name, owner in claims.items() if owner is self]:
            del claims[name]

    # Commands

    def _ask_version(self, payload: bytes) -> None:
        (version,) = struct.unpack(">H", payload)
        accepted = version in _VERSIONS
        if accepted:
            self._version = version
        self._replies.append(package("V", bytes([accepted])))

    def _tell_controller(self, payload: bytes) -> None:
        _empty(payload)
        version = self._box.version
        numbers = (version.major, version.minor, version.bugfix, version.build)
        self._replies.append(package("v", struct.pack(">4I", *numbers)))

    def _set_outputs(self, payload: bytes) -> None:
        rate = HIGHEST
        if self._version > 1:
            (rate,) = struct.unpack_from(">d", payload)
            payload = payload[8:]
        names = names_of(payload)
        found = [output(name, self._box.version) for name in names]
        types = [NOT_FOUND if field is None else field.type for field in found]
        usable = bool(names) and None not in found and _LOWEST <= rate <= HIGHEST
        self._started = False
        self._layout = None
        if usable:
            fields = [(name, field) for name, field in zip(names, found, strict=True) if field is not None]
            self._getters = tuple((self._port.getter(name, field), COUNT[field.type] > 1) for name, field in fields)
            layout = "".join(LAYOUT[field.type] for _, field in fields)
            self._layout = struct.Struct(">" + layout)
            recipe = b"\x01" if self._version > 1 else b""
            self._head = package("U", recipe + bytes(self._layout.size))[: 3 + len(recipe)]
            self._rate = rate
        answer = ",".join(types).encode()
        number = bytes([usable]) if self._version > 1 else b""  # recipe 0 is none
        self._replies.append(package("O", number + answer))

    def _set_inputs(self, payload: bytes) -> None:
        names = names_of(payload)
        claims = self._port.claims
        types = []
        for name in names:
            kind = INPUTS.get(name, NOT_FOUND)
            taken = kind != NOT_FOUND and claims.get(name, self) is not self
            types.append(IN_USE if taken else kind)
        if len(self._inputs) >= _RECIPES:
            raise PeerError(f"more than {_RECIPES} RTDE input recipes")
        usable = bool(names) and not {NOT_FOUND, IN_USE} & set(types)
        if usable:
            claims.update(dict.fromkeys(names, self))
            layout = struct.Struct(">" + "".join(LAYOUT[kind] for kind in types))
            counts = tuple(COUNT[kind] for kind in types)
            self._inputs.append(_Inputs(layout, counts, input_recipe(names)))
        # A recipe that cannot be used has number 0, and takes none.
        number = bytes([len(self._inputs) if usable else 0])
        self._replies.append(package("I", number + ",".join(types).encode()))

    def _start(self, payload: bytes) -> None:
        _empty(payload)
        self._started = self._layout is not None
        self._due = 1.0 - self._rate / HIGHEST  # the first in the next cycle
        self._replies.append(package("S", bytes([self._started])))

    def _pause(self, payload: bytes) -> None:
        _empty(payload)
        self._started = False
        self._replies.append(package("P", b"\x01"))

    def _take_data(self, payload: bytes) -> None:
        number = payload[0] if payload else 0
        if not 1 <= number <= len(self._inputs):
            raise PeerError(f"RTDE input recipe {number} was not set up; there are {len(self._inputs)}")
        inputs = self._inputs[number - 1]
        size = len(payload) - 1
        if size < inputs.layout.size:
            # A real client sends such packages for one of its functions; the rest of its work must not suffer.
            self._warn(f"input package of recipe {number} ignored: {size} bytes, {inputs.layout.size} needed")
            return
        inputs.recipe.apply(self._box, inputs.values(payload[1:]))
        self._port.fed.update(inputs.recipe.names)

    def _warn(self, text: str) -> None:
        if not self._warned:
            self._warned = True
            self._box.log(f"rtde {self._peer.name}: {text}")
        if self._started:
            self._replies.append(message(text, "RTDE", Level.WARNING, self._version))

    def _hear_message(self, payload: bytes) -> None:
        """A client's text. Version 2: text, source and level with their lengths; version 1: level and bare text.

        It becomes one line of the log, whatever it contains, and not too many of them.
        """
        now = self._box.time
        if now - self._second >= 1.0:
            if self._unheard:
                self._box.log(f"rtde {self._peer.name}: {self._unheard} more messages were left out")
            self._second, self._heard, self._unheard = now, 0, 0
        if self._heard >= _HEARD:
            self._unheard += 1
            return
        self._heard += 1
        end = 1 + payload[0] if payload and self._version > 1 else len(payload)
        text = payload[1:end].decode(errors="replace")[:_TEXT]
        line = "".join(character if character.isprintable() else " " for character in text)
        self._box.log(f"rtde {self._peer.name}: {line}")

    _COMMANDS = {  # noqa: RUF012 - the methods of this class
        "V": _ask_version,
        "v": _tell_controller,
        "O": _set_outputs,
        "I": _set_inputs,
        "S": _start,
        "P": _pause,
        "U": _take_data,
        "M": _hear_message,
    }

    def cycle(self) -> None:
        """See `Conversation`."""
        self._left = _PACKAGES
        if self._stream.waiting:
            self.received(b"")
        layout = self._layout
        if not self._started or layout is None:
            return
        self._due += self._rate / HIGHEST
        if self._due < _WHOLE:
            return
        self._due -= 1.0
        if self._peer.backlog > _UNREAD:
            return
        values: list[Any] = []
        for get, several in self._getters:
            if several:
                values += get()
            else:
                values.append(get())
        self._peer.send(self._head + layout.pack(*values))


def _empty(payload: bytes) -> None:
    if payload:
        raise PeerError(f"an RTDE command with {len(payload)} bytes that it has no use for")
