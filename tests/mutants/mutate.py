"""Small changes of source code, each of which some test must notice."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

__all__ = ["Mutant", "mutants_of"]

_COMPARISONS: dict[type[ast.cmpop], tuple[str, tuple[str, ...]]] = {
    ast.Lt: ("<", ("<=", ">=")), ast.LtE: ("<=", ("<", ">")), ast.Gt: (">", (">=", "<=")),
    ast.GtE: (">=", (">", "<")), ast.Eq: ("==", ("!=",)), ast.NotEq: ("!=", ("==",)),
    ast.Is: ("is", ("is not",)), ast.IsNot: ("is not", ("is",)), ast.In: ("in", ("not in",)),
    ast.NotIn: ("not in", ("in",)),
}  # fmt: skip
_ARITHMETIC: dict[type[ast.operator], tuple[str, str]] = {
    ast.Add: ("+", "-"), ast.Sub: ("-", "+"), ast.Mult: ("*", "/"), ast.Div: ("/", "*"),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Mutant:
    """One change: where, of which kind, and the whole source with it.

    `kind` is comparison, call, or other; `at_import`: it stands outside of every function, so that
    no test is seen to run it.
    """

    file: str
    line: int
    at_import: bool
    kind: str
    change: str
    source: str

    @property
    def name(self) -> str:
        """What tells it from the others."""
        return f"{self.file}:{self.line} {self.change}"


class _Source:
    """Text by the positions of the syntax tree, whose columns are bytes."""

    def __init__(self, path: Path) -> None:
        self.text = path.read_text("utf-8")
        self._lines = self.text.splitlines(keepends=True)
        self._begins = [0]
        for line in self._lines:
            self._begins.append(self._begins[-1] + len(line))

    def at(self, line: int, column: int) -> int:
        return self._begins[line - 1] + len(self._lines[line - 1].encode()[:column].decode())

    def begin(self, node: ast.expr | ast.stmt) -> int:
        return self.at(node.lineno, node.col_offset)

    def end(self, node: ast.expr | ast.stmt) -> int:
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        return self.at(node.end_lineno, node.end_col_offset)

    def replaced(self, begin: int, end: int, new: str) -> str:
        return self.text[:begin] + new + self.text[end:]


def mutants_of(path: Path, root: Path) -> list[Mutant]:
    """Every mutant of a file, in order; words for people and annotations are left alone."""
    source, file = _Source(path), path.relative_to(root).as_posix()
    found: list[Mutant] = []
    tree = ast.parse(source.text)
    bodies = [
        range(node.body[0].lineno, (node.end_lineno or 0) + 1)
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef)
    ]
    for node in _code(tree):
        for kind, begin, end, new in _changes(node, source):
            line = source.text.count("\n", 0, begin) + 1
            old = " ".join(source.text[begin:end].split())
            change = f"`{old[:50]}` → `{new}`" + ("" if kind == "call" else _where(source, begin))
            at_import = not any(line in body for body in bodies)
            mutated = source.replaced(begin, end, new)
            found.append(Mutant(file, line, at_import, kind, change, mutated))
    return sorted(found, key=lambda mutant: mutant.line)


def _where(source: _Source, begin: int) -> str:
    column = begin - source.text.rfind("\n", 0, begin)
    return f" at column {column}"


def _code(tree: ast.AST) -> Iterator[ast.AST]:
    """The nodes that do something."""
    yield tree
    for name, value in ast.iter_fields(tree):
        if name in ("annotation", "returns", "decorator_list", "bases"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and not isinstance(child, ast.JoinedStr):
                yield from _code(child)


def _changes(node: ast.AST, source: _Source) -> Iterator[tuple[str, int, int, str]]:
    if isinstance(node, ast.Compare):
        left = node.left
        for operator, right in zip(node.ops, node.comparators, strict=True):
            old, others = _COMPARISONS[type(operator)]
            yield from (
                ("comparison", *span, new)
                for span in _tokens(source, source.end(left), source.begin(right), old)
                for new in others
            )
            left = right
    elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
        yield "call", source.begin(node), source.end(node), "pass"
    elif isinstance(node, ast.Raise):
        yield "other", source.begin(node), source.end(node), "pass"
    elif isinstance(node, ast.BoolOp):
        old, new = ("and", "or") if isinstance(node.op, ast.And) else ("or", "and")
        for left, right in zip(node.values, node.values[1:], strict=False):
            yield from (
                ("other", *span, new)
                for span in _tokens(source, source.end(left), source.begin(right), old)
            )
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        yield "other", source.begin(node), source.begin(node.operand), ""
    elif isinstance(node, ast.BinOp) and type(node.op) in _ARITHMETIC:
        old, new = _ARITHMETIC[type(node.op)]
        yield from (
            ("other", *span, new)
            for span in _tokens(source, source.end(node.left), source.begin(node.right), old)
        )
    elif isinstance(node, ast.Constant) and type(node.value) in (bool, int, float):
        old = source.text[source.begin(node) : source.end(node)]
        new = str(not node.value) if isinstance(node.value, bool) else f"({old} * 2 + 1)"
        yield "other", source.begin(node), source.end(node), new


def _tokens(source: _Source, begin: int, end: int, token: str) -> Iterator[tuple[int, int]]:
    """Where an operator stands between two operands."""
    words = r"\s+".join(re.escape(word) for word in token.split())
    match = re.search(words, source.text[begin:end])
    if match is not None:
        yield begin + match.start(), begin + match.end()
