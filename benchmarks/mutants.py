"""What the daily tests catch: ``python benchmarks/mutants.py --seed 1 --count 200 [PATH ...]``.

Plants one small fault at a time into a copy of the project: a sign, a factor, a bound, a dropped term, swapped
arguments, a deleted line, a constant, a condition. Each is run against the tests whose imports reach its module,
nearest first, until one fails that passes without the fault. Prints the share that was found by folder, and the others
as diffs.
"""

from __future__ import annotations

import argparse
import ast
import difflib
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from collections import Counter, defaultdict, deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from itertools import islice
from pathlib import Path
from queue import Queue
from time import monotonic

ROOT = Path(__file__).resolve().parents[1]
TEST_FOLDERS = ("unit", "verification", "parallel", "system")
"""Each is run as if it were two imports farther than the one before."""
SWAPPED = {ast.Add: "-", ast.Sub: "+", ast.Mult: "/", ast.Div: "*"}
BOUNDS = {ast.Lt: "<=", ast.LtE: "<", ast.Gt: ">=", ast.GtE: ">", ast.Eq: "!=", ast.NotEq: "=="}
OUTCOMES = ("killed", "survived", "out of time")


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


def nearest_tests(module: Path, root: Path = ROOT) -> list[Path]:
    """Return the test files that reach a module: those that name it, then near ones, and unit tests before others."""

    def order(item: tuple[Path, int]) -> tuple[bool, int, str]:
        file, distance = item
        return module.stem not in file.stem, distance + 2 * TEST_FOLDERS.index(file.parts[1]), str(file)

    return [file for file, _ in sorted(distances(module, root).items(), key=order)]


class Copy:
    """A copy of the project in which one fault is tried at a time, with a cache of kernels of its own."""

    def __init__(self, directory: Path) -> None:
        self.root, self._cache, self._pristine = directory / "project", directory / "cache", directory / "pristine"
        listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True)
        for root in (self.root, self._pristine):
            for name in filter(None, listed.stdout.split("\0")):
                if (ROOT / name).is_file():
                    (root / name).parent.mkdir(parents=True, exist_ok=True)
                    shutil.copy2(ROOT / name, root / name)

    def tried(self, fault: Fault, limit: float) -> tuple[str, str]:
        """Return one of ``OUTCOMES``, and the test that failed."""
        file = self.root / fault.path
        source = file.read_bytes()
        shutil.rmtree(self._cache, ignore_errors=True)  # a fault may have left wrong programs there
        try:
            file.write_bytes(fault.planted(source))
            return self._outcome(nearest_tests(fault.path, self._pristine), limit)
        finally:
            file.write_bytes(source)

    def _outcome(self, tests: Sequence[Path], limit: float) -> tuple[str, str]:
        """Run the nearest file first, then more at a time: pytest imports all of them before the first test."""
        names, ends = [str(test) for test in tests], monotonic() + limit
        begin = 0
        for count in (1, 4, 20, len(names)):
            some, begin = names[begin : begin + count], begin + count
            fails_anyway = list[str]()
            while some:
                done = self._pytest(self.root, [*some, *fails_anyway], ends - monotonic())
                if done is None:
                    return "out of time", ""
                if done.returncode in (0, 5):
                    break
                failed = re.findall(r"^(?:FAILED|ERROR) (\S+?\.py(?:::.*?)?)(?: - .*)?$", done.stdout, re.M)
                without = self._pytest(self._pristine, failed, limit) if failed else None
                if without is None or without.returncode == 0:
                    return "killed", failed[0] if failed else "pytest ended"
                fails_anyway += ["--deselect=" + name for name in failed]
        return "survived", ""

    def _pytest(self, root: Path, names: Sequence[str], limit: float) -> subprocess.CompletedProcess[str] | None:
        command = [sys.executable, "-m", "pytest", "-n", "0", "-x", "-q", "--tb=no", "-p", "no:cacheprovider", *names]
        environment = os.environ | {"PYTHONPATH": str(root), "XDG_CACHE_HOME": str(self._cache)}
        with subprocess.Popen(
            command, cwd=root, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
            start_new_session=True,
        ) as process:  # fmt: skip
            try:
                output, _ = process.communicate(timeout=max(limit, 1.0))
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                return None
        return subprocess.CompletedProcess(command, process.returncode, output)


def folder_of(fault: Fault) -> str:
    """Return the package of a fault, such as ``hpcinv/physics/materials``."""
    return str(fault.path.parent)


def table(results: Iterable[tuple[Fault, str]]) -> Iterator[str]:
    """Yield a line for each folder, and one for all: faults by outcome, and the share that was killed."""
    counts = defaultdict[str, Counter[str]](Counter)
    for fault, outcome in results:
        for name in (folder_of(fault), "all"):
            counts[name][outcome] += 1
    yield f"{'':28}" + "".join(f"{name:>13}" for name in (*OUTCOMES, "share killed"))
    for name in sorted(counts, key=lambda name: (name == "all", name)):
        share = counts[name]["killed"] / counts[name].total()
        yield f"{name:28}" + "".join(f"{counts[name][outcome]:13}" for outcome in OUTCOMES) + f"{share:13.0%}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=200, help="number of faults")
    parser.add_argument("--limit", type=float, default=600.0, help="seconds for the tests of a fault")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="faults that are tried at a time")
    parser.add_argument("paths", nargs="*", type=Path, default=[Path("hpcinv")], help="files and folders of faults")
    options = parser.parse_args()
    faults = drawn(options.paths, options.seed, options.count)
    results = list[tuple[Fault, str]]()
    with tempfile.TemporaryDirectory() as temporary, ThreadPoolExecutor(options.jobs) as pool:
        copies = Queue[Copy]()
        for number in range(options.jobs):
            copies.put(Copy(Path(temporary) / str(number)))

        def tried(fault: Fault) -> tuple[Fault, str, str]:
            copy = copies.get()
            try:
                return (fault, *copy.tried(fault, options.limit))
            finally:
                copies.put(copy)

        for fault, outcome, by in pool.map(tried, faults):
            results.append((fault, outcome))
            print(f"{outcome:12} {fault.diff(ROOT) if outcome != 'killed' else f'{fault.path}: {fault.kind}, {by}'}")
            sys.stdout.flush()
    print("", *table(results), sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
