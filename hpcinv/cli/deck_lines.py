"""Lines of what a deck says and a reader does not know."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

_KEYWORD = re.compile(r"\*([A-Z][A-Z0-9 ]*)(?:, ([A-Z][A-Z0-9 ]*))?(?:, which .*)?")
_TAG = re.compile(r"<(\w+)>")
_COMMAND = re.compile(r"[/*]?[A-Z][A-Z0-9]*")
_MOST = 3
"""lines that are listed"""


def lines_of(entry: str, path: Path) -> str:
    """Return the lines of a keyword, an element or a command in a file, as the end of a message; empty if none is."""
    from hpcinv.base.quantity.csv_rows import text_of
    from hpcinv.base.reading.deck_includes import LONGEST_TEXT

    pattern = _pattern(entry, path.suffix.lower())
    if pattern is None:
        return ""
    numbers = list(_numbers(pattern, text_of(path, LONGEST_TEXT).splitlines()))
    if not numbers:
        return ""
    more = f" and {len(numbers) - _MOST} more" if len(numbers) > _MOST else ""
    return f", line {', '.join(map(str, numbers[:_MOST]))}{more}"


def _pattern(entry: str, suffix: str) -> re.Pattern[str] | None:
    """Return what a line with an entry begins with; ``None`` for entries that say more than a name."""
    if suffix == ".feb":
        found = _TAG.fullmatch(entry)
        return None if found is None else re.compile(rf"\s*<{found[1]}[\s/>]")
    if suffix == ".inp":
        found = _KEYWORD.fullmatch(entry)
        if found is None:
            return None
        name = r"\s*".join(map(re.escape, found[1].split()))
        option = "" if found[2] is None else r".*,\s*" + r"\s*".join(map(re.escape, found[2].split()))
        return re.compile(rf"\s*\*\s*{name}\s*(?=,|$){option}", re.IGNORECASE)
    return re.compile(rf"\s*{re.escape(entry)}\s*(?:,|$)", re.IGNORECASE) if _COMMAND.fullmatch(entry) else None


def _numbers(pattern: re.Pattern[str], lines: Sequence[str]) -> Iterator[int]:
    yield from (number for number, line in enumerate(lines, 1) if pattern.match(line))
