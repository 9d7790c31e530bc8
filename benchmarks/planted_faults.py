"""Small faults that can be planted into a file: a sign, a factor, a bound, a dropped term, a condition, and others."""

from __future__ import annotations

import ast
import difflib
import random
import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SWAPPED = {ast.Add: "-", ast.Sub: "+", ast.Mult: "/", ast.Div: "*"}
BOUNDS = {ast.Lt: "<=", ast.LtE: "<", ast.Gt: ">=", ast.GtE: ">", ast.Eq: "!=", ast.NotEq: "=="}


@dataclass(frozen=True)
class Fault:
    """A part of a file from ``begin`` to ``end`` (bytes), and what is put there instead."""

    path: Path
    kind: str
    begin: int
    end: int
    text: str

    def planted(self, source: bytes) -> bytes:
        """Return the source with the fault."""
        return source[: self.begin] + self.text.encode() + source[self.end :]

    def diff(self, root: Path) -> str:
        """Return the fault as a diff without context."""
        source = (root / self.path).read_bytes()
        before, after = (text.decode().splitlines() for text in (source, self.planted(source)))
        lines = list(difflib.unified_diff(before, after, lineterm="", n=0))[2:]
        return "\n".join([f"{self.path}: {self.kind}", *lines])


class _Faults(ast.NodeVisitor):
    """Collects the faults of a file; annotations, docstrings and what only makes messages have none."""

    def __init__(self, path: Path, source: bytes) -> None:
        self.path, self.source, self.found = path, source, list[Fault]()
        self._lines = [0]
        for line in source.splitlines(keepends=True):
            self._lines.append(self._lines[-1] + len(line))

    def _span(self, node: ast.expr | ast.stmt) -> tuple[int, int]:
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        return self._lines[node.lineno - 1] + node.col_offset, self._lines[node.end_lineno - 1] + node.end_col_offset

    def _text(self, node: ast.expr | ast.stmt) -> str:
        begin, end = self._span(node)
        return self.source[begin:end].decode()

    def _add(self, kind: str, node: ast.expr | ast.stmt, text: str) -> None:
        self.found.append(Fault(self.path, kind, *self._span(node), text))

    def _between(self, kind: str, left: ast.expr, right: ast.expr, pattern: str, text: str) -> None:
        """Replace the operator between two expressions."""
        begin, end = self._span(left)[1], self._span(right)[0]
        if match := re.search(pattern, self.source[begin:end].decode()):
            place = begin + len(self.source[begin:end].decode()[: match.start()].encode())
            self.found.append(Fault(self.path, kind, place, place + len(match[0].encode()), text))

    def visit_BinOp(self, node: ast.BinOp) -> None:
        if isinstance(node.left, ast.JoinedStr) or isinstance(getattr(node.left, "value", None), str):
            return
        if text := SWAPPED.get(type(node.op)):
            kind = "sign" if isinstance(node.op, ast.Add | ast.Sub) else "factor"
            self._between(kind, node.left, node.right, r"[-+*/]", text)
        if isinstance(node.op, ast.Add | ast.Sub):
            self._add("dropped term", node, self._text(node.left))
        self.generic_visit(node)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> None:
        if isinstance(node.op, ast.USub | ast.Not):
            self._add("sign" if isinstance(node.op, ast.USub) else "condition", node, f"({self._text(node.operand)})")
        self.generic_visit(node)

    def visit_Compare(self, node: ast.Compare) -> None:
        if text := BOUNDS.get(type(node.ops[0])):
            self._between("bound", node.left, node.comparators[0], "[<>=!]=?", text)
        self.generic_visit(node)

    def visit_BoolOp(self, node: ast.BoolOp) -> None:
        is_and = isinstance(node.op, ast.And)
        self._between("condition", node.values[0], node.values[1], r"\b(and|or)\b", "or" if is_and else "and")
        self.generic_visit(node)

    def visit_If(self, node: ast.If) -> None:
        self._add("condition", node.test, f"not ({self._text(node.test)})")
        self.generic_visit(node)

    def visit_Call(self, node: ast.Call) -> None:
        plain = [argument for argument in node.args if not isinstance(argument, ast.Starred)]
        if len(plain) == len(node.args) >= 2 and self._text(plain[0]) != self._text(plain[1]):
            first, second = plain[:2]
            between = self.source[self._span(first)[1] : self._span(second)[0]].decode()
            begin, end = self._span(first)[0], self._span(second)[1]
            text = f"{self._text(second)}{between}{self._text(first)}"
            self.found.append(Fault(self.path, "swapped arguments", begin, end, text))
        self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> None:
        if isinstance(node.value, bool):
            self._add("constant", node, str(not node.value))
        elif isinstance(node.value, int):
            self._add("constant", node, str(node.value + 1))
        elif isinstance(node.value, float):
            self._add("factor", node, repr(2 * node.value) if node.value else "1.0")

    def _visit_statement(self, node: ast.Assign | ast.AugAssign | ast.Expr) -> None:
        is_text = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        if is_text:
            return
        if node.col_offset:  # a name of a module that is missing fails at its import
            self._add("deleted line", node, "pass")
        self.generic_visit(node)

    visit_Assign = visit_AugAssign = visit_Expr = _visit_statement  # noqa: N815 (names of ast)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        if node.value:
            self.visit(node.value)

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        for part in (*node.args.defaults, *filter(None, node.args.kw_defaults), *node.body):
            self.visit(part)

    def visit_Raise(self, node: ast.Raise) -> None:
        self._add("deleted line", node, "pass")

    def visit_JoinedStr(self, node: ast.JoinedStr) -> None:
        """Texts are not changed."""

    def visit_TypeAlias(self, node: ast.TypeAlias) -> None:
        """Types are checked by mypy."""


def faults_of(path: Path, root: Path = ROOT) -> list[Fault]:
    """Return all faults that can be planted into a file; some do not compile."""
    source = (root / path).read_bytes()
    visitor = _Faults(path, source)
    visitor.visit(ast.parse(source))
    return visitor.found


def is_program(fault: Fault, root: Path = ROOT) -> bool:
    """Return whether the file compiles with the fault."""
    try:
        compile(fault.planted((root / fault.path).read_bytes()), "", "exec", dont_inherit=True)
    except (SyntaxError, ValueError):
        return False
    return True


def drawn(paths: Sequence[Path], seed: int, count: int, root: Path = ROOT) -> list[Fault]:
    """Return random faults of the files below ``paths``: each place has the same chance."""
    files = sorted({file for path in paths for file in ([path] if path.suffix else (root / path).rglob("*.py"))})
    faults = [
        fault for file in files for fault in faults_of(file.relative_to(root) if file.is_absolute() else file, root)
    ]
    random.Random(seed).shuffle(faults)
    return list(islice((fault for fault in faults if is_program(fault, root)), count))
