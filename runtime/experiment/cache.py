"""Results kept by content: a compressed JSON file for each piece of work, under a key that names all it depends on."""

from __future__ import annotations

import gzip
import hashlib
import json
import os
import tempfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, get_type_hints

from pydantic import TypeAdapter, ValidationError
from pydantic_core import to_json

from runtime.errors import InputError
from runtime.experiment.source import digest
from runtime.experiment.study import Result, Work

FORMAT = 1  # of the files


def default_folder() -> Path:
    """`palpate` in the user's cache directory (XDG Base Directory Specification)."""
    home = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(home) if Path(home).is_absolute() else Path.home() / ".cache") / "palpate"


def key_of(work: Work[Any]) -> str:
    """Digest of everything the result of a piece of work depends on, its code included."""
    content = {
        "format": FORMAT,
        "kind": f"{type(work).__module__}.{type(work).__qualname__}",
        "content": work.content,
        "code": digest((type(work).__module__, *work.code)),
    }
    return hashlib.sha256(to_json(content, inf_nan_mode="constants")).hexdigest()


@dataclass(frozen=True)
class Cache:
    """A folder of results."""

    folder: Path

    def prepare(self) -> None:
        """Raise InputError unless results can be kept there."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=self.folder):
                pass
        except OSError as error:
            raise InputError(f"results cannot be kept in {self.folder}: {error.strerror}; choose --cache DIR") from None

    def load(self, work: Work[Result], key: str) -> Result | None:
        """The result under `key`; None if there is none, or one that cannot be read."""
        try:
            stored: Mapping[str, Any] = json.loads(gzip.decompress(self._path(key).read_bytes()))
            if stored["key"] != key:
                return None
            result: Result = _adapter(type(work)).validate_python(stored["result"])
        except (OSError, EOFError, zlib.error, ValueError, KeyError, TypeError, ValidationError):
            return None
        return result

    def store(self, work: Work[Result], key: str, result: Result) -> None:
        """Keep a result; whoever looks sees all of it or nothing."""
        text = json.dumps({"key": key, "result": _adapter(type(work)).dump_python(result)})
        path = self._path(key)
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, suffix=".part")
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(gzip.compress(text.encode(), 5, mtime=0))
            Path(name).replace(path)
        except BaseException:
            Path(name).unlink(missing_ok=True)
            raise

    def _path(self, key: str) -> Path:
        return self.folder / key[:2] / f"{key}.json.gz"


@cache
def _adapter(kind: type[Work[Any]]) -> TypeAdapter[Any]:
    """How the results of this kind of work become plain values and back: after `run`'s return annotation."""
    return TypeAdapter(get_type_hints(kind.run)["return"])
