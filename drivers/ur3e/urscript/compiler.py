"""A script's syntax tree to Python code, by way of Python's `ast`: no Python text is ever made of a script.

Every URScript function is a Python generator, in which a bare `yield` is one control cycle; a truthy one says that the
thread has been preempted. Names are mangled, so that a script reaches nothing but what it defines and its builtins.
Python's line numbers are those of the script, so that tracebacks tell where a script erred.
"""

from __future__ import annotations

import ast
import marshal
from collections.abc import Mapping

from drivers.ur3e.urscript.errors import ScriptError
from drivers.ur3e.urscript.expressions import Expressions
from drivers.ur3e.urscript.grammar import parse
from drivers.ur3e.urscript.python_ast import PythonAst, depth
from drivers.ur3e.urscript.scopes import Scope, Scopes, scopes
from drivers.ur3e.urscript.script import FILE, LONGEST_CODE, Script
from drivers.ur3e.urscript.syntax import (
    Assignment,
    Block,
    Constant,
    Effect,
    Function,
    If,
    Keyword,
    Member,
    Name,
    Node,
    Return,
    Statement,
    ThreadControl,
    While,
)

_DEEPEST_BLOCKS = 40
_DEEPEST_LOOPS = 16  # Python allows 20
_DEEPEST_PYTHON = 600  # nodes inside each other
_CHARGE = 8  # [nodes] that cost a step
_OFTEN = 128  # [nodes] after which a thread may be preempted


def compile_script(text: str, builtins: Mapping[str, bool]) -> Script:
    """Compile a script against the builtins that exist, each with whether it is timed.

    A text is one `def` or `sec`, or bare statements with functions among them. Raises ScriptError.
    """
    program = _program(parse(text))
    compiler = _Compiler(scopes(program), builtins)
    try:
        module = compiler.module()
        if depth(module) > _DEEPEST_PYTHON:
            raise ScriptError(program.line, program.column, "the script is nested too deeply")
        code = compile(module, FILE, "exec", dont_inherit=True, optimize=2)
    except (RecursionError, MemoryError, SyntaxError, ValueError, OverflowError) as error:
        raise ScriptError(program.line, program.column, f"the script is too complex: {error}") from error
    kind = "sec" if program.kind == "sec" else "def"
    marshalled = marshal.dumps(code)
    if len(marshalled) > LONGEST_CODE:
        size = f"{len(marshalled)} of at most {LONGEST_CODE} bytes"
        raise ScriptError(1, 1, f"the script is too long: it compiles to {size}")
    return Script(program.name, kind, marshalled, tuple(sorted(compiler.used)))


def _program(block: Block) -> Function:
    if not block:
        raise ScriptError(1, 1, "the script is empty")
    programs = [statement for statement in block if isinstance(statement, Function) and statement.kind != "thread"]
    if len(block) == 1 and programs:
        if programs[0].parameters:
            raise ScriptError(programs[0].line, programs[0].column, "a program takes no arguments")
        return programs[0]
    if len(programs) == len(block):
        raise ScriptError(programs[1].line, programs[1].column, "a script holds one program, and this is a second one")
    return Function(block[0].line, block[0].column, "def", "", (), block)


