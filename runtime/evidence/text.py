"""Evidence in files that people and other programs read: JSON, JSON lines, and a CSV table of attempts to look at."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime

from runtime.errors import InputError
from runtime.evidence.evidence import Evidence, evidence_from, text_of
from runtime.messages import NANOSECONDS

_COLUMNS = (
    "scope,session,search,recorded_at,board_type,component,board,hole,ending,x_m,y_m,seated_x_m,seated_y_m,slid,"
    "forgotten,attempt,outcome,attempt_x_m,attempt_y_m,path_m"
)


def as_lines(evidence: Sequence[Evidence]) -> str:
    """One JSON object a line."""
    return "".join(f"{text_of(item)}\n" for item in evidence)


def as_json(evidence: Sequence[Evidence]) -> str:
    """One JSON array, an object a line."""
    return "[\n" + ",\n".join(map(text_of, evidence)) + "\n]\n"


def as_csv(evidence: Sequence[Evidence]) -> str:
    """A table with a row for each attempt, or one for a search without any. Lengths in metres, times in UTC."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(_COLUMNS.split(","))
    for item in evidence:
        search = [
            *item.identity,
            datetime.fromtimestamp(item.recorded_at / NANOSECONDS, UTC).isoformat(timespec="milliseconds"),
            item.board_type,
            item.component,
            item.board,
            item.hole,
            item.ending.name.lower(),
            *(item.x, item.y, item.seated_x, item.seated_y),
            int(item.slid),
            int(item.forgotten),
        ]
        for tried in item.tried:
            path = json.dumps(tried.path) if tried.path else None
            table.writerow([*search, tried.number, tried.outcome.name.lower(), tried.x, tried.y, path])
        if not item.tried:
            table.writerow([*search, *[None] * 5])
    return text.getvalue()


def read_text(text: str, name: str) -> list[Evidence]:
    """Evidence from JSON or JSON lines of the file `name`. InputError names the first line, or entry, and its field."""
    found: dict[tuple[str, str, int], tuple[str, Evidence]] = {}
    for place, item in _pieces(text, name):
        evidence = evidence_from(item, f"{name}: {place}")
        if evidence.identity in found:
            earlier, other = found[evidence.identity]
            if other != evidence:
                raise InputError(
                    f"{name}: {place}: search {evidence.search} of session {evidence.session} stands in {earlier} with"
                    " other content"
                )
        found[evidence.identity] = place, evidence
    if not found:
        raise InputError(f"{name}: holds no evidence")
    return [evidence for _, evidence in found.values()]


def _pieces(text: str, name: str) -> Iterator[tuple[str, str]]:
    if not text.lstrip().startswith("["):
        for number, line in enumerate(text.split("\n"), start=1):
            if line.strip():
                yield f"line {number}", line
        return
    try:
        items = json.loads(text)
    except (json.JSONDecodeError, RecursionError) as error:
        place = f"line {error.lineno}: {error.msg}" if isinstance(error, json.JSONDecodeError) else "nested too deep"
        raise InputError(f"{name}: {place}") from None
    for number, item in enumerate(items, start=1):
        yield f"entry {number}", json.dumps(item)
