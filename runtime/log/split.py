"""A session in several files: how they are named, and what tells a reader that they belong together.

    <session>.mcap, <session>.part2.mcap, <session>.part3.mcap, ...

Each is a whole MCAP file with the session's metadata and attachments. A file that has a successor ends with the
metadata record CONTINUED. Parts from the second on begin with what the latched topics last said, on channels that are
marked as RESTATED.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from runtime.errors import InputError

RESTATED = "palpate.restated"  # in the metadata of channels whose messages an earlier file has too
CONTINUED = "palpate.continued"  # metadata record of a file that another continues: {"file": its name}, account so far
PART = "palpate.part"  # metadata record of parts from the second on: {"part": "2", "first": name of the first file}
MIN_BYTES = 1_000_000
MIN_SECONDS = 1.0
_UNITS = {
    **{unit.lower(): ("bytes", 10 ** (3 * power)) for power, unit in enumerate(("B", "kB", "MB", "GB", "TB"))},
    **{unit.lower(): ("bytes", 2 ** (10 * power)) for power, unit in enumerate(("KiB", "MiB", "GiB", "TiB"), 1)},
    "s": ("seconds", 1),
    "min": ("seconds", 60),
    "h": ("seconds", 3600),
}
_QUANTITY = re.compile(r"\s*(\d+\.?\d*|\.\d+)\s*([a-z]+)\s*", re.IGNORECASE)
_PART = re.compile(r"(?P<stem>.+)\.part(?P<number>[1-9]\d*)\.mcap")


@dataclass(frozen=True)
class Split:
    """When a recording goes on in another file: at a size, or after a stretch of session time."""

    bytes: float | None = None  # of the file as it is on disk
    seconds: float | None = None  # [s] of session time

    def reached(self, size: int, duration: float) -> bool:
        """Whether a file of `size` bytes that spans `duration` [s] is full."""
        return (self.bytes is not None and size >= self.bytes) or (
            self.seconds is not None and duration >= self.seconds
        )


def parse_split(text: str) -> Split:
    """Read `100MB`, `1.5 GiB`, `60s` or `10min`. Raises InputError that says what would do."""
    match = _QUANTITY.fullmatch(text)
    kind, factor = _UNITS.get(match[2].lower(), ("", 0)) if match else ("", 0)
    if match is None or not kind:
        raise InputError(f"--split {text!r} is neither a size such as 100MB or 1.5GiB nor a time such as 60s or 10min")
    amount = float(match[1]) * factor
    if kind == "bytes":
        if amount < MIN_BYTES:
            raise InputError(f"--split {text!r} is too small: files have at least {MIN_BYTES // 10**6} MB")
        return Split(bytes=amount)
    if amount < MIN_SECONDS:
        raise InputError(f"--split {text!r} is too short: files span at least {MIN_SECONDS:g} s of session time")
    return Split(seconds=amount)


def part_path(first: Path, number: int) -> Path:
    """File of a session's part, from 1."""
    return first if number == 1 else first.with_name(f"{first.stem}.part{number}.mcap")


def part_number(path: Path) -> int:
    """Which part a file is by its name; 1 for the first and for a session in one file."""
    match = _PART.fullmatch(path.name)
    return int(match["number"]) if match else 1


def later_parts(first: Path) -> dict[int, Path]:
    """The files that continue a session's first file, by number; none if `first` is itself a later part."""
    if part_number(first) > 1:
        return {}
    found = {
        part_number(path): path
        for path in first.parent.glob("*.part*.mcap")
        if (match := _PART.fullmatch(path.name)) and match["stem"] == first.stem
    }
    return {number: found[number] for number in sorted(found) if number > 1}
