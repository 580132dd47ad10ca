"""The command line within the test's own process: for the many small runs that need no process of their own."""

from __future__ import annotations

import contextlib
import io
import os
import signal
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from subprocess import CompletedProcess

from runtime.cli import main


@dataclass(frozen=True)
class CommandLine:
    """`palpate` as if it were typed in a folder, with its output piped."""

    folder: Path

    def run(self, *arguments: str | Path) -> CompletedProcess[str]:
        given = [str(argument) for argument in arguments]
        out, err = io.StringIO(), io.StringIO()
        with (
            contextlib.chdir(self.folder),
            _surroundings(),
            contextlib.redirect_stdout(out),
            contextlib.redirect_stderr(err),
        ):
            code = main(given)
        return CompletedProcess(given, code, out.getvalue(), err.getvalue())


@contextlib.contextmanager
def _surroundings() -> Iterator[None]:
    """Wide lines; what a command changes in its process is as before afterwards."""
    columns, handler = os.environ.get("COLUMNS"), signal.getsignal(signal.SIGTERM)
    os.environ["COLUMNS"] = "200"
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, handler)
        os.environ.pop("COLUMNS")
        if columns is not None:
            os.environ["COLUMNS"] = columns