class _Compiler:
    """Turns statements into Python's; expressions are turned by `Expressions`."""

    def __init__(self, found: Scopes, builtins: Mapping[str, bool]) -> None:
        self._scopes = found
        self._python = PythonAst()
        self.used: set[str] = set()
        self._expressions = Expressions(found, builtins, self._python, self.used)
        self._depth = 0
        self._loops = 0

    def module(self) -> ast.Module:
        """One Python function for each of the script's."""
        return ast.Module(body=[self._function(scope) for scope in self._scopes.all], type_ignores=[])

    def _function(self, scope: Scope) -> ast.stmt:
        function, py = scope.function, self._python
        py.at(function)
        self._expressions.enter(scope)
        self._loops = 0
        head: list[ast.stmt] = []
        declared = scope.globals | {n for n in scope.assigned | scope.local if self._scopes.is_global(scope, n)}
        if declared:
            head.append(py.make(ast.Global, names=[f"g_{name}" for name in sorted(declared)]))
        head.append(py.branch(py.compare(py.load("_depth"), ast.Gt(), py.load("_deepest")), [py.do("_too_deep")]))
        for parameter in function.parameters:
            if parameter.default is not None:
                variable = f"v_{parameter.name}"
                py.at(parameter)
                missing = py.compare(py.load(variable), ast.Is(), py.constant(None))
                default = self._expressions.kept(parameter.default)
                py.at(parameter)
                head.append(py.branch(missing, [py.assign(variable, default)]))
        py.at(function)
        head += self._charge(_CHARGE + len(function.parameters))
        self._expressions.weight = 0
        self._expressions.calls = False
        body, _ = self._block(function, function.body)
        names = ["_depth", *(f"v_{parameter.name}" for parameter in function.parameters)]
        py.at(function)
        return py.function(scope.identifier, names, head + body)

    def _charge(self, nodes: int) -> list[ast.stmt]:
        """Charge the meter, and end the thread's cycle if it has no steps left."""
        py = self._python
        steps = py.make(ast.Attribute, value=py.load("_meter"), attr="steps", ctx=ast.Store())
        left = py.make(ast.Attribute, value=py.load("_meter"), attr="steps", ctx=ast.Load())
        price = py.constant(max(1, nodes // _CHARGE))
        preempt = py.make(ast.Expr, value=py.make(ast.Yield, value=py.constant(True)))
        return [
            py.make(ast.AugAssign, target=steps, op=ast.Sub(), value=price),
            py.branch(py.compare(left, ast.Lt(), py.constant(0)), [preempt]),
        ]

    def _block(self, owner: Node, block: Block) -> tuple[list[ast.stmt], int]:
        """Statements, with the nodes among them that have not been charged."""
        self._depth += 1
        if self._depth > _DEEPEST_BLOCKS:
            raise ScriptError(owner.line, owner.column, f"blocks more than {_DEEPEST_BLOCKS} deep in each other")
        done: list[ast.stmt] = []
        pending = 0
        for statement in block:
            self._expressions.weight, self._expressions.calls = 1, False
            made, inner = self._statement(statement)
            if not made:
                continue
            pending += self._expressions.weight
            if self._expressions.calls or pending > _OFTEN:
                self._python.at(statement)
                done += self._charge(pending)
                pending = 0
            done += made
            pending += inner
        self._depth -= 1
        return done, pending

    def _statement(self, statement: Statement) -> tuple[list[ast.stmt], int]:
        """A statement, with the nodes of blocks in it that have not been charged."""
        py, expressions = self._python, self._expressions
        py.at(statement)
        match statement:
            case Assignment():
                return [self._assignment(statement)], 0
            case Effect(expression=expression):
                return [py.statement(expressions.value(expression))], 0
            case If():
                return self._if(statement)
            case While():
                return self._while(statement)
            case Return(value=value):
                result = None if value is None else expressions.kept(value)
                py.at(statement)
                return [py.make(ast.Return, value=result)], 0
            case ThreadControl(word="kill", thread=thread):
                return [py.do("_kill", expressions.value(thread))], 0
            case ThreadControl(thread=thread):
                expressions.calls = True
                join = py.call("_join", expressions.value(thread))
                return [py.statement(py.make(ast.YieldFrom, value=join))], 0
            case Keyword(word=word):
                return self._keyword(statement, word), 0
            case Function():
                return [], 0

    def _keyword(self, statement: Keyword, word: str) -> list[ast.stmt]:
        py = self._python
        if word in {"break", "continue"}:
            if not self._loops:
                raise ScriptError(statement.line, statement.column, f"`{word}` outside of a loop")
            return [py.make(ast.Break) if word == "break" else py.make(ast.Continue)]
        if word == "halt":
            return [py.do("_halt")]
        if word == "pause":
            return [py.do("_pause"), py.make(ast.Expr, value=py.make(ast.Yield, value=None))]
        return [py.make(ast.Pass)]

    def _if(self, statement: If) -> tuple[list[ast.stmt], int]:
        py, expressions = self._python, self._expressions
        otherwise, uncharged = self._block(statement, statement.otherwise)
        weight, calls = 1, False
        for condition, body in reversed(statement.branches):
            inside, inner = self._block(condition, body)
            expressions.weight, expressions.calls = 0, False
            py.at(condition)
            test = expressions.condition(condition)
            weight, calls = weight + expressions.weight, calls or expressions.calls
            py.at(condition)
            otherwise = [py.branch(test, inside or [py.make(ast.Pass)], otherwise)]
            uncharged = max(uncharged, inner)
        expressions.weight, expressions.calls = weight, calls
        return otherwise, uncharged

    def _while(self, statement: While) -> tuple[list[ast.stmt], int]:
        py, expressions = self._python, self._expressions
        self._loops += 1
        if self._loops > _DEEPEST_LOOPS:
            raise ScriptError(statement.line, statement.column, f"loops more than {_DEEPEST_LOOPS} deep in each other")
        body, uncharged = self._block(statement, statement.body)
        self._loops -= 1
        expressions.weight, expressions.calls = 1, False
        test = expressions.condition(statement.condition)
        calls = expressions.calls
        py.at(statement)
        turn = self._charge(_CHARGE + expressions.weight + uncharged)
        expressions.calls = calls
        return [py.make(ast.While, test=test, body=turn + body, orelse=[])], 0

    def _assignment(self, statement: Assignment) -> ast.stmt:
        py, expressions, place = self._python, self._expressions, statement.place
        value = expressions.kept(statement.value)
        py.at(statement.value)
        if isinstance(statement.value, Constant) and statement.value.value is None:
            raise ScriptError(statement.line, statement.column, "None cannot be assigned")
        py.at(statement)
        if isinstance(place, Name):
            name = f"g_{place.name}" if statement.scope == "global" else expressions.variable(place.name)
            return py.assign(name, value)
        if statement.scope:
            raise ScriptError(statement.line, statement.column, f"`{statement.scope}` takes a name, not an element")
        if isinstance(place, Member):
            return py.do("_set_member", value, expressions.value(place.base), py.constant(place.name))
        keys = [expressions.value(key) for key in reversed(place.keys)]
        base = expressions.value(place.base)
        py.at(place)
        if len(keys) > 2:
            raise ScriptError(place.line, place.column, f"an element has one or two indices, not {len(keys)}")
        return py.do("_set_item" if len(keys) == 1 else "_set_cell", value, *keys, base)
