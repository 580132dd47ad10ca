"""What can be wrong with a script, and what a builtin says when it cannot do what it was asked."""

from __future__ import annotations

from runtime.errors import PalpateError


class ScriptError(PalpateError):
    """A script that is no URScript, or that did what it must not; says where."""

    def __init__(self, line: int, column: int, text: str) -> None:
        super().__init__(line, column, text)
        self.line = line  # from 1, in the text as it was sent; 1 if unknown
        self.column = column  # from 1; 1 if unknown
        self.text = text

    def __str__(self) -> str:
        return f"line {self.line}, column {self.column}: {self.text}"


class BuiltinError(PalpateError):
    """A builtin or an operator was given what it cannot work with. The program adds where."""


class Halt(BaseException):
    """Ends the whole program in good order: the `halt` statement, or a builtin that must end it.

    No error, so that nothing that handles errors on the way takes it for one.
    """
