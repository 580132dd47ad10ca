"""Evidence about holes as values: how one search ended, with every attempt; and as text, for files and cells.

A piece of evidence is known by (scope, session, search), wherever it is kept. Its content never changes. Whether it
counts may change: each time it is forgotten or recalled its `life` goes up by one, so that of two copies the one with
the longer life is the later word, in whatever order they meet.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import cache
from typing import Annotated, Any, ClassVar, TypeVar

from pydantic import (
    AfterValidator,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainSerializer,
    TypeAdapter,
    ValidationError,
)

from runtime.errors import InputError
from runtime.messages import Attempt, Ending, Miss, Outcome, SearchResult, Seat, Waypoint, slid_in

LATEST = 7_258_118_400 * 10**9  # [ns] the year 2200: a later time of recording is a mistake
_Enum = TypeVar("_Enum", bound=IntEnum)


def _named(kind: type[_Enum]) -> tuple[BeforeValidator, PlainSerializer]:
    names = {member.name.lower(): member for member in kind}

    def member(value: object) -> object:
        if isinstance(value, kind):
            return value
        if not isinstance(value, str) or value not in names:
            raise ValueError(f"should be {', '.join(names)}")
        return names[value]

    return BeforeValidator(member), PlainSerializer(lambda value: value.name.lower(), return_type=str)


def _rising(tried: tuple[Tried, ...]) -> tuple[Tried, ...]:
    numbers = [item.number for item in tried]
    if numbers != sorted(set(numbers)):
        raise ValueError("attempts should be numbered in order, each once")
    return tried


Name = Annotated[str, Field(min_length=1, max_length=200)]
Number = Annotated[int, Field(ge=1, lt=2**32)]
Life = Annotated[int, Field(ge=1, le=10_000)]
EndingByName = Annotated[Ending, *_named(Ending)]
OutcomeByName = Annotated[Outcome, *_named(Outcome)]


@dataclass(frozen=True, slots=True)
class Tried:
    """One attempt of a search: failures are evidence too."""

    number: Number  # within the search, from 1
    x: float | None  # [m] commanded offset from nominal; None: not known
    y: float | None  # [m]
    outcome: OutcomeByName
    path: tuple[tuple[float, float], ...] = ()  # [m] slid along; none: a peck

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(extra="forbid", allow_inf_nan=False)


@dataclass(frozen=True, slots=True)
class Evidence:
    """How one search ended, and all its attempts."""

    scope: Name  # the world it was gathered in: "real", "simulated-0c4968fc08e3"
    session: Name  # unlike that of any other session of any cell
    search: Number  # within the session, from 1
    recorded_at: Annotated[int, Field(ge=0, le=LATEST)]  # [ns] since 1970; evidence is ordered by it
    board_type: Name
    component: Name
    board: Number  # within the session, from 1
    hole: Name
    ending: EndingByName
    x: float | None  # [m] candidate that succeeded, offset from nominal; None: none did
    y: float | None  # [m]
    seated_x: float | None  # [m] where the robot read the seated part to be; None: not known
    seated_y: float | None  # [m]
    slid: bool  # whether the pins dropped in on the way of a slide
    tried: Annotated[tuple[Tried, ...], AfterValidator(_rising)]
    life: Life = 1  # odd: it counts; even: forgotten

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(extra="forbid", allow_inf_nan=False)

    @property
    def forgotten(self) -> bool:
        """Whether it is kept, but counts no more."""
        return self.life % 2 == 0

    @property
    def identity(self) -> tuple[str, str, int]:
        """Scope, session and search."""
        return self.scope, self.session, self.search

    @property
    def checksum(self) -> int:
        """CRC-32 of the content, without `life`."""
        content = (
            self.identity,
            self.recorded_at,
            (self.board_type, self.component, self.board, self.hole, int(self.ending), self.slid),
            [_positive_zero(value) for value in (self.x, self.y, self.seated_x, self.seated_y)],
            [
                (
                    item.number,
                    _positive_zero(item.x),
                    _positive_zero(item.y),
                    int(item.outcome),
                    [(x + 0.0, y + 0.0) for x, y in item.path],
                )
                for item in self.tried
            ],
        )
        return zlib.crc32(repr(content).encode())


def evidence_of(
    board_type: str, result: SearchResult, session: str, attempts: Sequence[Attempt], *, scope: str, recorded_at: int
) -> Evidence:
    """What a search says, recorded at `recorded_at` [ns]. InputError if an attempt belongs to another search."""
    strangers = sorted({attempt.search for attempt in attempts if attempt.search != result.search})
    if strangers:
        raise InputError(f"search {result.search} cannot store attempts of search {strangers[0]}")
    return Evidence(
        scope=scope,
        session=session,
        search=result.search,
        recorded_at=recorded_at,
        board_type=board_type,
        component=result.component,
        board=result.board,
        hole=result.hole,
        ending=Ending(result.ending),
        x=_known(result.x),
        y=_known(result.y),
        seated_x=_known(result.seated_x),
        seated_y=_known(result.seated_y),
        slid=any(slid_in(attempt) for attempt in attempts),
        tried=tuple(
            Tried(
                item.number,
                _known(item.x),
                _known(item.y),
                Outcome(item.outcome),
                tuple((point.x, point.y) for point in item.path),
            )
            for item in sorted(attempts, key=lambda item: item.number)
        ),
    )


def seats_of(evidence: Evidence, board: int) -> list[Seat]:
    """Where the part went in, if it did, in a board of this number."""
    if evidence.ending != Ending.INSERTED:
        return []
    x, y, seated_x, seated_y = map(_number, (evidence.x, evidence.y, evidence.seated_x, evidence.seated_y))
    return [Seat(evidence.session, board, evidence.hole, x, y, seated_x, seated_y, evidence.slid)]


def misses_of(evidence: Evidence, board: int) -> list[Miss]:
    """The attempts that were blocked, in a board of this number."""
    return [
        Miss(board, evidence.hole, [Waypoint(*point) for point in item.path or ((_number(item.x), _number(item.y)),)])
        for item in evidence.tried
        if item.outcome == Outcome.BLOCKED
    ]


def text_of(evidence: Evidence) -> str:
    """One line of JSON; `evidence_from` gives back an equal value."""
    return _adapter().dump_json(evidence).decode()


def evidence_from(text: str | bytes, where: str) -> Evidence:
    """Evidence from JSON. InputError in one line that names `where` and the field, if the text is none."""
    try:
        return _adapter().validate_json(text, strict=True)
    except ValidationError as error:
        first, *others = error.errors(include_url=False)
        place = ".".join(str(part) for part in first["loc"])
        said = first["msg"].removeprefix("Value error, ").removeprefix("Input ")
        said = {
            "unexpected_keyword_argument": "unknown field",
            "missing": "is missing",
            "dataclass_type": "should be a JSON object with the fields of one search",
        }.get(first["type"], said)
        got = "" if first["type"] in ("missing", "json_invalid", "unexpected_keyword_argument") else _got(first)
        more = f" (and {len(others)} more)" if others else ""
        raise InputError(f"{where}: {f'{place}: ' if place else ''}{said}{got}{more}") from None


@cache
def _adapter() -> TypeAdapter[Evidence]:
    return TypeAdapter(Evidence)


def _got(error: Any) -> str:
    text = repr(error["input"])
    return f" (got {text if len(text) <= 60 else text[:57] + '...'})"


def _known(value: float) -> float | None:
    return value + 0.0 if math.isfinite(value) else None  # SQLite and JSON have no "not a number"


def _positive_zero(value: float | None) -> float | None:
    return None if value is None else value + 0.0  # SQLite keeps no negative zero


def _number(value: float | None) -> float:
    return math.nan if value is None else value
