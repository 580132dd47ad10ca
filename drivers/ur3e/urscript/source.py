"""Text to tokens that know their place: comments gone, and line ends only where a statement can end.

A line goes on inside brackets and after an operator, a comma or a colon. Statements need no line end between them, so
line ends matter in few places: after a `return`, and before a `(`, `[` or `-` that begins a line.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

from drivers.ur3e.urscript.errors import ScriptError

LONGEST_SOURCE = 1_000_000  # [characters]
DEEPEST_BRACKETS = 64

KEYWORDS = frozenset(
    {
        "and",
        "break",
        "continue",
        "def",
        "elif",
        "else",
        "end",
        "enter_critical",
        "exit_critical",
        "global",
        "halt",
        "if",
        "join",
        "kill",
        "local",
        "not",
        "or",
        "pass",
        "pause",
        "return",
        "run",
        "sec",
        "thread",
        "while",
        "xor",
        "True",
        "False",
        "None",
    }
)
_PUNCTUATION = {
    "==": "EQ",
    "!=": "NE",
    "<=": "LE",
    ">=": "GE",
    "<": "LT",
    ">": "GT",
    "=": "_ASSIGN",
    "+": "PLUS",
    "-": "MINUS",
    "*": "STAR",
    "/": "SLASH",
    "%": "PERCENT",
    "(": "_LPAR",
    ")": "_RPAR",
    "[": "LSQB",
    "]": "_RSQB",
    ",": "_COMMA",
    ":": "_COLON",
    ".": "_DOT",
}
_OPENING, _CLOSING = frozenset("(["), frozenset(")]")
_GOES_ON = (frozenset(_PUNCTUATION) - _CLOSING) | {"and", "or", "xor", "not"}
_AFTER_EMPTY_RETURN = frozenset({"_NEWLINE", "_END", "_ELSE", "ELIF"})
_SILENT = frozenset({"ELSE", "END"})  # keywords whose place nobody asks for
_TOKEN = re.compile(
    r"""
      (?P<blank>[ \t\r\f\v\ufeff]+|\#[^\n]*)
    | (?P<newline>\n)
    | (?P<name>[A-Za-z_][A-Za-z0-9_]*)
    | (?P<number>0[xX][0-9a-fA-F]+|(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)
    | (?P<string>"[^"\n]*"|'[^'\n]*')
    | (?P<punctuation>==|!=|<=|>=|[-+*/%<>=()\[\],:.])
    """,
    re.VERBOSE,
)


@dataclass(frozen=True)
class Word:
    """One token: what it is for the grammar, its text, and where it stands, both from 1."""

    kind: str
    text: str
    line: int
    column: int


def words(text: str) -> list[Word]:
    """All tokens of a script. Raises ScriptError at the first character that belongs to none."""
    if len(text) > LONGEST_SOURCE:
        raise ScriptError(1, 1, f"a script of {len(text)} characters; the limit is {LONGEST_SOURCE}")
    found = list(_scan(text))
    for index, word in enumerate(found):
        following = found[index + 1].kind if index + 1 < len(found) else "_END"
        if word.kind == "RETURN" and following in _AFTER_EMPTY_RETURN:
            found[index] = Word("RETURN_NOTHING", word.text, word.line, word.column)
    return found


def _scan(text: str) -> Iterator[Word]:
    line, line_start, at, depth = 1, 0, 0, 0
    previous = "\n"
    while at < len(text):
        match = _TOKEN.match(text, at)
        column = at - line_start + 1
        if match is None:
            raise ScriptError(line, column, _not_a_token(text[at]))
        kind, piece, at = match.lastgroup, match[0], match.end()
        if kind == "blank":
            continue
        if kind == "newline":
            if depth == 0 and previous not in _GOES_ON and previous != "\n":
                yield Word("_NEWLINE", "\n", line, column)
                previous = "\n"
            line, line_start = line + 1, at
            continue
        previous = piece
        if kind == "name":
            kind = _keyword(piece) if piece in KEYWORDS else "NAME"
        elif kind == "punctuation":
            kind = _PUNCTUATION[piece]
            depth = max(0, depth + (piece in _OPENING) - (piece in _CLOSING))
            if depth > DEEPEST_BRACKETS:
                raise ScriptError(line, column, f"more than {DEEPEST_BRACKETS} brackets inside each other")
        yield Word("NUMBER" if kind == "number" else "STRING" if kind == "string" else str(kind), piece, line, column)


def _keyword(piece: str) -> str:
    kind = piece.upper()
    return f"_{kind}" if kind in _SILENT else kind


def _not_a_token(character: str) -> str:
    if character in "\"'":
        return f"this string has no closing {character} on its line"
    return f"unexpected character {character!r}"
