"""What a store knows in brief, so that another can tell what it lacks without seeing it."""

from __future__ import annotations

import json
from bisect import bisect_right
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from operator import attrgetter
from typing import Annotated

from pydantic import Field, TypeAdapter, ValidationError

from runtime.errors import InputError


@dataclass(frozen=True, slots=True)
class Run:
    """Searches of one session with consecutive numbers and the same life."""

    scope: str
    session: str
    first: int
    last: int
    life: int


class Digest:
    """The identities and lives a store knows."""

    def __init__(self, runs: Iterable[Run]) -> None:
        self.runs = tuple(sorted(runs, key=attrgetter("scope", "session", "first")))
        self._firsts: dict[tuple[str, str], list[int]] = defaultdict(list)
        self._runs: dict[tuple[str, str], list[Run]] = defaultdict(list)
        for run in self.runs:
            self._firsts[run.scope, run.session].append(run.first)
            self._runs[run.scope, run.session].append(run)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Digest) and self.runs == other.runs

    def __hash__(self) -> int:
        return hash(self.runs)

    def life(self, scope: str, session: str, search: int) -> int:
        """Life of a piece of evidence there; 0 if it is not known."""
        position = bisect_right(self._firsts.get((scope, session), ()), search)
        if position == 0:
            return 0
        run = self._runs[scope, session][position - 1]
        return run.life if search <= run.last else 0

    def text(self) -> str:
        """JSON: [[scope, session, first, last, life], ...]; equal stores give equal text."""
        return json.dumps(
            [(run.scope, run.session, run.first, run.last, run.life) for run in self.runs], separators=(",", ":")
        )


_Number = Annotated[int, Field(ge=1)]
_RUNS = TypeAdapter(list[tuple[str, str, _Number, _Number, _Number]])


def digest_from(text: str | bytes) -> Digest:
    """Digest from its text. InputError if it is none."""
    try:
        rows = _RUNS.validate_json(text, strict=True)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(str(part) for part in first["loc"])
        raise InputError(f"no digest of a posterior store: {f'{place}: ' if place else ''}{first['msg']}") from None
    return Digest(Run(*row) for row in rows)
