"""The syntax tree of a script. Every node knows its line and column, both from 1."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias


@dataclass(frozen=True)
class Node:
    """Something at a place in the text."""

    line: int
    column: int


@dataclass(frozen=True)
class Constant(Node):
    """A number, string, True, False or None as written."""

    value: int | float | bool | str | None


@dataclass(frozen=True)
class Name(Node):
    """A variable."""

    name: str


@dataclass(frozen=True)
class Index(Node):
    """`base[i]`, `base[i, j]`, or a pose: `p[...]` with six keys, since `p` is a name like any other."""

    base: Expression
    keys: tuple[Expression, ...]


@dataclass(frozen=True)
class Member(Node):
    """`base.name` of a struct."""

    base: Expression
    name: str


@dataclass(frozen=True)
class ListOf(Node):
    """`[a, b, ...]`."""

    items: tuple[Expression, ...]


@dataclass(frozen=True)
class Unary(Node):
    """`not a`, `-a`, `+a`."""

    operator: str
    operand: Expression


@dataclass(frozen=True)
class Binary(Node):
    """`a operator b`."""

    operator: str
    left: Expression
    right: Expression


@dataclass(frozen=True)
class Call(Node):
    """`name(a, b, key=c)`."""

    name: str
    arguments: tuple[Expression, ...]
    keywords: tuple[tuple[str, Expression], ...]


@dataclass(frozen=True)
class Run(Node):
    """`run thread(...)`: the id of the thread it starts."""

    call: Call


Expression: TypeAlias = Constant | Name | Index | Member | ListOf | Unary | Binary | Call | Run


@dataclass(frozen=True)
class Assignment(Node):
    """`place = value`, perhaps with `global` or `local` before it."""

    place: Name | Index | Member
    value: Expression
    scope: str  # "global", "local" or ""


@dataclass(frozen=True)
class Effect(Node):
    """A call or run whose result is dropped."""

    expression: Call | Run


@dataclass(frozen=True)
class If(Node):
    """Conditions with their blocks in order, and the `else` block."""

    branches: tuple[tuple[Expression, Block], ...]
    otherwise: Block


@dataclass(frozen=True)
class While(Node):
    """A loop."""

    condition: Expression
    body: Block


@dataclass(frozen=True)
class Return(Node):
    """`return`, with or without a value."""

    value: Expression | None


@dataclass(frozen=True)
class Keyword(Node):
    """A statement of one word: break, continue, pass, halt, pause, enter_critical, exit_critical."""

    word: str


@dataclass(frozen=True)
class ThreadControl(Node):
    """`kill` or `join` a thread by its id."""

    word: str
    thread: Expression


@dataclass(frozen=True)
class Parameter(Node):
    """A parameter, with its default if it has one."""

    name: str
    default: Expression | None


@dataclass(frozen=True)
class Function(Node):
    """A `def`, `thread` or `sec`."""

    kind: str
    name: str
    parameters: tuple[Parameter, ...]
    body: Block


Statement: TypeAlias = Assignment | Effect | If | While | Return | Keyword | ThreadControl | Function
Block: TypeAlias = tuple[Statement, ...]
