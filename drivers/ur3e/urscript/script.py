"""A compiled script, as it passes from the process that compiles to the one that runs it."""

from __future__ import annotations

from dataclasses import dataclass

FILE = "<urscript>"  # the file name of compiled scripts, by which tracebacks know their frames
MAIN = "f0_"  # how the name of the program's own Python function begins
LONGEST_CODE = 2_000_000  # [bytes], so that loading does not hold up a control cycle for long


@dataclass(frozen=True)
class Script:
    """A compiled script."""

    name: str  # of its `def` or `sec`; "" for bare statements
    kind: str  # "def" or "sec"
    code: bytes  # a marshalled code object, for this version of Python
    builtins: tuple[str, ...]  # those it uses, sorted
