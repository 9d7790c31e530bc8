"""Counts of the rules on names and sizes: run ``python benchmarks/house_counts.py [-v] [directory …]``."""

import ast
import re
import sys
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PREPOSITION = re.compile(
    r"_*(?:above|across|after|against|along|among|around|at|before|behind|below|beneath|beside|between|beyond|by|during"
    r"|for|from|in|inside|into|near|of|on|onto|outside|over|past|per|since|through|to|towards?|under|until|upon|with"
    r"|within|without)(?:_.*)?"
)
BRANCHES = (
    *(ast.If, ast.IfExp, ast.For, ast.While, ast.ExceptHandler),
    *(ast.With, ast.Assert, ast.comprehension, ast.match_case),
)
VAGUE = ("found", "one", "of", "given", "known")
# Keys of files that users write, and names that a summary, a library or authors of plugins call.
EXCUSED = re.compile(
    r"Landmark\.at|Observation\.on|QuantityOfInterest\.(?:at|on|over)|Growth\.(?:along|across)|Study\.beside"
    r"|Taken\.at_least|Quantity\.(?:above|at_least|at_most)|(?:Correction|Estimate)\.without_geometry"
    r"|Job\.with_|Result\.to_dict|(?:Run)?Console\.on_broken_pipe|\w+\.from_(?:json|names|data)"
)


def names(tree: ast.AST, scope: str = "") -> Iterator[tuple[str, str, str, int]]:
    """Yield kind (variable, function or class), name, scope and line of all that ``tree`` binds."""
    for node in ast.iter_child_nodes(tree):
        inner = scope
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            kind = "class" if isinstance(node, ast.ClassDef) else "function"
            yield kind, node.name, scope, node.lineno
            inner = f"{scope}.{node.name}"
        elif isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield "variable", node.id if isinstance(node, ast.Name) else node.attr, scope, node.lineno
        elif isinstance(node, ast.arg):
            yield "variable", node.arg, scope, node.lineno
        elif isinstance(node, ast.MatchAs) and node.name:
            yield "variable", node.name, scope, node.lineno
        yield from names(node, inner)


def complexity(function: ast.AST) -> int:
    """Return one more than the number of branches, loops, handlers and contexts of a function."""
    total = 1
    for node in ast.walk(function):
        total += isinstance(node, BRANCHES) or (len(node.values) - 1 if isinstance(node, ast.BoolOp) else 0)
    return total


def statements(tree: ast.AST) -> Iterator[ast.AST]:
    """Yield the statements below a node; expressions are 90 % of the nodes, and are not visited."""
    for blocks in ("body", "handlers", "orelse", "finalbody", "cases"):
        nodes = getattr(tree, blocks, ())
        for node in nodes if isinstance(nodes, list) else ():
            yield node
            yield from statements(node)


def dense_functions(directory: str, most: int) -> list[str]:
    """Return the places of functions whose complexity is above a number; a line has two branches at most."""
    functions = [
        (path, node)
        for path in sorted((ROOT / directory).rglob("*.py"))
        for node in statements(ast.parse(path.read_text()))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    ]
    return [
        f"{path.relative_to(ROOT)}:{node.lineno}: {node.name}"
        for path, node in functions
        if 2 * ((node.end_lineno or 0) - node.lineno) > most and complexity(node) > most
    ]


def is_prepositional(name: str, scope: str) -> bool:
    return PREPOSITION.fullmatch(name) is not None and EXCUSED.fullmatch(f"{scope}.{name}".strip(".")) is None


def count(directory: str, verbose: bool) -> None:
    """Print the counts of one directory and, if asked, the places."""
    uses: Counter[str] = Counter()
    scopes = defaultdict[str, set[tuple[str, str]]](set)
    modules, classes = defaultdict[str, set[str]](set), defaultdict[str, set[str]](set)
    lines = 0
    for path in sorted((ROOT / directory).rglob("*.py")):
        text, where = path.read_text(), str(path.relative_to(ROOT))
        lines += text.count("\n")
        if path.name not in ("__init__.py", "__main__.py"):
            modules[path.name].add(where)
        for kind, name, scope, line in names(ast.parse(text)):
            if kind == "class":
                classes[name].add(where)
            elif name in VAGUE and kind == "variable":
                uses[name] += 1
            elif is_prepositional(name, scope):
                scopes[f"{kind}s"].add((name, where + scope))
            else:
                continue
            if verbose and kind != "class":
                print(f"  {where}:{line}: {kind} {name}")
    print(f"{directory}: {lines} lines")
    print("  complexity:", ", ".join(f"above {most} {len(dense_functions(directory, most))}" for most in (12, 20)))
    print("  assigned:", ", ".join(f"{name} {uses[name]}" for name in VAGUE))
    for kind in ("variables", "functions"):
        print(
            f"  {kind} that begin with a preposition: {len({n for n, _ in scopes[kind]})} ({len(scopes[kind])} scopes)"
        )
    for what, places in (("modules", modules), ("classes", classes)):
        repeated = sorted(name for name, where in places.items() if len(where) > 1)
        print(f"  {what} of one name: {len(repeated)}", *repeated)


if __name__ == "__main__":
    chosen = [argument for argument in sys.argv[1:] if argument != "-v"]
    for each in chosen or ("hpcinv", "tests", "benchmarks"):
        count(each, "-v" in sys.argv)
