"""The dashboard server, port 29999: one line of text in, one line out, as UR's e-Series answers."""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from pathlib import PurePosixPath
from typing import Protocol, TypeAlias

from drivers.ur3e.control_box.controller_state import BUILD_DATE
from drivers.ur3e.control_box.modes import RobotMode, RuntimeState, SafetyMode
from drivers.ur3e.control_box.peer import Peer, PeerError
from drivers.ur3e.control_box.version import PolyScope

_BANNER = "Connected: Universal Robots Dashboard Server"
_BYE = "Disconnected"
_LOCAL = (
    "Command is not allowed due to safety reasons, "
    "please switch robot to Remote Control mode and reconnect to port 29999"
)
_TOO_EARLY = (
    "Cannot unlock protective stop until 5s after occurrence. Always inspect cause of protective stop before unlocking"
)
_MODEL = "UR3"  # of a UR3e too
_NO_NAME = "<unnamed>"
_LINE = 4096  # [bytes] of a command
_WAITING = 65536  # [bytes] of commands that are not answered yet
_AT_ONCE = 8  # commands that one client is answered in a cycle
_AT_END = 64  # commands that are still carried out when a client has gone
_ECHO = 200  # characters of a command that a reply repeats
_WORDS = 4  # of the longest command

_PROGRAM_STATE = {
    RuntimeState.STOPPED: "STOPPED",
    RuntimeState.STOPPING: "PLAYING",
    RuntimeState.PLAYING: "PLAYING",
    RuntimeState.RESUMING: "PLAYING",
    RuntimeState.PAUSING: "PLAYING",
    RuntimeState.PAUSED: "PAUSED",
}


_LOAD = {"LOADED": "Loading program", "NOT_FOUND": "File not found", "BROKEN": "Error while loading program"}


class DashboardBox(Protocol):
    """What the dashboard needs of a control box."""

    @property
    def version(self) -> PolyScope:
        """The software."""
        ...

    @property
    def serial(self) -> str:
        """Digits only."""
        ...

    @property
    def robot_mode(self) -> RobotMode:
        """What the arm is able to do."""
        ...

    @property
    def safety_mode(self) -> SafetyMode:
        """Why it may or may not move."""
        ...

    @property
    def runtime_state(self) -> RuntimeState:
        """What the program is doing."""
        ...

    @property
    def program_name(self) -> str:
        """The running or last program, "" if there was none."""
        ...

    @property
    def loaded_program(self) -> str:
        """The file that was loaded, "" if none was."""
        ...

    @property
    def operational_mode(self) -> str:
        """NONE, MANUAL or AUTOMATIC."""
        ...

    @property
    def remote_control(self) -> bool:
        """Whether clients may command."""
        ...

    @property
    def log(self) -> Callable[[str], None]:
        """Takes one line for the operator."""
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

    def unlock_protective_stop(self) -> bool:
        """False if it is too early."""
        ...

    def restart_safety(self) -> None:
        """Recover from a fault or violation."""
        ...

    def load_program(self, name: str) -> Enum:
        """Load a program from the programs' folder: LOADED, NOT_FOUND or BROKEN."""
        ...

    def play(self) -> bool:
        """Start or go on with the loaded program; False if that cannot be done."""
        ...

    def pause(self) -> bool:
        """Pause the program; False if that cannot be done."""
        ...

    def stop(self) -> bool:
        """Stop the program; False if that cannot be done."""
        ...

    def show_popup(self, text: str) -> None:
        """Show a window to the operator."""
        ...

    def close_popup(self) -> None:
        """Close that window."""
        ...

    def close_safety_popup(self) -> None:
        """Close the window about a stop."""
        ...

    def add_to_log(self, text: str) -> None:
        """Write a line into the controller's log."""
        ...

    def set_operational_mode(self, mode: str) -> None:
        """Choose MANUAL or AUTOMATIC, and keep the choice from the operator."""
        ...

    def clear_operational_mode(self) -> None:
        """Leave the choice to the operator."""
        ...

    def shutdown(self) -> None:
        """End in good order."""
        ...


_Answer: TypeAlias = Callable[[str], str]  # what stands after the command's name, to the reply


