"""Plugin of pytest that records what each test takes, one file for each process: `tests/durations.py` reads them."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import suppress
from os import scandir, stat, times  # as they are: tests replace them in their modules
from pathlib import Path
from time import monotonic, process_time
from typing import Any

import pytest

from helpers.batches import IN_BATCH, Batch
from hpcinv.base.parallel import c_code, code_cache

START = "(start of processes)"
"""What a process takes until its tests are collected."""
BETWEEN = 30.0
"""Seconds between two reference calculations. Fewer follow the machine's speed less closely."""


def cpu() -> tuple[float, float]:
    """Processor time in s: of this process and of the children that it has waited for."""
    now = times()
    return now.user + now.system, now.children_user + now.children_system


def reference() -> float:
    """Processor time in s of a fixed calculation, the unit of budgets: about 0.1 s."""
    before = process_time()
    numbers: dict[int, str] = {}
    for i in range(400_000):
        numbers[i * 7919 % 65536] = str(i)
    return process_time() - before


class Recorder:
    """Appends a line of JSON for each phase of each test.

    Keys: test, phase, wall, self and children (processor time in s), compiled (names of the kernels that this process
    compiled), compiling (its and the compiler's processor time for them in s), seen (names of other kernels that
    appeared in the cache). A line ``{"reference": s}`` follows from time to time.
    """

    def __init__(self, directory: Path, in_batches: Mapping[str, Batch]) -> None:
        self._file = (directory / f"{os.getpid()}.jsonl").open("a")
        self._in_batches, self._referred = in_batches, -BETWEEN
        self._compiled, self._compiling = list[str](), 0.0
        self._cache, self._changed = str(code_cache.directory()), 0
        self._kernels = self._cached()
        compiled = c_code._compiled

        def timed(code: str, name: str, *arguments: Any) -> Path:
            before = sum(cpu())
            try:
                made = compiled(code, name, *arguments)
            finally:
                self._compiling += sum(cpu()) - before
            self._compiled.append(name)
            return made

        c_code._compiled = timed  # type: ignore[assignment]

    def pytest_collection_finish(self, session: pytest.Session) -> None:
        """Record what imports and the collection took."""
        own, children = cpu()
        line: dict[str, Any] = {"test": START, "phase": "start", "wall": own, "self": own, "children": children}
        self._write(line | {"compiled": [], "compiling": 0.0, "seen": []})

    def _phase(self, test: str, phase: str) -> Iterator[None]:
        wall, (own, children), compiling = monotonic(), cpu(), self._compiling
        try:
            return (yield)
        finally:
            with suppress(Exception):  # whatever a test has replaced: its record is missing, and it does not fail
                ended_own, ended_children = cpu()
                cached = self._cached()
                line: dict[str, Any] = {"test": test, "phase": phase, "wall": monotonic() - wall}
                line |= {"self": ended_own - own, "compiling": self._compiling - compiling}
                # The ranks of a batch record their tests themselves.
                is_in_batch = test in self._in_batches and len(self._in_batches[test].tests) > 1
                line |= {"children": 0.0 if is_in_batch else ended_children - children}
                line |= {"compiled": self._compiled, "seen": sorted(cached - self._kernels - set(self._compiled))}
                self._write(line)
                self._kernels, self._compiled = self._kernels | cached, []
                if monotonic() - self._referred > BETWEEN:
                    self._write({"reference": reference()})
                    self._referred = monotonic()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> Iterator[None]:
        return (yield from self._phase(item.nodeid, "setup"))

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self, item: pytest.Item) -> Iterator[None]:
        return (yield from self._phase(item.nodeid, "call"))

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_teardown(self, item: pytest.Item) -> Iterator[None]:
        return (yield from self._phase(item.nodeid, "teardown"))

    def _cached(self) -> set[str]:
        """Names of the kernels in the cache, which children have written too; none if nothing has changed there."""
        try:
            changed = stat(self._cache).st_mtime_ns  # noqa: PTH116 (tests replace os.stat, which Path.stat calls)
            if IN_BATCH in os.environ or changed == self._changed:
                return set()
            self._changed = changed
            return {entry.name[:-3] for entry in scandir(self._cache) if entry.name.endswith(".so")}
        except OSError:  # there is no cache yet
            return set()

    def _write(self, line: dict[str, Any]) -> None:
        print(json.dumps(line), file=self._file, flush=True)
