"""The PolyScope version a control box reports; clients choose their dialect by it."""

from __future__ import annotations

import re
from dataclasses import dataclass

from runtime.errors import InputError

OLDEST, NEWEST = (5, 10), (5, 26)
_BUILD = 1101319


@dataclass(frozen=True, order=True)
class PolyScope:
    """Version of an e-Series controller's software."""

    major: int = 5
    minor: int = 22
    bugfix: int = 0
    build: int = _BUILD

    def __str__(self) -> str:
        return f"{self.major}.{self.minor}.{self.bugfix}.{self.build}"


def polyscope(text: str) -> PolyScope:
    """The version written as `5.22` or `5.22.1`. Raises InputError for one that is not simulated."""
    match = re.fullmatch(r"(\d{1,2})\.(\d{1,2})(?:\.(\d{1,3}))?", text)
    if match is None or not OLDEST <= (int(match[1]), int(match[2])) <= NEWEST:
        raise InputError(
            f"no PolyScope {text!r} can be reported; write a version from "
            f"{OLDEST[0]}.{OLDEST[1]} to {NEWEST[0]}.{NEWEST[1]}, such as 5.22"
        )
    return PolyScope(int(match[1]), int(match[2]), int(match[3] or 0))
