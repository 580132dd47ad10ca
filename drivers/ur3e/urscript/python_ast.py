"""Python syntax nodes that carry the place of the URScript they come from."""

from __future__ import annotations

import ast
from typing import Any, TypeVar

from drivers.ur3e.urscript.syntax import Node

_Node = TypeVar("_Node", bound=ast.AST)


class PythonAst:
    """Makes nodes at the place that was last set."""

    def __init__(self) -> None:
        self._place = {"lineno": 1, "col_offset": 0, "end_lineno": 1, "end_col_offset": 1}

    def at(self, node: Node) -> None:
        """What is made from now on comes from this node."""
        self._place = {
            "lineno": node.line,
            "col_offset": node.column - 1,
            "end_lineno": node.line,
            "end_col_offset": node.column,
        }

    def make(self, kind: type[_Node], **fields: Any) -> _Node:
        """Any node."""
        return kind(**fields, **self._place)

    def load(self, name: str) -> ast.expr:
        """The value of a Python variable."""
        return self.make(ast.Name, id=name, ctx=ast.Load())

    def constant(self, value: float | bool | str | None) -> ast.expr:
        """A constant."""
        return self.make(ast.Constant, value=value)

    def call(self, function: str, *arguments: ast.expr) -> ast.expr:
        """A call of a Python function by its name."""
        return self.make(ast.Call, func=self.load(function), args=list(arguments), keywords=[])

    def compare(self, left: ast.expr, operator: ast.cmpop, right: ast.expr) -> ast.expr:
        """A comparison."""
        return self.make(ast.Compare, left=left, ops=[operator], comparators=[right])

    def statement(self, expression: ast.expr) -> ast.stmt:
        """An expression for its effect."""
        return self.make(ast.Expr, value=expression)

    def do(self, function: str, *arguments: ast.expr) -> ast.stmt:
        """A call for its effect."""
        return self.statement(self.call(function, *arguments))

    def assign(self, name: str, value: ast.expr) -> ast.stmt:
        """An assignment to a Python variable."""
        return self.make(ast.Assign, targets=[self.make(ast.Name, id=name, ctx=ast.Store())], value=value)

    def branch(self, test: ast.expr, body: list[ast.stmt], otherwise: list[ast.stmt] | None = None) -> ast.stmt:
        """An `if`."""
        return self.make(ast.If, test=test, body=body, orelse=otherwise or [])

    def function(self, name: str, parameters: list[str], body: list[ast.stmt]) -> ast.stmt:
        """A function with positional parameters."""
        arguments = ast.arguments(
            posonlyargs=[self.make(ast.arg, arg=parameter) for parameter in parameters],
            args=[],
            kwonlyargs=[],
            kw_defaults=[],
            defaults=[],
        )
        return self.make(ast.FunctionDef, name=name, args=arguments, body=body, decorator_list=[])


def depth(tree: ast.AST) -> int:
    """How many nodes are inside each other at most, found without recursion."""
    level: list[ast.AST] = [tree]
    deep = 0
    while level:
        deep += 1
        level = [child for node in level for child in ast.iter_child_nodes(node)]
    return deep
