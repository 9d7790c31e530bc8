"""One start of mpiexec for several tests on the same number of ranks.

mpi-pytest starts mpiexec for each test on more than one rank, and each rank loads DOLFINx: two to three seconds of
processor time before the test begins. Here the first test of a batch runs the whole batch in one start. A test that
fails ends the ranks: it is run alone, as mpi-pytest does, and shows its failure, and what came after it is a new batch.
"""

from __future__ import annotations

import fcntl
import json
import os
import re
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path

import pytest
from pytest_mpi.plugin import CHILD_PROCESS_FLAG

from hpcinv.base.parallel.runtime import MPI

SYSTEM = Path(__file__).parents[1] / "system"
LARGEST = 200
"""Tests in a batch. More of them save starts (3 s of processor time a rank); a failure costs one more start."""
IN_BATCH = "HPCINV_TESTS_IN_BATCH"
"""Environment variable that the ranks of a batch have: files ``VALUE.RANK`` list the tests that a rank has ended."""
PROCESSORS = os.cpu_count() or 1
"""Ranks that wait for a message yield their processor. With more ranks than processors they sleep, too.

Measured on two processors, in processor time and wall time of tests: two ranks 5 s and 2.4 s, next to a busy process
7.5 s and 6.2 s, asleep 6.3 s and 10.5 s, both 11.4 s and 19 s; three ranks next to a busy process 14 s and 21 s, asleep
7.7 s and 10 s. So batches of two ranks have both processors, and larger ones sleep.
"""
QUIET = ("--tb=no", "--no-summary", "--no-header", "--disable-warnings", "--show-capture=no")


def ranks_of(item: pytest.Item) -> int:
    """Number of ranks that a test runs on, which mpi-pytest has attached as a marker."""
    marks = (re.fullmatch(r"parallel\[(\d+)\]", mark.name) for mark in item.iter_markers())
    return next((int(mark[1]) for mark in marks if mark), 1)


class Batch:
    """Tests that run on ``ranks`` ranks in one start of mpiexec."""

    def __init__(self, name: str, ranks: int, tests: list[str], root: Path) -> None:
        self.name, self.ranks, self.tests, self.root = name, ranks, tests, root

    def has_passed(self, test: str, directory: Path) -> bool:
        """Return whether a test has passed, after a run of its batch unless another worker of pytest-xdist did that.

        Args:
            directory: the one that all workers share
        """
        with (directory / f"{self.name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            results = directory / self.name
            passed = json.loads(results.read_text()) if results.exists() else {}
            if test not in passed:
                passed = self._results(directory)
                results.write_text(json.dumps(passed))
            return bool(passed[test])

    def _results(self, directory: Path) -> dict[str, bool]:
        """Run the tests up to the first that fails, what is left after it, and so on; return which have passed."""
        tests, passed = self.tests, dict[str, bool]()
        while tests:
            prefix = directory / f"{self.name}-{len(tests)}"
            if self._run(tests, prefix) == 0:
                return passed | dict.fromkeys(tests, True)
            ended = set.intersection(*(_lines(Path(f"{prefix}.{rank}")) for rank in range(self.ranks)))
            failed = next((test for test in tests if test not in ended), tests[-1])
            passed |= dict.fromkeys(ended, True) | {failed: False}
            tests = [test for test in tests if test not in passed]
        return passed

    def _run(self, tests: list[str], prefix: Path) -> int:
        common = [sys.executable, "-m", "pytest", "--runxfail", "-s", "-q"]
        command = ["mpiexec", "-n", "1", *common, *tests, ":"]
        command += ["-n", str(self.ranks - 1), *common, *QUIET, *tests]
        limit = str(300 + 10 * len(tests))  # s, below the 30 min of the whole suite
        environment = os.environ | {CHILD_PROCESS_FLAG: "1", IN_BATCH: str(prefix), "MPIEXEC_TIMEOUT": limit}
        has_processors = self.ranks <= PROCESSORS
        if not has_processors:
            environment["MPIR_CVAR_ENABLE_HEAVY_YIELD"] = "1"
        with _alone(prefix.parent) if has_processors else nullcontext():
            return subprocess.run(command, cwd=self.root, env=environment, check=False).returncode


@contextmanager
def _locked(path: Path, kind: int) -> Iterator[None]:
    with path.open("w") as lock:
        fcntl.flock(lock, kind)
        yield


@contextmanager
def _alone(directory: Path) -> Iterator[None]:
    """Context in which no other worker of pytest-xdist is `_among_others`; it waits until none is."""
    with _locked(directory / "gate.lock", fcntl.LOCK_EX), _locked(directory / "room.lock", fcntl.LOCK_EX):
        yield


@contextmanager
def _among_others(directory: Path) -> Iterator[None]:
    """Context in which other workers may be, too, unless one is `_alone`."""
    with (directory / "room.lock").open("w") as room:
        with _locked(directory / "gate.lock", fcntl.LOCK_EX):
            fcntl.flock(room, fcntl.LOCK_SH)
        yield


def _lines(path: Path) -> set[str]:
    return set(path.read_text().splitlines()) if path.exists() else set()


class RankOfBatch:
    """Plugin of pytest on a rank of a batch: a test that fails ends all ranks, since the others may wait for it."""

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """End the batch."""
        if report.failed:
            MPI.COMM_WORLD.Abort(1)

    def pytest_runtest_logfinish(self, nodeid: str) -> None:
        """Note a test that has not failed."""
        with Path(f"{os.environ[IN_BATCH]}.{MPI.COMM_WORLD.rank}").open("a") as file:
            print(nodeid, file=file)


def _order(item: pytest.Item) -> tuple[int, int]:
    ranks = ranks_of(item)
    return (0, 0) if ranks == 1 and SYSTEM in item.path.parents else (1, -ranks)


class Batches:
    """Plugin of pytest that makes batches of the selected tests and runs them."""

    def __init__(self) -> None:
        self.batch_of: dict[str, Batch] = {}

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, config: pytest.Config, items: list[pytest.Item]) -> None:
        """Make batches, and put what is long before what is short, so that no worker is left with a long test.

        Tests of the system by themselves take longest. Batches follow each other: as one worker begins with the first
        half of all tests, two batches seldom run at the same time.
        """
        rank_tests: dict[int, list[str]] = defaultdict(list)
        for item in items:
            rank_tests[ranks_of(item)].append(item.nodeid)
        rank_tests.pop(1, None)
        for ranks, tests in sorted(rank_tests.items()):
            for start in range(0, len(tests), LARGEST):
                batch = Batch(f"{ranks}-ranks-{start}", ranks, tests[start : start + LARGEST], config.rootpath)
                self.batch_of |= dict.fromkeys(batch.tests, batch)
        items.sort(key=_order)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self, item: pytest.Item) -> Iterator[None]:
        """Wait for batches that have all processors."""
        directory: Path = getattr(item, "funcargs", {}).get("shared_by_workers", None)
        waits = directory is not None and item.nodeid not in self.batch_of
        with _among_others(directory) if waits else nullcontext():
            return (yield)

    @pytest.hookimpl(tryfirst=True)
    def pytest_pyfunc_call(self, pyfuncitem: pytest.Function) -> bool | None:
        """Pass with the batch, or leave the test to mpi-pytest."""
        batch = self.batch_of.get(pyfuncitem.nodeid)
        if batch is None or len(batch.tests) == 1:
            return None
        directory: Path = pyfuncitem.funcargs["shared_by_workers"]
        return batch.has_passed(pyfuncitem.nodeid, directory) or None
