"""The primary, secondary and real-time client interfaces: programs and commands in, states and messages out."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import Protocol

from drivers.ur3e.control_box.controller_state import ControllerState
from drivers.ur3e.control_box.events import Event
from drivers.ur3e.control_box.peer import Peer
from drivers.ur3e.control_box.primary import ReportLevel, error_message, event_message, robot_state, version_message
from drivers.ur3e.control_box.realtime import RealtimePackage
from drivers.ur3e.control_box.script_text import ScriptText

STATE_CYCLES = 50  # a robot state every 100 ms
_AT_ONCE = 4  # programs that one client can start in a cycle
_AT_END = 16  # programs that are still started when a client has gone
_READ_ONLY = 210  # C210: a program came by an interface that is read-only in local control


class PrimaryBox(ControllerState, Protocol):
    """What the script ports need of a control box."""

    @property
    def events(self) -> Iterable[Event]:
        """What has happened in this cycle."""
        ...

    @property
    def remote_control(self) -> bool:
        """Whether clients may command."""
        ...

    @property
    def log(self) -> Callable[[str], None]:
        """Takes one line for the operator."""
        ...

    def run_script(self, text: str, origin: str) -> None:
        """Start a program, or report what is wrong with it."""
        ...

    def power_on(self) -> None:
        """Power the arm."""
        ...

    def power_off(self) -> None:
        """Take the power from the arm."""
        ...

    def brake_release(self) -> None:
        """Release the brakes."""
        ...

    def unlock_protective_stop(self, at_once: bool = False) -> bool:
        """False if it is too early, and not wanted `at_once`."""
        ...

    def set_speed_slider(self, fraction: float) -> None:
        """Set the speed slider, 0..1."""
        ...

    def play(self) -> bool:
        """Start or go on with the program; False if that cannot be done."""
        ...

    def pause(self) -> bool:
        """Pause the program; False if that cannot be done."""
        ...

    def stop(self) -> bool:
        """Stop the program; False if that cannot be done."""
        ...


class ScriptConversation:
    """One client that may send programs and commands, and is sent nothing."""

    port = "script"

    def __init__(self, box: PrimaryBox, peer: Peer, read_only: bool = False) -> None:
        self._box = box
        self._peer = peer
        self._read_only = read_only
        self._text = ScriptText()
        self._waiting = False  # programs may be left that came in an earlier cycle
        self._commands: dict[str, Callable[[], bool | None]] = {
            "power on": box.power_on,
            "power off": box.power_off,
            "set robotmode run": box.brake_release,
            "set unlock protective stop": partial(box.unlock_protective_stop, at_once=True),
            "stop program": box.stop,
            "pause program": box.pause,
            "resume program": box.play,
        }

    def opened(self) -> None:
        """See `Conversation`."""

    def received(self, data: bytes) -> None:
        """See `Conversation`."""
        if self._read_only:
            return
        self._text.add(data)
        self._run(_AT_ONCE)

    def cycle(self) -> None:
        """See `Conversation`."""
        if self._waiting:
            self._run(_AT_ONCE)

    def closed(self) -> None:
        """See `Conversation`. What had come in whole before the client went is still run."""
        if not self._read_only:
            self._run(_AT_END)

    def _run(self, most: int) -> None:
        self._waiting = True
        for _ in range(most):
            program = self._text.take()
            if program is None:
                self._waiting = False
                return
            self._handle(program)

    def _handle(self, text: str) -> None:
        box = self._box
        if not box.remote_control:
            box.log(f"{self.port} {self._peer.name}: sent a program, but the box is in local control")
            self._refuse()
            return
        line = " ".join(text.split())
        command = self._commands.get(line)
        if command is not None:
            if command() is False:
                box.log(f"{self.port} {self._peer.name}: {line!r} cannot be done now")
        elif line.startswith("set speed "):
            self._set_speed(line)
        else:
            box.run_script(text, f"{self.port} {self._peer.name}")

    def _set_speed(self, line: str) -> None:
        try:
            fraction = float(line.removeprefix("set speed "))
        except ValueError:
            fraction = -1.0
        if 0.0 <= fraction <= 1.0:
            self._box.set_speed_slider(fraction)
        else:
            self._box.log(f"{self.port} {self._peer.name}: {line!r} names no speed from 0 to 1")

    def _refuse(self) -> None:
        """Tell the client that it may not command; only the primary interface has a message for that."""


class SecondaryConversation(ScriptConversation):
    """A client of port 30002: robot states ten times a second. A state that the client is too slow for is left out."""

    port = "secondary"

    def opened(self) -> None:
        """See `Conversation`."""
        self._cycles = 0
        self._peer.send(version_message(self._box.version, self._box.time))

    def cycle(self) -> None:
        """See `Conversation`."""
        super().cycle()
        self._cycles += 1
        if self._cycles >= STATE_CYCLES and self._peer.backlog == 0:
            self._cycles = 0
            self._peer.send(robot_state(self._box))


class PrimaryConversation(SecondaryConversation):
    """A client of port 30001: robot states, and messages of all that happens."""

    port = "primary"

    def cycle(self) -> None:
        """See `Conversation`."""
        for event in self._box.events:
            self._peer.send(event_message(event, self._box.time))
        super().cycle()

    def _refuse(self) -> None:
        text = "the connection is read-only, since the box is in local control"
        self._peer.send(error_message(_READ_ONLY, 0, ReportLevel.WARNING, text, self._box.time))


class RealtimeConversation(ScriptConversation):
    """A client of port 30003: the state in every cycle, left out while the client does not take it."""

    port = "real-time"

    def __init__(self, box: PrimaryBox, peer: Peer, package: RealtimePackage, read_only: bool = False) -> None:
        super().__init__(box, peer, read_only)
        self._package = package

    def cycle(self) -> None:
        """See `Conversation`."""
        super().cycle()
        if self._peer.backlog == 0:
            self._peer.send(self._package.package())
