"""Small cells for tests, and ways to run them as a user would."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import uuid
from dataclasses import dataclass, field
from pathlib import Path

from conftest import unused_port

from runtime.config import shipped

MARK = "PALPATE_TEST_MARK"


def cell_text(component: str = "igbt", holes: int = 2, extra: str = "", **replacements: str) -> str:
    """A shipped cell with its first few holes; `replacements` give keys new values, as TOML writes them."""
    text = shipped()[component].read_text()
    lines = text.splitlines()
    listed = [index for index, line in enumerate(lines) if line.strip().startswith("{ name")]
    for index in reversed(listed[holes:]):
        del lines[index]
    text = "\n".join(lines) + "\n"
    if holes < 7:
        replacements.setdefault("abnormal_hole", "0")
    for key, value in replacements.items():
        text, count = re.subn(rf"^{key} = .*$", f"{key} = {value}", text, flags=re.M)
        assert count == 1, key
    return text + extra


def write_cell(folder: Path, text: str) -> Path:
    path = folder / "small.toml"
    path.write_text(text)
    return path


@dataclass
class Palpate:
    """The command line in a folder of its own; every process it starts carries a mark."""

    folder: Path
    port: int = field(default_factory=unused_port)
    mark: str = field(default_factory=lambda: uuid.uuid4().hex)

    def start(self, *arguments: str | Path, stdin: int = subprocess.DEVNULL) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, "-m", "runtime.cli", *map(str, arguments)],
            stdin=stdin,
            cwd=self.folder,
            env={**os.environ, MARK: self.mark, "COLUMNS": "200"},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def run(self, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
        process = self.start(*arguments)
        out, err = process.communicate(timeout=240)
        return subprocess.CompletedProcess(process.args, process.returncode, out, err)

    def launch(self, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
        return self.run("launch", *arguments, "--port", str(self.port))

    def processes(self) -> dict[int, str]:
        """Processes that carry the mark, with their command lines."""
        found = {}
        for entry in Path("/proc").iterdir():
            if entry.name.isdigit():
                try:
                    if f"{MARK}={self.mark}".encode() in (entry / "environ").read_bytes():
                        found[int(entry.name)] = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode()
                except OSError:  # ended meanwhile, or not ours
                    continue
        return found

    def logs(self) -> list[Path]:
        return sorted((self.folder / "logs").glob("*.mcap"))
