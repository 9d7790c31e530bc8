"""Plugin of pytest that records the lines of `hpcinv` that each test executes, a file for each process.

``benchmarks/mutants.py --record`` switches it on, and reads the files.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from time import monotonic
from typing import Any

import pytest

from helpers import executed_lines
from helpers.batches import Batch
from helpers.executed_lines import Lines
from hpcinv.base.parallel.runtime import MPI

OUTSIDE = ""
"""Name of what runs in no test: imports, and the collection of tests."""


def add(lines: Lines, more: Lines) -> None:
    """Add lines to others."""
    for name, numbers in more.items():
        lines.setdefault(name, set()).update(numbers)


class LineRecorder:
    """Appends a line of JSON for each test that has passed: test, seconds, ranks, lines (bits of a number, by file).

    What a fixture of several tests executes belongs to each test that uses it.
    """

    def __init__(self, directory: Path, in_batches: Mapping[str, Batch]) -> None:
        self._file = (directory / f"{os.getpid()}.jsonl").open("a")
        self._in_batches = in_batches
        self._shared = dict[pytest.FixtureDef[Any], Lines]()
        self._lines, self._began, self._failed = Lines(), 0.0, False

    def _write(self, test: str, seconds: float) -> None:
        lines = {name: f"{sum(1 << number for number in numbers):x}" for name, numbers in self._lines.items()}
        record = {"test": test, "seconds": round(seconds, 3), "ranks": MPI.COMM_WORLD.size, "lines": lines}
        print(json.dumps(record), file=self._file, flush=True)

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[Any]:
        """Record one test."""
        self._lines = executed_lines.restarted()
        self._write(OUTSIDE, 0.0)
        self._lines, self._began, self._failed = Lines(), monotonic(), False
        result = yield
        add(self._lines, executed_lines.restarted())
        for name in getattr(item, "fixturenames", ()):
            for fixture in item._fixtureinfo.name2fixturedefs.get(name, ()):  # type: ignore[attr-defined]
                add(self._lines, self._shared.get(fixture, {}))
        runs_elsewhere = item.nodeid in self._in_batches and len(self._in_batches[item.nodeid].tests) > 1
        if not self._failed and not runs_elsewhere:
            self._write(item.nodeid, monotonic() - self._began)
        return result

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Note a failure: such a test shows no fault."""
        self._failed |= not report.passed

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: pytest.FixtureDef[Any]) -> Iterator[Any]:
        """Keep what a fixture of several tests executes."""
        if fixturedef.scope == "function":
            return (yield)
        add(self._lines, executed_lines.restarted())
        before, self._lines = self._lines, Lines()
        try:
            return (yield)
        finally:
            add(self._lines, executed_lines.restarted())
            self._shared[fixturedef] = self._lines
            add(before, self._lines)
            self._lines = before
