"""URScript's grammar, and the parser that turns a script into its syntax tree without recursion."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cache
from typing import Any, cast

from lark import Lark, Token, Transformer
from lark.exceptions import UnexpectedToken
from lark.lexer import Lexer, LexerState

from drivers.ur3e.urscript.errors import ScriptError
from drivers.ur3e.urscript.source import KEYWORDS, Word, words
from drivers.ur3e.urscript.syntax import (
    Assignment,
    Binary,
    Block,
    Call,
    Constant,
    Effect,
    Expression,
    Function,
    If,
    Index,
    Keyword,
    ListOf,
    Member,
    Name,
    Parameter,
    Return,
    Run,
    Statement,
    ThreadControl,
    Unary,
    While,
)

_GRAMMAR = r"""
start: block
block: (_statement | _NEWLINE)*
_statement: assignment | global_assignment | local_assignment | effect | if_statement | while_statement
    | return_statement | keyword | thread_control | function

assignment: place _ASSIGN _expression
global_assignment: GLOBAL name _ASSIGN _expression
local_assignment: LOCAL name _ASSIGN _expression
?place: name | place LSQB keys _RSQB -> index | place _DOT NAME -> member
effect: call | run
if_statement: IF _expression _COLON block (ELIF _expression _COLON block)* [_ELSE _COLON block] _END
while_statement: WHILE _expression _COLON block _END
return_statement: RETURN _expression | RETURN_NOTHING
keyword: BREAK | CONTINUE | PASS | HALT | PAUSE | (ENTER_CRITICAL | EXIT_CRITICAL) [_LPAR _RPAR]
thread_control: (KILL | JOIN) _expression
function: (DEF | THREAD | SEC) NAME _LPAR [parameter (_COMMA parameter)*] _RPAR _COLON block _END
parameter: NAME [_ASSIGN _expression]

_expression: disjunction
?disjunction: exclusion | disjunction OR exclusion -> binary
?exclusion: conjunction | exclusion XOR conjunction -> binary
?conjunction: negation | conjunction AND negation -> binary
?negation: comparison | NOT negation -> unary
?comparison: sum | comparison (EQ | NE | LT | LE | GT | GE) sum -> binary
?sum: product | sum (PLUS | MINUS) product -> binary
?product: signed | product (STAR | SLASH | PERCENT) signed -> binary
?signed: postfix | (MINUS | PLUS) signed -> unary
?postfix: atom | postfix LSQB keys _RSQB -> index | postfix _DOT NAME -> member
?atom: name | number | string | word | call | run | array | _LPAR disjunction _RPAR
name: NAME
number: NUMBER
string: STRING
word: TRUE | FALSE | NONE
array: LSQB [_expression (_COMMA _expression)*] _RSQB
keys: _expression (_COMMA _expression)*
call: NAME _LPAR [_argument (_COMMA _argument)*] _RPAR
_argument: _expression | keyword_argument
keyword_argument: NAME _ASSIGN _expression
run: RUN call

