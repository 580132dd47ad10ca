"""The errors a user of palpate can meet: what was wrong, where, and what exists instead.

PalpateError
├── InputError     the user gave something that cannot work; the command line exits with 2
│   ├── CellError      a cell file
│   ├── PluginError    a plugin or strategy that is not installed
│   └── LogError       a recorded log that cannot be read
└── SessionError   a session failed while it ran; the command line exits with 1
    ├── BusError       a message or request did not arrive
    └── ArmError       the arm cannot do what was asked
"""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches


class PalpateError(Exception):
    """Any error that palpate explains in one line."""


class InputError(PalpateError):
    """The user's input cannot work."""


class CellError(InputError):
    """A cell file is wrong."""


class PluginError(InputError):
    """A plugin is not installed or is not what it says."""


class LogError(InputError):
    """A log cannot be read."""


class SessionError(PalpateError):
    """A session failed while it ran."""


class BusError(SessionError):
    """A message or a request did not arrive."""


class ArmError(SessionError):
    """The arm cannot do what was asked of it."""


def alternatives(wrong: str, known: Iterable[str]) -> str:
    """Say what exists instead of `wrong`: the likeliest name first, then all of them."""
    names = sorted(known)
    close = get_close_matches(wrong, names, n=1)
    hint = f"did you mean {close[0]!r}? " if close else ""
    return f"{hint}known: {', '.join(names)}" if names else "none is known"
