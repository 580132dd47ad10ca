"""Expressions of URScript to Python's."""

from __future__ import annotations

import ast
from collections.abc import Mapping

from drivers.ur3e.urscript.errors import ScriptError
from drivers.ur3e.urscript.python_ast import PythonAst
from drivers.ur3e.urscript.scopes import Scope, Scopes
from drivers.ur3e.urscript.syntax import (
    Binary,
    Call,
    Constant,
    Expression,
    Index,
    ListOf,
    Member,
    Name,
    Node,
    Parameter,
    Run,
    Unary,
)
from runtime.errors import alternatives

_DEEPEST = 100  # expressions inside each other
_POSE = "p"
_STRUCT = "struct"
_ARITHMETIC = {"+": "_add", "-": "_subtract", "*": "_multiply", "/": "_divide", "%": "_modulo"}
_COMPARISON = {"==": "_eq", "!=": "_ne", "<": "_lt", "<=": "_le", ">": "_gt", ">=": "_ge"}
_SIGNS = {"-": "_negative", "+": "_positive"}
_LOGIC = {"and", "or", "xor", "not"}
_NAMED = 5  # names listed for one that is unknown


class Expressions:
    """Turns the expressions of one scope at a time."""

    def __init__(self, found: Scopes, builtins: Mapping[str, bool], python: PythonAst, used: set[str]) -> None:
        self._scopes, self._builtins, self._python, self._used = found, builtins, python, used
        self._scope = found.all[0]
        self._depth = 0
        self.weight = 0  # nodes turned since it was last set to 0
        self.calls = False  # whether a call was among them

    def enter(self, scope: Scope) -> None:
        """What is turned from now on stands in this scope."""
        self._scope = scope

    def variable(self, name: str) -> str:
        """The Python variable of a name that stands here."""
        return f"g_{name}" if self._scopes.is_global(self._scope, name) or self._foreign(name) else f"v_{name}"

    def _foreign(self, name: str) -> bool:
        """Whether a name is not even assigned here; it then has no value, whichever variable is asked."""
        return name not in self._scope.local and name not in self._scope.assigned

    def kept(self, node: Expression) -> ast.expr:
        """A value for one who keeps it: copied, if somebody else has it already."""
        value = self.value(node)
        if not isinstance(node, Name | Index | Member) or _is_pose(node):
            return value
        self._python.at(node)
        return self._python.call("_copy", value)

    def condition(self, node: Expression) -> ast.expr:
        """A value that is True or False and nothing else."""
        value = self.value(node)
        known = isinstance(node, Constant) and isinstance(node.value, bool)
        if known or (isinstance(node, Binary | Unary) and (node.operator in _LOGIC or node.operator in _COMPARISON)):
            return value
        self._python.at(node)
        return self._python.call("_truth", value)

    def value(self, node: Expression) -> ast.expr:
        """A value that is only looked at."""
        self.weight += 1
        self._depth += 1
        if self._depth > _DEEPEST:
            raise ScriptError(node.line, node.column, f"expressions more than {_DEEPEST} deep in each other")
        made = self._value(node)
        self._depth -= 1
        return made

    def _value(self, node: Expression) -> ast.expr:
        py = self._python
        match node:
            case Constant(value=value):
                py.at(node)
                return py.constant(value)
            case Name(name=name):
                py.at(node)
                return py.load(self.variable(name))
            case Unary():
                return self._unary(node)
            case Binary():
                return self._binary(node)
            case Index():
                return self._index(node)
            case Member(base=base, name=name):
                made = self.value(base)
                py.at(node)
                return py.call("_member", made, py.constant(name))
            case ListOf(items=items):
                elements = [self.kept(item) for item in items]
                py.at(node)
                made = py.make(ast.List, elts=elements, ctx=ast.Load())
                if len(items) < 100 and all(isinstance(i, Constant) and type(i.value) in (int, float) for i in items):
                    return made
                return py.call("_list", made)
            case Call():
                return self._call(node)
            case Run(call=call):
                return self._run(node, call)

    def _unary(self, node: Unary) -> ast.expr:
        py, operand = self._python, node.operand
        if node.operator == "not":
            made = self.condition(operand)
            py.at(node)
            return py.make(ast.UnaryOp, op=ast.Not(), operand=made)
        if node.operator == "-" and isinstance(operand, Constant) and type(operand.value) in (int, float):
            py.at(node)
            return py.constant(-operand.value)  # type: ignore[operator]
        made = self.value(operand)
        py.at(node)
        return py.call(_SIGNS[node.operator], made)

    def _binary(self, node: Binary) -> ast.expr:
        py, operator = self._python, node.operator
        if operator in _LOGIC:
            left, right = self.condition(node.left), self.condition(node.right)
            py.at(node)
            if operator == "xor":
                return py.compare(left, ast.IsNot(), right)
            return py.make(ast.BoolOp, op=ast.And() if operator == "and" else ast.Or(), values=[left, right])
        left, right = self.value(node.left), self.value(node.right)
        py.at(node)
        return py.call(_ARITHMETIC.get(operator) or _COMPARISON[operator], left, right)

    def _index(self, node: Index) -> ast.expr:
        py = self._python
        if _is_pose(node):
            values = [self.value(key) for key in node.keys]
            py.at(node)
            return py.call("_pose", *values)
        if len(node.keys) > 2:
            hint = "; a pose has six" if isinstance(node.base, Name) and node.base.name == _POSE else ""
            raise ScriptError(node.line, node.column, f"an element has one or two indices, not {len(node.keys)}{hint}")
        made = [self.value(node.base), *(self.value(key) for key in node.keys)]
        py.at(node)
        return py.call("_item" if len(made) == 2 else "_cell", *made)

    def _call(self, node: Call) -> ast.expr:
        py = self._python
        self.calls = True
        target = self._scope.find(node.name)
        if target is not None:
            if target.function.kind == "thread":
                raise ScriptError(node.line, node.column, f"{node.name} is a thread; start it with `run {node.name}()`")
            deeper = py.make(ast.BinOp, left=py.load("_depth"), op=ast.Add(), right=py.constant(1))
            return py.make(ast.YieldFrom, value=self._begin(node, target, deeper))
        if node.name == _STRUCT:
            return self._struct(node)
        if node.name not in self._builtins:
            raise ScriptError(node.line, node.column, f"no function {node.name!r} is known; {self._closest(node.name)}")
        self._used.add(node.name)
        arguments = [self.kept(argument) for argument in node.arguments]
        keywords = [(key, self.kept(value)) for key, value in node.keywords]
        py.at(node)
        made = py.make(
            ast.Call,
            func=py.load(f"b_{node.name}"),
            args=arguments,
            keywords=[py.make(ast.keyword, arg=key, value=value) for key, value in keywords],
        )
        return py.make(ast.YieldFrom, value=made) if self._builtins[node.name] else made

    def _run(self, node: Run, call: Call) -> ast.expr:
        py = self._python
        self.calls = True
        target = self._scope.find(call.name)
        if target is None or target.function.kind != "thread":
            threads = [s.function.name for s in self._scopes.all if s.function.kind == "thread"]
            what = "a function" if target else "not defined"
            raise ScriptError(call.line, call.column, f"`run` starts a thread, and {call.name!r} is {what}; "
                              + alternatives(call.name, threads))  # fmt: skip
        began = self._begin(call, target, py.constant(1))
        py.at(node)
        return py.call("_run", began)

    def _begin(self, node: Call, target: Scope, depth: ast.expr) -> ast.expr:
        """The generator of a function of the script, with its arguments in order."""
        given: dict[str, Expression] = dict(node.keywords)
        parameters = target.function.parameters
        if len(node.arguments) > len(parameters):
            raise ScriptError(node.line, node.column,
                              f"{node.name} takes {len(parameters)} arguments, not {len(node.arguments)}")  # fmt: skip
        for parameter, argument in zip(parameters, node.arguments, strict=False):
            if parameter.name in given:
                raise ScriptError(node.line, node.column, f"{node.name}: {parameter.name!r} is given twice")
            given[parameter.name] = argument
        unknown = set(given) - {parameter.name for parameter in parameters}
        if unknown:
            wrong = min(unknown)
            known = alternatives(wrong, [parameter.name for parameter in parameters])
            raise ScriptError(node.line, node.column, f"{node.name} has no parameter {wrong!r}; {known}")
        arguments = [self._argument(node, parameter, given) for parameter in parameters]
        self._python.at(node)
        return self._python.call(target.identifier, depth, *arguments)

    def _argument(self, node: Node, parameter: Parameter, given: Mapping[str, Expression]) -> ast.expr:
        if parameter.name in given:
            return self.kept(given[parameter.name])
        if parameter.default is None:
            name = node.name if isinstance(node, Call) else ""
            raise ScriptError(node.line, node.column, f"{name}: no value is given for {parameter.name!r}")
        self._python.at(node)
        return self._python.constant(None)

    def _struct(self, node: Call) -> ast.expr:
        if node.arguments or not node.keywords:
            raise ScriptError(node.line, node.column, "struct takes named values, such as struct(a=1, b=2)")
        values = [self.kept(value) for _, value in node.keywords]
        py = self._python
        py.at(node)
        names: list[ast.expr | None] = [py.constant(name) for name, _ in node.keywords]
        return py.call("_struct", py.make(ast.Dict, keys=names, values=values))

    def _closest(self, name: str) -> str:
        """The likeliest names of those that can be called here."""
        from difflib import get_close_matches

        close = get_close_matches(name, sorted(self._scope.visible() | set(self._builtins)), n=_NAMED, cutoff=0.6)
        return f"did you mean {' or '.join(close)}?" if close else "and none is like it"


def _is_pose(node: Expression) -> bool:
    return isinstance(node, Index) and len(node.keys) == 6 and isinstance(node.base, Name) and node.base.name == _POSE
