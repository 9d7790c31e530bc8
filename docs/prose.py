"""Count oddities of prose in pages, docstrings, comments and messages: ``python docs/prose.py [-v] [path …]``.

It ends with exit code 1 if a directory has more of them than `MOST`.
"""

import ast
import io
import re
import sys
import tokenize
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
MOST = {"docs": 0, "hpcinv": 2, "benchmarks": 5, "meshes": 0, "tests": 4}
MOST |= dict.fromkeys(("README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "CHANGELOG.md"), 0)
"""allowed oddities; lower these numbers after each clean-up"""
GENERATED = ("docs/reference/", "docs/notes/", "docs/verification/published.md", "docs/prose.py")
ODDITIES = {
    "that of": r"\b(?:that|those) of\b",
    "is no": r"(?<!there )\b(?:is|are|was|were) no\b(?! longer| more| need)",
    "of which": r", (?:by|of|from|in|with|for|to|on|at) (?:which|whose|whom)\b",
    "beside": r"\bbeside\b",
    "tells": r"\b(?:tells?|told)\b",
    "in place of": r"\bin place of\b",
    "two colons": r":\s[^.:;!?\n]*:\s",
}
MOST_WORDS = 30  # of a sentence on a page; more lets sentences pass that need a second reading


def texts(path: Path) -> Iterator[tuple[int, str]]:
    """Yield line and text of each paragraph of a page, or of each comment and string of a module."""
    source = path.read_text()
    if path.suffix == ".md":
        skipped = re.compile(r"^```.*?^```|<!--.*?-->|\$\$.*?\$\$|^ {4}.*?$", re.M | re.S)
        source = skipped.sub(lambda match: "\n" * match.group().count("\n"), source)
        for match in re.finditer(r"^(?![|#>\n]).+(?:\n(?!\s*(?:[-*|#>]|\d+\.) |\n).+)*", source, re.M):
            yield source.count("\n", 0, match.start()) + 1, match.group()
        return
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            yield token.start[0], token.string
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value:
            yield node.lineno, node.value


def oddities(text: str, is_page: bool) -> Iterator[str]:
    """Yield the kind of each oddity of a text."""
    text = re.sub(r"`+[^`]*`+|\$[^$]*\$|\]\([^)]*\)", "x", text)
    for kind, pattern in ODDITIES.items():
        if is_page or kind != "two colons":  # sections of docstrings, keys of dictionaries
            yield from [kind] * len(re.findall(pattern, text, re.IGNORECASE))
    if is_page:
        yield from ["long sentence" for part in re.split(r"(?<=[.!?:;])\s+", text) if len(part.split()) > MOST_WORDS]


counts = Counter[tuple[str, str]]()
for directory in MOST:
    top = ROOT / directory
    for page in sorted([top] if top.is_file() else [*top.rglob("*.md"), *top.rglob("*.py")]):
        name = str(page.relative_to(ROOT))
        for line, paragraph in [] if name.startswith(GENERATED) else texts(page):
            for kind in oddities(paragraph, page.suffix == ".md"):
                counts[directory, kind] += 1
                if "-v" in sys.argv and name.startswith(tuple(sys.argv[2:]) or ""):
                    print(f"{name}:{line}: {kind}")
failed = False
for directory, most in MOST.items():
    numbers = {kind: n for (where, kind), n in counts.items() if where == directory}
    failed |= sum(numbers.values()) > most
    print(f"{directory}: {sum(numbers.values())} of at most {most} {numbers or ''}")
sys.exit(failed)
