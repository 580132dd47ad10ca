"""What a control box has to tell its primary clients: collected during a cycle, sent after it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

from drivers.ur3e.control_box.modes import SafetyMode

PopupKind = Literal["message", "warning", "error"]


@dataclass(frozen=True)
class ProgramStarted:
    """A program has begun."""

    name: str


@dataclass(frozen=True)
class ProgramStopped:
    """A program has ended, whatever ended it."""

    name: str


@dataclass(frozen=True)
class RuntimeException:
    """A program did what it must not, and is over."""

    line: int  # from 1, in the text that was sent
    column: int  # from 1; 1 if unknown
    text: str


@dataclass(frozen=True)
class CompileError:
    """A program was sent that is no URScript; it did not begin."""

    line: int
    column: int
    text: str


@dataclass(frozen=True)
class SafetyModeChanged:
    """A stop has begun or ended."""

    mode: SafetyMode
    text: str


@dataclass(frozen=True)
class TextMessage:
    """A program's `textmsg`."""

    text: str


@dataclass(frozen=True)
class ErrorCode:
    """One of the controller's C-numbered reports, such as C204A2: code 204, argument 2."""

    code: int
    argument: int
    text: str
    warning: bool = False  # rather than a violation


@dataclass(frozen=True)
class Popup:
    """A window on the teach pendant; a program that shows a blocking one waits until it is closed."""

    title: str
    text: str
    kind: PopupKind = "message"
    blocking: bool = False


Event: TypeAlias = (
    ProgramStarted
    | ProgramStopped
    | RuntimeException
    | CompileError
    | SafetyModeChanged
    | TextMessage
    | ErrorCode
    | Popup
)
