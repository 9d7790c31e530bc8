"""One of several parts of the selected tests, of about equal length: ``pytest -m release --part 2/8``."""

from __future__ import annotations

import re
import subprocess
from collections import defaultdict
from collections.abc import Iterable, Mapping
from pathlib import Path

import pytest

SECONDS: Mapping[str, float] = {
    "tests/system/test_pages.py": 80.0,
    "tests/system/test_tutorials.py": 60.0,
    "tests/verification/test_equalities.py": 40.0,
    "tests/verification/test_products_with_derivatives.py": 40.0,
    "tests/verification/test_shell_strips.py": 30.0,
    "tests/verification/test_shells_of_revolution.py": 30.0,
    "tests/verification/test_published.py": 30.0,
}
"""What a test of a file takes, where that is far from ``USUAL``. The parts differ more in length if they are wrong."""
USUAL = 6.0
"""Seconds of any other test."""


def parsed(text: str, commits: int) -> tuple[int, int]:
    """Return number and count of the parts that ``K/N`` means; for ``auto/N``, each commit has the next part.

    Raises:
        ValueError: if ``text`` is neither, or there is no such part
    """
    match = re.fullmatch(r"(auto|\d+)/(\d+)", text)
    count = int(match[2]) if match else 0
    number = (commits % max(count, 1) + 1 if match[1] == "auto" else int(match[1])) if match else 0
    if not 1 <= number <= count:
        raise ValueError(f"--part {text}: must be K/N or auto/N, with K from 1 to N")
    return number, count


def ids_of_part(tests: Iterable[str], number: int, count: int) -> set[str]:
    """Return the tests of a part: each file, from the longest on, goes to the part that is shortest so far.

    Tests of a file that is longer than a part are divided, each by itself.

    Args:
        tests: ids of all tests
    """
    files: dict[str, list[str]] = defaultdict(list)
    for test in sorted(tests):
        files[test.partition("::")[0]].append(test)
    each = {file: SECONDS.get(file, USUAL) for file in files}
    average = sum(each[file] * len(own) for file, own in files.items()) / count
    portions = [(each[file] * len(own), own) for file, own in files.items() if each[file] * len(own) <= average]
    divided = [file for file, own in files.items() if each[file] * len(own) > average]
    portions += [(each[file], [test]) for file in divided for test in files[file]]
    lengths, parts = [0.0] * count, [set[str]() for _ in range(count)]
    for seconds, own in sorted(portions, key=lambda portion: (-portion[0], portion[1])):
        shortest = lengths.index(min(lengths))
        parts[shortest].update(own)
        lengths[shortest] += seconds
    return parts[number - 1]


class Part:
    """Plugin of pytest that selects a part of the tests that other options have left."""

    def __init__(self, text: str, root: Path) -> None:
        counted = subprocess.run(["git", "rev-list", "--count", "HEAD"], cwd=root, capture_output=True, text=True)
        commits = int(counted.stdout or 0)
        try:
            self.number, self.count = parsed(text, commits)
        except ValueError as error:
            raise pytest.UsageError(str(error)) from None
        self.reason = f", by the number of commits, {commits}" if text.startswith("auto") else ""

    def pytest_report_header(self) -> str:
        """Say which part this is."""
        return f"part {self.number} of {self.count} of the selected tests{self.reason}"

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, config: pytest.Config, items: list[pytest.Item]) -> None:
        """Leave the part."""
        kept = ids_of_part((item.nodeid for item in items), self.number, self.count)
        config.hook.pytest_deselected(items=[item for item in items if item.nodeid not in kept])
        items[:] = [item for item in items if item.nodeid in kept]