%declare NAME NUMBER STRING TRUE FALSE NONE _NEWLINE _ASSIGN _LPAR _RPAR LSQB _RSQB _COMMA _COLON _DOT
%declare EQ NE LT LE GT GE PLUS MINUS STAR SLASH PERCENT AND OR XOR NOT
%declare GLOBAL LOCAL IF ELIF _ELSE _END WHILE RETURN RETURN_NOTHING BREAK CONTINUE PASS HALT PAUSE
%declare ENTER_CRITICAL EXIT_CRITICAL KILL JOIN DEF THREAD SEC RUN
"""
_FOREIGN = {
    "for": "URScript has no `for`; write a `while`",
    "switch": "`switch` is not simulated; write `if` and `elif`",
    "case": "`switch` is not simulated; write `if` and `elif`",
    "elseif": "write `elif`",
}
_TRUTHS = {"True": True, "False": False, "None": None}
_LARGEST_INTEGER = 2**31 - 1


class _Words(Lexer):
    """Hands lark the tokens that were found."""

    __future_interface__ = 1

    def __init__(self, lexer_conf: Any) -> None:
        pass

    def lex(self, lexer_state: LexerState, parser_state: Any) -> Iterator[Token]:  # noqa: ARG002
        for word in cast("list[Word]", lexer_state.text):
            yield Token(word.kind, word.text, None, word.line, word.column)


class _Builder(Transformer[Token, Any]):
    """Syntax nodes of what the parser has recognised, one rule at a time."""

    def start(self, children: list[Any]) -> Block:
        return cast("Block", children[0])

    def block(self, children: list[Statement]) -> Block:
        return tuple(children)

    def assignment(self, children: list[Any]) -> Assignment:
        place, value = children
        return Assignment(place.line, place.column, place, value, "")

    def global_assignment(self, children: list[Any]) -> Assignment:
        return Assignment(children[0].line, children[0].column, children[1], children[2], "global")

    def local_assignment(self, children: list[Any]) -> Assignment:
        return Assignment(children[0].line, children[0].column, children[1], children[2], "local")

    def effect(self, children: list[Any]) -> Effect:
        return Effect(children[0].line, children[0].column, children[0])

    def if_statement(self, children: list[Any]) -> If:
        branches = [(children[i + 1], children[i + 2]) for i in range(0, len(children) - 2, 3)]
        otherwise = children[-1] if len(children) % 3 else ()
        return If(children[0].line, children[0].column, tuple(branches), otherwise)

    def while_statement(self, children: list[Any]) -> While:
        return While(children[0].line, children[0].column, children[1], children[2])

    def return_statement(self, children: list[Any]) -> Return:
        return Return(children[0].line, children[0].column, children[1] if len(children) > 1 else None)

    def keyword(self, children: list[Any]) -> Keyword:
        return Keyword(children[0].line, children[0].column, str(children[0]))

    def thread_control(self, children: list[Any]) -> ThreadControl:
        return ThreadControl(children[0].line, children[0].column, str(children[0]), children[1])

    def function(self, children: list[Any]) -> Function:
        kind, name, *parameters, body = children
        return Function(kind.line, kind.column, str(kind), str(name), tuple(parameters), body)

    def parameter(self, children: list[Any]) -> Parameter:
        default = children[1] if len(children) > 1 else None
        return Parameter(children[0].line, children[0].column, str(children[0]), default)

    def binary(self, children: list[Any]) -> Binary:
        left, operator, right = children
        return Binary(operator.line, operator.column, str(operator), left, right)

    def unary(self, children: list[Any]) -> Unary:
        return Unary(children[0].line, children[0].column, str(children[0]), children[1])

    def index(self, children: list[Any]) -> Index:
        base, bracket, keys = children
        return Index(bracket.line, bracket.column, base, keys)

    def keys(self, children: list[Expression]) -> tuple[Expression, ...]:
        return tuple(children)

    def member(self, children: list[Any]) -> Member:
        return Member(children[1].line, children[1].column, children[0], str(children[1]))

    def name(self, children: list[Token]) -> Name:
        return Name(_line(children[0]), _column(children[0]), str(children[0]))

    def number(self, children: list[Token]) -> Constant:
        return Constant(_line(children[0]), _column(children[0]), _number(children[0]))

    def string(self, children: list[Token]) -> Constant:
        return Constant(_line(children[0]), _column(children[0]), str(children[0])[1:-1])

    def word(self, children: list[Token]) -> Constant:
        return Constant(_line(children[0]), _column(children[0]), _TRUTHS[str(children[0])])

    def array(self, children: list[Any]) -> ListOf:
        return ListOf(children[0].line, children[0].column, tuple(children[1:]))

    def call(self, children: list[Any]) -> Call:
        name, *arguments = children
        positional = tuple(a for a in arguments if not isinstance(a, tuple))
        named = tuple((str(a[0]), a[1]) for a in arguments if isinstance(a, tuple))
        if any(isinstance(a, tuple) for a in arguments[: len(positional)]):
            raise ScriptError(name.line, name.column, f"{name}: arguments without a name must come first")
        if len({key for key, _ in named}) < len(named):
            raise ScriptError(name.line, name.column, f"{name}: an argument is given twice")
        return Call(name.line, name.column, str(name), positional, named)

    def keyword_argument(self, children: list[Any]) -> tuple[str, Expression]:
        return (str(children[0]), children[1])

    def run(self, children: list[Any]) -> Run:
        return Run(children[0].line, children[0].column, children[1])


def _line(token: Token) -> int:
    return token.line or 1


def _column(token: Token) -> int:
    return token.column or 1


def _number(token: Token) -> int | float:
    """An integer if it is written as one and fits into 32 bits."""
    text = str(token)
    if text[:2].lower() == "0x":
        value: int | float = int(text, 16) if len(text) <= 10 else math.inf
        text = str(value)
    else:
        value = float(text)
    if not math.isfinite(value):
        raise ScriptError(_line(token), _column(token), "this number is too large")
    return int(text) if text.isdigit() and value <= _LARGEST_INTEGER else float(value)


@cache
def _parser() -> Lark:
    return Lark(_GRAMMAR, parser="lalr", lexer=_Words, transformer=_Builder(), maybe_placeholders=False)


def parse(text: str) -> Block:
    """The syntax tree of a script. Raises ScriptError where it stops being URScript."""
    found = words(text)
    try:
        return cast("Block", _parser().parse(cast("str", found)))
    except UnexpectedToken as error:
        token = error.token
    if token.type == "$END":
        last = found[-1] if found else Word("", "", 1, 1)
        raise ScriptError(last.line, last.column, "the script ends too early: an `end` or a bracket is missing")
    line, column = _line(token), _column(token)
    raise ScriptError(line, column, _unexpected(token, [word.text for word in found if word.line == line]))


def _unexpected(token: Token, its_line: list[str]) -> str:
    for text in its_line:
        if text in _FOREIGN:
            return f"syntax error at {str(token)!r}: {_FOREIGN[text]}"
    if token.type == "_NEWLINE":
        return "syntax error: the statement is not complete at the end of its line"
    what = "the word" if str(token) in KEYWORDS else "unexpected"
    return f"syntax error: {what} {str(token)!r}" + (" cannot stand here" if str(token) in KEYWORDS else "")
