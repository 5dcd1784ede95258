"""Where the functions of an OpenCL C file can be changed by one operator, found by a small tokenizer."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

from .mutant import Mutant, fingerprint

TOKEN = re.compile(
    r"(?P<skipped>/\*.*?\*/|//[^\n]*|\#(?:\\\n|[^\n])*|\s+)"
    r"|(?P<text>\"(?:\\.|[^\"\\])*\"|'(?:\\.|[^'\\])*')"
    r"|(?P<number>0[xX][0-9a-fA-F]+[uUlL]*|(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?[fFuUlL]*)"
    r"|(?P<name>[A-Za-z_]\w*)"
    r"|(?P<operator><<=|>>=|->|\+\+|--|&&|\|\||[-+*/%&|^<>=!]=|<<|>>|.)",
    flags=re.DOTALL,
)
OPERATORS = {
    "+": "-", "-": "+", "*": "/", "/": "*", "%": "*",
    "+=": "-=", "-=": "+=", "*=": "/=", "/=": "*=",
    "<": "<=", "<=": "<", ">": ">=", ">=": ">", "==": "!=", "!=": "==",
    "&&": "||", "||": "&&", "&": "|", "|": "&", "<<": ">>", ">>": "<<",
}  # fmt: skip
NAMES = {
    "lesser": "greater", "greater": "lesser", "min": "max", "max": "min", "fmin": "fmax", "fmax": "fmin",
    "floor": "ceil", "ceil": "floor", "sin": "cos", "cos": "sin", "true": "false", "false": "true",
}  # fmt: skip
NUMBERS = {"0": "1", "1": "0", "0u": "1u", "1u": "0u", "0.0f": "1.0f", "1.0f": "0.0f", "0.5f": "1.0f", "2.0f": "1.0f"}
# An asterisk after one of these is a pointer's, as it is after a name with a capital (a struct's).
TYPES = re.compile(
    r"(?:void|bool|char|uchar|short|int|uint|long|ulong|size_t|float|double|half)\d*|const|[A-Z]\w*[a-z]\w*"
)


@dataclass(frozen=True)
class Token:
    kind: str
    text: str
    start: int


def tokens(text: str) -> list[Token]:
    found = (Token(str(match.lastgroup), match[0], match.start()) for match in TOKEN.finditer(text))
    return [token for token in found if token.kind != "skipped"]


def functions(code: list[Token]) -> Iterator[tuple[str, int, int]]:
    """Name, first and last token of the bodies of functions: braces after parentheses, outside of all others."""
    depth = 0
    first = 0
    name = ""
    for index, token in enumerate(code):
        if token.text == "(" and depth == 0 and code[index - 1].kind == "name":
            name = code[index - 1].text
        if token.text == "{":
            if depth == 0:
                first = index if code[index - 1].text == ")" else -1
            depth += 1
        elif token.text == "}":
            depth -= 1
            if depth == 0 and first >= 0:
                yield name, first, index


def _is_binary(code: list[Token], index: int) -> bool:
    before, after = code[index - 1], code[index + 1]
    is_type = TYPES.fullmatch(before.text) and not before.text.isupper()
    if before.kind == "name" and (is_type or before.text == "return"):
        return False
    return (before.kind in ("name", "number") or before.text in (")", "]")) and after.text not in (")", ",", "*")


def _replacement(code: list[Token], index: int) -> str | None:
    token = code[index]
    if token.kind == "number":
        return NUMBERS.get(token.text)
    if token.kind == "name":
        called = code[index + 1].text == "(" or token.text in ("true", "false")
        return NAMES.get(token.text) if called else None
    if token.kind != "operator" or token.text not in OPERATORS:
        return None
    if token.text in ("+", "-", "*", "&"):
        if _is_binary(code, index):
            return OPERATORS[token.text]
        return "" if token.text == "-" else None
    return OPERATORS[token.text]


def mutants(path: str, text: str) -> Iterator[list[Mutant]]:
    """For every function that has some, all its mutants."""
    code = tokens(text)
    for name, first, last in functions(code):
        start, end = code[first].start, code[last].start
        mark = fingerprint(text[start:end])
        found = []
        for index in range(first + 1, last):
            new = _replacement(code, index)
            if new is not None:
                at = code[index].start
                line = text.count("\n", 0, at) + 1
                found.append(Mutant(path, name, line, at, at + len(code[index].text), new, mark, at - start))
        if found:
            yield found
