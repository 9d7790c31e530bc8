"""Count oddities in prose, comments and messages: ``docs/prose.py [-v] [path …]``; exit code 1 above `MOST`."""

import ast
import io
import re
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
MOST = {"docs": 0, "hpcinv": 0, "benchmarks": 5, "meshes": 0, "tests": 2}
MOST |= dict.fromkeys(("README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "CHANGELOG.md"), 0)
"""allowed oddities; lower these numbers after each clean-up"""
GENERATED = ("docs/reference/", "docs/notes/", "docs/verification/published.md", "docs/prose.py")
ODDITIES = re.compile(
    r"\b(?:that|those) of\b|(?<!there )\b(?:is|are|was|were) no\b(?! longer| more| need)|\btells?\b|\btold\b"
    r"|, (?:by|of|from|in|with|for|to|on|at) (?:which|whose|whom)\b|\bbeside\b|\bin place of\b",
    re.IGNORECASE,
)
TWO_COLONS = re.compile(r":\s[^.:;!?\n]*:\s")  # on pages: docstrings have sections
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
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    yield from ((token.start[0], token.string) for token in tokens if token.type == tokenize.COMMENT)
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value:
            yield node.lineno, node.value


def oddities(page: Path) -> Iterator[str]:
    """Yield each oddity of a page or module with its place."""
    for line, paragraph in texts(page):
        text = re.sub(r"`+[^`]*`+|\$[^$]*\$|\]\([^)]*\)", "x", paragraph)
        found = [match.group() for match in ODDITIES.finditer(text)]
        if page.suffix == ".md":
            sentences = re.split(r"(?<=[.!?:;])\s+", text)
            found += TWO_COLONS.findall(text) + [part for part in sentences if len(part.split()) > MOST_WORDS]
        yield from (f"{page.relative_to(ROOT)}:{line}: {' '.join(words.split())}" for words in found)


failed = False
for top, most in MOST.items():
    pages = sorted([*(ROOT / top).rglob("*.md"), *(ROOT / top).rglob("*.py")]) or [ROOT / top]
    odd = [o for page in pages if not str(page.relative_to(ROOT)).startswith(GENERATED) for o in oddities(page)]
    shown = [o for o in odd if "-v" in sys.argv and o.startswith(tuple(sys.argv[2:]) or "")]
    print(*shown, f"{top}: {len(odd)} of at most {most}", sep="\n")
    failed |= len(odd) > most
sys.exit(failed)
