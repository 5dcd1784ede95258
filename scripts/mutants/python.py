"""Where the functions of a Python file can be changed by one operator."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

from .mutant import Mutant, fingerprint

OPERATORS: dict[type[ast.AST], tuple[str, str]] = {
    ast.Add: ("+", "-"),
    ast.Sub: ("-", "+"),
    ast.Mult: ("*", "/"),
    ast.Div: ("/", "*"),
    ast.FloorDiv: ("//", "*"),
    ast.Mod: ("%", "*"),
    ast.Pow: ("**", "*"),
    ast.BitAnd: ("&", "|"),
    ast.BitOr: ("|", "&"),
    ast.LShift: ("<<", ">>"),
    ast.RShift: (">>", "<<"),
    ast.Lt: ("<", "<="),
    ast.LtE: ("<=", "<"),
    ast.Gt: (">", ">="),
    ast.GtE: (">=", ">"),
    ast.Eq: ("==", "!="),
    ast.NotEq: ("!=", "=="),
    ast.And: ("and", "or"),
    ast.Or: ("or", "and"),
}
NAMES = {
    "min": "max",
    "max": "min",
    "minimum": "maximum",
    "maximum": "minimum",
    "argmin": "argmax",
    "argmax": "argmin",
    "floor": "ceil",
    "ceil": "floor",
    "any": "all",
    "all": "any",
    "sin": "cos",
    "cos": "sin",
    "cumsum": "cumprod",
}
# Modules of whose functions an argument changes its sign.
NUMERIC_MODULES = ("np", "math")


class _Sites(ast.NodeVisitor):
    """(start, end, new) of every site of one function, in characters of the file."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.found: list[tuple[int, int, str]] = []
        starts = [0]
        for line in text.splitlines(keepends=True):
            starts.append(starts[-1] + len(line))
        self.starts = starts
        self.lines = text.splitlines(keepends=True)

    def _place(self, line: int, column: int) -> int:
        # Columns of the syntax tree count bytes.
        return self.starts[line - 1] + len(self.lines[line - 1].encode()[:column].decode())

    def start(self, node: ast.expr) -> int:
        return self._place(node.lineno, node.col_offset)

    def end(self, node: ast.expr) -> int:
        assert node.end_lineno is not None and node.end_col_offset is not None
        return self._place(node.end_lineno, node.end_col_offset)

    def _between(self, left: int, right: int, operator: ast.AST, suffix: str = "") -> None:
        if type(operator) not in OPERATORS:
            return
        old, new = OPERATORS[type(operator)]
        # Comments between operands may hold anything.
        gap = re.sub(r"#[^\n]*", lambda comment: " " * len(comment[0]), self.text[left:right])
        at = gap.find(old + suffix)
        if at >= 0:
            self.found.append((left + at, left + at + len(old), new))

    def visit_BinOp(self, node: ast.BinOp) -> None:
        self._between(self.end(node.left), self.start(node.right), node.op)
        self.generic_visit(node)

    def visit_AugAssign(self, node: ast.AugAssign) -> None:
        self._between(self.end(node.target), self.start(node.value), node.op, "=")
        self.generic_visit(node)

    def visit_Compare(self, node: ast.Compare) -> None:
        for left, operator, right in zip([node.left, *node.comparators], node.ops, node.comparators):
            self._between(self.end(left), self.start(right), operator)
        self.generic_visit(node)

    def visit_BoolOp(self, node: ast.BoolOp) -> None:
        for left, right in zip(node.values, node.values[1:]):
            self._between(self.end(left), self.start(right), node.op)
        self.generic_visit(node)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> None:
        if isinstance(node.op, (ast.USub, ast.Not, ast.Invert)):
            start = self.start(node)
            self.found.append((start, start + (len("not ") if isinstance(node.op, ast.Not) else 1), ""))
        self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> None:
        if isinstance(node.value, bool):
            self.found.append((self.start(node), self.end(node), str(not node.value)))
        elif isinstance(node.value, (int, float)) and node.value in (0, 1):
            self.found.append((self.start(node), self.end(node), str(type(node.value)(1 - node.value))))

    def visit_Call(self, node: ast.Call) -> None:
        function = node.func
        if isinstance(function, ast.Name) and function.id in NAMES:
            self.found.append((self.start(function), self.end(function), NAMES[function.id]))
        if isinstance(function, ast.Attribute):
            if function.attr in NAMES:
                end = self.end(function)
                self.found.append((end - len(function.attr), end, NAMES[function.attr]))
            if isinstance(function.value, ast.Name) and function.value.id in NUMERIC_MODULES:
                for argument in node.args:
                    if isinstance(argument, ast.Name):
                        start = self.start(argument)
                        self.found.append((start, start, "-"))
        self.generic_visit(node)

    def visit_JoinedStr(self, node: ast.JoinedStr) -> None:
        """Messages are not numerics."""

    def visit_Raise(self, node: ast.Raise) -> None:
        """Nor are they here."""

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        if node.value is not None:
            self.visit(node.value)

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        """A function in a function is one of its own."""


def functions(body: list[ast.stmt], outer: str = "") -> Iterator[tuple[str, ast.FunctionDef]]:
    for node in body:
        if isinstance(node, ast.ClassDef):
            yield from functions(node.body, f"{outer}{node.name}.")
        elif isinstance(node, ast.FunctionDef):
            yield f"{outer}{node.name}", node
            yield from functions(node.body, f"{outer}{node.name}.")


def mutants(path: str, text: str) -> Iterator[list[Mutant]]:
    """For every function that has some, all its mutants."""
    for name, node in functions(ast.parse(text).body):
        sites = _Sites(text)
        for statement in node.body:
            sites.visit(statement)
        assert node.end_lineno is not None
        first, last = sites.starts[node.lineno - 1], sites.starts[node.end_lineno]
        mark = fingerprint(text[first:last])
        found = [
            Mutant(path, name, text.count("\n", 0, start) + 1, start, end, new, mark, start - first)
            for start, end, new in sites.found
        ]
        if found:
            yield found
