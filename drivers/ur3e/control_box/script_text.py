"""Cuts the text that arrives at a script port into programs, however it was split on the way."""

from __future__ import annotations

import re

from drivers.ur3e.control_box.peer import PeerError

LIMIT = 1 << 20  # [bytes] of a program that is not complete
_TOKEN = re.compile(rb'"[^"\n]*"?|#[^\n]*|\n|(?:def|sec|thread|if|while|end)')
_KEYWORD = 6  # [bytes] of the longest keyword
_WORD = frozenset(b"abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_")
_QUOTE, _HASH, _NEWLINE = b'"#\n'


class ScriptText:
    """Bytes go in as they come, whole programs come out.

    A program ends with the line on which every block that was opened has its `end`; a line without blocks is a program
    of its own. What is in strings and comments opens nothing. Comments before a program belong to it.
    """

    def __init__(self) -> None:
        self._text = bytearray()
        self._begin = 0  # where the program starts that is being looked at
        self._seen = 0  # where looking goes on
        self._line = 0  # where the present line starts
        self._depth = 0  # blocks that are open
        self._code = False  # there is more than comments
        self._inside = 0  # a string or comment that goes on: the byte that opened it

    def add(self, data: bytes) -> None:
        """Take in some bytes. Raises PeerError if too many are waiting."""
        begin = self._begin
        del self._text[:begin]
        self._begin, self._seen, self._line = 0, self._seen - begin, self._line - begin
        self._text += data
        if len(self._text) > LIMIT:
            raise PeerError(f"sent over {LIMIT} bytes of script without an end, or faster than programs can start")

    def take(self) -> str | None:
        """The next whole program, None if there is none yet."""
        text = self._text
        if self._inside:
            self._leave()
        if self._inside:
            return None
        for token in _TOKEN.finditer(text, self._seen):
            start, end = token.span()
            first = text[start]
            if first == _NEWLINE:
                self._seen = end
                if self._ended(start, end):
                    begin, self._begin, self._code = self._begin, end, False
                    return text[begin:end].decode("utf-8", "replace")
            elif end == len(text) and not _closed_string(token.group()):
                if first in (_QUOTE, _HASH):
                    self._inside, self._seen = first, end
                else:
                    self._seen = start  # the word may go on
                return None
            else:
                self._seen = end
                if first not in (_QUOTE, _HASH):
                    self._count(start, end)
        self._seen = max(self._seen, len(text) - _KEYWORD + 1)
        return None

    def _leave(self) -> None:
        """Look for the end of the string or comment that goes on."""
        text = self._text
        newline = text.find(b"\n", self._seen)
        quote = text.find(b'"', self._seen, newline if newline >= 0 else len(text)) if self._inside == _QUOTE else -1
        if quote >= 0:
            self._inside, self._seen = 0, quote + 1
        elif newline >= 0:
            self._inside, self._seen = 0, newline
        else:
            self._seen = len(text)

    def _count(self, start: int, end: int) -> None:
        text = self._text
        if (start > self._line and text[start - 1] in _WORD) or text[end] in _WORD:
            return
        if text[start:end] == b"end":
            self._depth = max(0, self._depth - 1)
        else:
            self._depth += 1

    def _ended(self, start: int, end: int) -> bool:
        """Whether the line that ends with this newline ends a program. An empty line before a program is passed by."""
        line = self._text[self._line : start].strip()
        if line and line[0] != _HASH:
            self._code = True
        if not line and self._begin == self._line:
            self._begin = end
        self._line = end
        return self._code and self._depth == 0


def _closed_string(token: bytes) -> bool:
    return len(token) > 1 and token[0] == token[-1] == _QUOTE
