"""Tests that reach a fault: those that execute its lines, as recorded, or else those whose imports reach its file."""

from __future__ import annotations

import ast
import json
import re
from collections import defaultdict, deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache
from hashlib import sha1
from itertools import chain
from pathlib import Path
from typing import Any

from planted_faults import ROOT, Fault

START_OF_RANKS = 5.0
"""Seconds that a test on several ranks takes besides its own; the tests of a run share them."""
SOURCES = "sources.json"
"""File of the records: digests of the files of `hpcinv` whose lines were recorded."""


def imports_of(file: Path, modules: Mapping[str, Path]) -> set[Path]:
    """Return the files among ``modules`` (by name) that a file imports anywhere, also by a text ``MODULE:NAME``."""
    names = set[str]()
    for node in ast.walk(ast.parse(file.read_bytes())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            names.add(node.value.partition(":")[0])
    return {modules[name] for name in names if name in modules}


@cache
def importers_of(root: Path) -> Mapping[Path, set[Path]]:
    """Return the files that import each file of the project, and its tests."""
    modules = dict[str, Path]()
    for base in (root, root / "tests", root / "benchmarks"):
        for file in [*base.glob("hpcinv/**/*.py"), *base.glob("helpers/*.py"), *base.glob("*.py")]:
            name = ".".join(file.relative_to(base).with_suffix("").parts)
            modules[name.removesuffix(".__init__")] = file
    importers = defaultdict[Path, set[Path]](set)
    tests = set((root / "tests").rglob("test_*.py"))
    for file in {*modules.values(), *tests}:
        for imported in imports_of(file, modules):
            importers[imported].add(file)
    for file in modules.values():  # packages import all their modules by name, as laws and effects do
        if file.name != "__init__.py":
            importers[file].add(file.with_name("__init__.py"))
    for file in root.glob("hpcinv/cli/*.py"):  # commands are imported by their names
        importers[file].add(root / "hpcinv" / "__main__.py")
    return importers


def distances(module: Path, root: Path = ROOT) -> dict[Path, int]:
    """Return the number of imports between a module and each test file that reaches it."""
    found, queue = {root / module: 0}, deque([root / module])
    while queue:
        for file in importers_of(root).get(here := queue.popleft(), ()):
            if file not in found:
                found[file] = found[here] + 1
                queue.append(file)
    names = {file.relative_to(root): distance for file, distance in found.items()}
    return {file: distance for file, distance in names.items() if file.name.startswith("test_")}


@dataclass(frozen=True)
class Place:
    """Where a fault is.

    Attributes:
        lines: numbers of its lines, or of its statement if that alone has byte code.
        scope: lines of the class around it, or of the file.
        is_in_class: whether there is a class.
        runs_at_import: whether it runs once in a process, when its file is imported.
        is_kept: whether its function keeps its results, so that only the first test executes it.
        names: what its statement assigns, if it runs at import.
    """

    lines: range
    statement: range
    scope: range
    is_in_class: bool
    runs_at_import: bool
    is_kept: bool
    names: tuple[str, ...]


def _begin(node: ast.stmt) -> int:
    decorators: list[ast.expr] = getattr(node, "decorator_list", [])
    return min([node.lineno, *(decorator.lineno for decorator in decorators)])


def place_of(fault: Fault, root: Path = ROOT) -> Place:
    """Return where a fault is in its file."""
    source = (root / fault.path).read_bytes()
    first, last = (1 + source.count(b"\n", 0, byte) for byte in (fault.begin, fault.end))
    tree = ast.parse(source)
    statements = (node for node in ast.walk(tree) if isinstance(node, ast.stmt))
    around = [node for node in statements if _begin(node) <= first <= (node.end_lineno or node.lineno)]
    blocks = [node for node in around if first >= _begin(getattr(node, "body", [tree.body[-1]])[0])]
    classes = [node for node in blocks if isinstance(node, ast.ClassDef)]
    functions = [node for node in blocks if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)]
    scope = (
        range(_begin(classes[-1]), (classes[-1].end_lineno or 0) + 1) if classes else range(1, source.count(b"\n") + 2)
    )
    inner = around[-1]
    end = _begin(inner.body[0]) - 1 if getattr(inner, "body", None) else inner.end_lineno or last  # type: ignore[attr-defined]
    stored = (n for n in ast.walk(inner) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store))
    return Place(
        lines=range(first, last + 1),
        statement=range(_begin(inner), max(end, first) + 1),
        scope=scope,
        is_in_class=bool(classes),
        runs_at_import=not functions,
        is_kept=any("cache" in ast.unparse(decorator) for f in functions for decorator in f.decorator_list),
        names=() if functions else tuple(n.id for n in stored),
    )


def _names(test: str, file: Path) -> bool:
    """Return whether the id of a test names a file, such as ``arruda-boyce`` does."""
    return file.stem in test.replace("-", "_")


def mask(lines: Iterable[int]) -> int:
    """Return a number that has the bits of these lines."""
    return sum(1 << line for line in set(lines))


