"""The file that a recording grows in: whole records or nothing, and one owner at a time."""

from __future__ import annotations

import contextlib
import fcntl
from pathlib import Path
from typing import BinaryIO

from runtime.errors import SessionError


class LogOutput:
    """What the mcap package writes to. Everything goes to the operating system at once, so a kill loses none of it.

    Each `write` is a number of whole records. One that fails is taken back, so that the file ends with a whole record.
    While it is open the file is locked (flock), which tells others that it is still being recorded.
    """

    def __init__(self, path: Path) -> None:
        """Make the file. Raises SessionError in one line if it cannot be made or exists."""
        self.path = path
        self.size = 0  # [byte]
        if path.exists():
            raise SessionError(f"{path} exists already; a recording is never overwritten")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("xb", buffering=0)
        except OSError as error:
            raise SessionError(f"{path} cannot be written: {error.strerror or error}") from None
        with contextlib.suppress(OSError):  # a file system without locks
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)

    @property
    def closed(self) -> bool:
        """Whether nothing more can be written."""
        return self._file.closed

    def write(self, data: bytes) -> int:
        """Append whole records. Raises OSError where the disk takes no more; the file is closed then."""
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[self._file.write(rest) :]
        except OSError:
            with contextlib.suppress(OSError):
                self._file.truncate(self.size)
            self.close()
            raise
        self.size += len(data)
        return len(data)

    def tell(self) -> int:
        """Bytes written so far."""
        return self.size

    def flush(self) -> None:
        """Everything has been handed over already."""

    def close(self) -> None:
        """Close and unlock the file. Idempotent."""
        self._file.close()


def being_written(file: BinaryIO) -> bool:
    """Whether a recorder has this open file in hand at the moment."""
    try:
        fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:  # a file system without locks
        return False
    fcntl.flock(file, fcntl.LOCK_UN)
    return False