class DashboardConversation:
    """One client of the dashboard server.

    Commands may be written in capitals or small letters. The answer to what is only in part of a simulator's world is
    UR's refusal: there are no installation files, flight reports, support files or log files to load or to write. User
    roles are left to CB3, and not understood, as on an e-Series.
    """

    def __init__(self, box: DashboardBox, peer: Peer) -> None:
        self._box = box
        self._peer = peer
        self._pending = bytearray()
        self._quit = False
        self._plain: dict[str, Callable[[], str]] = {
            "play": lambda: self._tried("play", "Starting program", box.play()),
            "stop": lambda: self._tried("stop", "Stopped", box.stop()),
            "pause": lambda: self._tried("pause", "Pausing program", box.pause()),
            "quit": lambda: _BYE,
            "shutdown": lambda: self._done("Shutting down", box.shutdown),
            "running": self._running,
            "robotmode": lambda: f"Robotmode: {box.robot_mode.name}",
            "safetymode": lambda: f"Safetymode: {box.safety_mode.name}",
            "safetystatus": lambda: f"Safetystatus: {box.safety_mode.name}",
            "get loaded program": self._loaded,
            "isprogramsaved": self._saved,
            "programstate": lambda: f"{_PROGRAM_STATE[box.runtime_state]} {self._program()}",
            "polyscopeversion": lambda: f"URSoftware {box.version} ({BUILD_DATE:%b %d %Y})",
            "version": lambda: str(box.version),
            "get operational mode": lambda: box.operational_mode,
            "clear operational mode": self._clear_operational_mode,
            "power on": lambda: self._done("Powering on", box.power_on),
            "power off": lambda: self._done("Powering off", box.power_off),
            "brake release": lambda: self._done("Brake releasing", box.brake_release),
            "unlock protective stop": self._unlock,
            "close popup": lambda: self._done("closing popup", box.close_popup),
            "close safety popup": lambda: self._done("closing safety popup", box.close_safety_popup),
            "restart safety": lambda: self._done("Restarting safety", box.restart_safety),
            "is in remote control": lambda: "true" if box.remote_control else "false",
            "get serial number": lambda: box.serial,
            "get robot model": lambda: _MODEL,
            "savelog": lambda: self._lacks("saveLog", "log files"),
        }
        self._with_text: dict[str, _Answer] = {
            "load": self._load,
            "popup": lambda text: self._done("showing popup", lambda: box.show_popup(text)),
            "addtolog": self._add_to_log,
            "set operational mode": self._set_operational_mode,
            "load installation": lambda name: f"{_LOAD['NOT_FOUND']}: {name}",
            "generate flight report": lambda kind: self._lacks(f"generate flight report {kind}", "flight reports"),
            "generate support file": lambda path: self._lacks(f"generate support file {path}", "support files"),
        }

    def opened(self) -> None:
        """See `Conversation`."""
        self._say(_BANNER)

    def received(self, data: bytes) -> None:
        """See `Conversation`."""
        self._pending += data
        if len(self._pending) > _WAITING:
            raise PeerError(f"sent over {_WAITING} bytes of commands without waiting for answers")
        self._answer(_AT_ONCE)
        self._check_length()

    def cycle(self) -> None:
        """See `Conversation`."""
        if self._pending:
            self._answer(_AT_ONCE)
            self._check_length()

    def closed(self) -> None:
        """See `Conversation`. What had come in whole before the client went is still carried out."""
        self._answer(_AT_END)

    def _answer(self, most: int) -> None:
        pending = self._pending
        for _ in range(most):
            end = pending.find(b"\n", 0, _LINE + 1)
            if self._quit or end < 0:
                break
            line = pending[:end].decode("utf-8", "replace").strip()
            del pending[: end + 1]
            reply = self.reply(line)
            self._say(reply)
            if reply == _BYE:
                self._quit = True
                self._peer.close()

    def _check_length(self) -> None:
        if len(self._pending) > _LINE and self._pending.find(b"\n", 0, _LINE + 1) < 0:
            raise PeerError(f"sent a command of over {_LINE} bytes")

    def reply(self, line: str) -> str:
        """Carry out one command and say what the dashboard answers."""
        words = line.split(None, _WORDS)
        for count in range(min(len(words), _WORDS), 0, -1):
            name = " ".join(words[:count]).lower()
            rest = line.split(None, count)[count] if len(words) > count else ""
            known = name in self._with_text or (name in self._plain and not rest)
            if known:
                if name in _REMOTE_ONLY and not self._box.remote_control:
                    return _LOCAL
                return self._with_text[name](rest) if name in self._with_text else self._plain[name]()
        return f"could not understand: '{line[:_ECHO]}'"

    def _say(self, text: str) -> None:
        self._peer.send(text.encode("utf-8", "replace") + b"\n")

    def _done(self, reply: str, act: Callable[[], None]) -> str:
        act()
        return reply

    def _tried(self, command: str, reply: str, succeeded: bool) -> str:
        return reply if succeeded else f"Failed to execute: {command}"

    def _lacks(self, command: str, what: str) -> str:
        self._box.log(f"dashboard {self._peer.name}: the simulated box has no {what}: {command[:_ECHO]!r} is refused")
        return f"Failed to execute: {command[:_ECHO]}"

    def _running(self) -> str:
        running = self._box.runtime_state not in (RuntimeState.STOPPED, RuntimeState.PAUSED)
        return f"Program running: {'true' if running else 'false'}"

    def _program(self) -> str:
        loaded = self._box.loaded_program
        return PurePosixPath(loaded).name if loaded else self._box.program_name or _NO_NAME

    def _loaded(self) -> str:
        loaded = self._box.loaded_program
        return f"Loaded program: {loaded}" if loaded else "No program loaded"

    def _saved(self) -> str:
        loaded = self._box.loaded_program
        return f"true {PurePosixPath(loaded).name}" if loaded else f"false {_NO_NAME}"

    def _load(self, name: str) -> str:
        result = self._box.load_program(name).name if name else "NOT_FOUND"
        return f"{_LOAD[result]}: {name}"

    def _unlock(self) -> str:
        return "Protective stop releasing" if self._box.unlock_protective_stop() else _TOO_EARLY

    def _add_to_log(self, text: str) -> str:
        if not text:
            return "No log message to add"
        self._box.add_to_log(text)
        return "Added log message"

    def _set_operational_mode(self, mode: str) -> str:
        if mode.upper() not in ("MANUAL", "AUTOMATIC"):
            return f"Failed setting operational mode: '{mode[:_ECHO]}'"
        self._box.set_operational_mode(mode.upper())
        return f"Operational mode '{mode}' is set"

    def _clear_operational_mode(self) -> str:
        self._box.clear_operational_mode()
        return f"No longer controlling the operational mode. Current operational mode: '{self._box.operational_mode}'."


_REMOTE_ONLY = frozenset(
    {
        "load",
        "load installation",
        "play",
        "stop",
        "pause",
        "shutdown",
        "power on",
        "power off",
        "brake release",
        "unlock protective stop",
        "restart safety",
    }
)
