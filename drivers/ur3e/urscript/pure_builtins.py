"""All builtins that need no robot."""

from __future__ import annotations

from drivers.ur3e.urscript.builtin import Builtin
from drivers.ur3e.urscript.lists import lists
from drivers.ur3e.urscript.maths import maths
from drivers.ur3e.urscript.poses import poses
from drivers.ur3e.urscript.strings import strings


def pure_builtins(seed: int) -> dict[str, Builtin]:
    """The builtins by name; `random` gives the same numbers for the same seed."""
    return maths(seed) | strings() | lists() | poses()