@dataclass
class Test:
    """A test as recorded.

    Attributes:
        seconds: what it takes, with its share in a start of several ranks.
        lines: mask of the lines that it executes, in base 16, by file.
    """

    seconds: float
    lines: dict[str, str] = field(default_factory=dict)

    def executes(self, file: str, lines: int) -> bool:
        """Return whether it executes any of the lines of a mask."""
        return bool(int(self.lines.get(file, "0"), 16) & lines)

    def add(self, file: str, lines: int) -> None:
        """Add lines of a mask."""
        self.lines[file] = f"{int(self.lines.get(file, '0'), 16) | lines:x}"


def write_sources(directory: Path, root: Path = ROOT) -> None:
    """Keep the digests of the files whose lines were recorded."""
    (directory / SOURCES).write_text(json.dumps(_digests(root)))


def _digests(root: Path) -> dict[str, str]:
    files = sorted((root / "hpcinv").rglob("*.py"))
    return {str(file.relative_to(root)): sha1(file.read_bytes()).hexdigest() for file in files}


class Record:
    """Lines that tests execute.

    Args:
        directory: of the record
        root: of the project; where its files have changed since, a test executes all lines of a file or none

    Raises:
        FileNotFoundError: if there is no complete record
    """

    def __init__(self, directory: Path, root: Path = ROOT) -> None:
        self.root, self.tests, self._outside = root, dict[str, Test](), Test(0.0)
        recorded = json.loads((directory / SOURCES).read_text())
        now = _digests(root)
        self.changed = {file for file in recorded if recorded[file] != now.get(file)}
        for path in sorted(directory.glob("*.jsonl")):
            for text in path.read_text().splitlines():
                self._read(json.loads(text))
        for path in sorted(directory.glob("*.lines")):  # of processes that tests have started
            for block in path.read_text().split("\n\n"):
                test, *lines = block.strip("\n").split("\n")
                if test in self.tests:
                    self._read_lines(test, lines)

    def _read(self, line: dict[str, Any]) -> None:
        name, seconds = line["test"], line["seconds"] + START_OF_RANKS * (line["ranks"] > 1)
        test = self.tests.setdefault(name, Test(seconds)) if name else self._outside
        test.seconds = max(test.seconds, seconds)
        for file, lines in line["lines"].items():
            test.add(file, int(lines, 16))

    def _read_lines(self, test: str, lines: Iterable[str]) -> None:
        numbers = defaultdict[str, set[int]](set)
        for line in lines:
            file, _, number = line.partition(" ")
            if number.isdigit():
                numbers[file].add(int(number))
        for file, found in numbers.items():
            self.tests[test].add(file, mask(found))

    def executing(self, file: Path, lines: Iterable[int]) -> set[str]:
        """Return the tests that execute any of these lines."""
        wanted = -1 if str(file) in self.changed else mask(lines)
        return {name for name, test in self.tests.items() if test.executes(str(file), wanted)}

    def reaching(self, fault: Fault) -> set[str]:
        """Return the tests that execute a fault; for one that runs at an import, those that use what it makes."""
        place = place_of(fault, self.root)
        found = self.executing(fault.path, place.lines) or self.executing(fault.path, place.statement)
        if found and not (place.is_kept or place.runs_at_import):  # a command that a test starts imports the file, too
            return found
        is_outside = self._outside.executes(str(fault.path), mask(place.statement))
        if not (place.runs_at_import or is_outside or place.is_kept):
            return found
        found |= self.executing(fault.path, place.scope) | self._using(fault.path, place)
        found |= {name for name in self.tests if _names(name, fault.path)}
        found = found or self.executing(fault.path, range(100_000))
        near = distances(fault.path, self.root)
        closest = {str(file) for file, distance in near.items() if distance == min(near.values())}
        return found or {name for name in self.tests if name.partition("::")[0] in closest}

    def _using(self, file: Path, place: Place) -> set[str]:
        """Return the tests that execute a line with one of the names of a class, or of a module and its importers."""
        if not place.names:
            return set()
        if place.is_in_class:
            users, before = set((self.root / "hpcinv").rglob("*.py")), r"\."
        else:
            users, before = {self.root / file, *importers_of(self.root).get(self.root / file, ())}, r"\b"
        pattern = re.compile(rf"{before}(?:{'|'.join(place.names)})\b")
        found = set[str]()
        for user in users:
            if user.is_relative_to(self.root / "hpcinv") and user.is_file():
                lines = enumerate(user.read_text().splitlines(), start=1)
                numbers = [number for number, text in lines if pattern.search(text)]
                found |= self.executing(user.relative_to(self.root), numbers) if numbers else set()
        return found

    def ordered(self, fault: Fault) -> list[str]:
        """Return the tests that reach a fault: short ones and near ones by turns, of different files before others.

        Near tests name the file, or reach it by few imports.
        """
        rank, count = dict[str, int](), defaultdict[str, int](int)
        for name in sorted(self.reaching(fault), key=lambda name: (self.tests[name].seconds, name)):
            file = name.partition("::")[0]
            rank[name], count[file] = count[file], count[file] + 1
        near = {str(file): distance for file, distance in distances(fault.path, self.root).items()}

        def nearness(name: str) -> tuple[bool, int, int, float]:
            place = not _names(name, fault.path), near.get(name.partition("::")[0], len(near))
            return *place, rank[name], self.tests[name].seconds

        short = sorted(rank, key=lambda name: (rank[name], self.tests[name].seconds))
        return list(dict.fromkeys(chain.from_iterable(zip(sorted(rank, key=nearness), short, strict=True))))
