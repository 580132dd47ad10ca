"""Which names a script defines, and what each name means where: functions by nesting, variables by UR's rules.

A variable assigned in the program itself, or anywhere with `global`, is global to the program, even if the program says
`local`. Elsewhere `local` and parameters make a name local to their function, and any other assigned name is the global
of that name if there is one, else local. Functions do not see the locals of functions around them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

from drivers.ur3e.urscript.errors import ScriptError
from drivers.ur3e.urscript.syntax import Assignment, Block, Function, If, Index, Member, Name, Statement, While

MOST_FUNCTIONS = 2000
MOST_VARIABLES = 10_000
DEEPEST_FUNCTIONS = 16


@dataclass
class Scope:
    """One function, or the program itself, which has no parent."""

    function: Function
    identifier: str  # of the Python function it becomes
    parent: Scope | None
    functions: dict[str, Scope] = field(default_factory=dict)  # defined directly inside, by name
    assigned: set[str] = field(default_factory=set)  # variables that it assigns without saying where
    local: set[str] = field(default_factory=set)  # that it declares local, or has as parameters
    globals: set[str] = field(default_factory=set)  # that it declares global

    def find(self, name: str) -> Scope | None:
        """The function of this name that is seen from here."""
        scope: Scope | None = self
        while scope is not None:
            if name in scope.functions:
                return scope.functions[name]
            scope = scope.parent
        return None

    def visible(self) -> set[str]:
        """Names of all functions seen from here."""
        return set(self.functions) | (self.parent.visible() if self.parent else set())


@dataclass(frozen=True)
class Scopes:
    """All functions of a script, the program first, and its global variables."""

    all: tuple[Scope, ...]
    globals: frozenset[str]

    def is_global(self, scope: Scope, name: str) -> bool:
        """Whether a variable without `global` or `local` is the global one in this scope."""
        return scope.parent is None or (name in self.globals and name not in scope.local)


def scopes(program: Function) -> Scopes:
    """The scopes of a program. Raises ScriptError for functions defined twice or where they must not be."""
    found: list[Scope] = []
    _enter(program, None, found, 0)
    main = found[0]
    names = main.assigned | main.local | main.globals
    for scope in found[1:]:
        names |= scope.globals
    if len(names) + sum(len(s.assigned) + len(s.local) for s in found) > MOST_VARIABLES:
        raise ScriptError(program.line, program.column, f"more than {MOST_VARIABLES} variables")
    return Scopes(tuple(found), frozenset(names))


def _enter(function: Function, parent: Scope | None, found: list[Scope], depth: int) -> Scope:
    if len(found) >= MOST_FUNCTIONS:
        raise ScriptError(function.line, function.column, f"more than {MOST_FUNCTIONS} functions")
    if depth > DEEPEST_FUNCTIONS:
        raise ScriptError(function.line, function.column, f"functions more than {DEEPEST_FUNCTIONS} deep in each other")
    scope = Scope(function, f"f{len(found)}_{function.name}", parent)
    found.append(scope)
    for parameter in function.parameters:
        if parameter.name in scope.local:
            raise ScriptError(parameter.line, parameter.column, f"{function.name}: two parameters {parameter.name!r}")
        scope.local.add(parameter.name)
    for statement in _flat(function.body):
        if isinstance(statement, Assignment):
            group = {"global": scope.globals, "local": scope.local, "": scope.assigned}[statement.scope]
            group.add(_root(statement.place))
        elif isinstance(statement, Function):
            _define(statement, scope, found, depth)
    return scope


def _define(function: Function, scope: Scope, found: list[Scope], depth: int) -> None:
    if function.kind == "sec":
        raise ScriptError(function.line, function.column, "a `sec` cannot stand inside of another program")
    if not any(function is statement for statement in scope.function.body):
        raise ScriptError(function.line, function.column, f"{function.name} is defined inside of an `if` or `while`")
    if function.name in scope.functions:
        first = scope.functions[function.name].function.line
        raise ScriptError(function.line, function.column, f"{function.name} is already defined on line {first}")
    scope.functions[function.name] = _enter(function, scope, found, depth + 1)


def _flat(block: Block) -> Iterator[Statement]:
    """All statements of a function, those inside of `if` and `while` included, those of functions in it not."""
    waiting: list[Statement] = list(reversed(block))
    while waiting:
        statement = waiting.pop()
        yield statement
        if isinstance(statement, If):
            waiting += statement.otherwise
            for _, body in statement.branches:
                waiting += body
        elif isinstance(statement, While):
            waiting += statement.body


def _root(place: object) -> str:
    while isinstance(place, Index | Member):
        place = place.base
    if not isinstance(place, Name):
        raise TypeError(f"a place begins with a name, not with {place!r}")
    return place.name
