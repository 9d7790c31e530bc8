"""What the daily tests catch: ``python benchmarks/mutants.py --record DIR``, then ``--lines DIR --seed 1 --count 200``.

The first runs the daily tests and records which lines each executes. The second plants one small fault at a time into
a copy of the project (`planted_faults`), and runs tests that execute its lines, near and short ones first, until one
fails that passes without the fault. Prints the share that was found by folder, and the other faults as diffs. A file
of results is continued by the same command; a higher limit tries undecided faults again.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import sysconfig
import tempfile
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from queue import Queue
from threading import Lock
from time import monotonic
from typing import Any

from planted_faults import ROOT, Fault, drawn
from reaching_tests import Record, write_sources

OUTCOMES = ("killed", "survived", "undecided")
"""A fault has survived if all tests that execute its lines pass; it is undecided if the limit was too low for them."""
MAKERS = ("hpcinv/base/parallel", "hpcinv/model/assembly", "hpcinv/physics/points")
"""Faults there may make wrong programs under the names of right ones: these begin with an empty cache."""
FIRST_SECONDS, FIRST_TESTS = 12.0, 12
"""Tests of the first start of pytest. With more, a fault that a near test finds takes longer; with fewer, others do."""
TESTS_PER_SECOND = 0.4
"""Number of tests for a limit in s: more take longer than the limit, mostly for starts and imports."""
SLOWER, START = 6.0, 40.0
"""Tests with a fault hang if they take so many times their usual time, and so many seconds for their start."""
HOOK = """import os; exec("import sys\\nif os.environ.get('HPCINV_TEST_LINES') and {name!r} not in sys.modules:\\n\
 from importlib import util\\n spec = util.spec_from_file_location({name!r}, {path!r})\\n\
 sys.modules[{name!r}] = module = util.module_from_spec(spec)\\n spec.loader.exec_module(module)\\n module.start()")
"""
"""Line of a ``.pth`` file: each start of Python then records its lines if the environment asks for it."""


def record(directory: Path, arguments: Sequence[str]) -> int:
    """Run pytest and record the lines that each test executes; return its exit code."""
    directory.mkdir(parents=True, exist_ok=True)
    for pattern in ("*.jsonl", "*.lines"):
        for file in directory.glob(pattern):
            file.unlink()
    name, path = "helpers.executed_lines", str(ROOT / "tests" / "helpers" / "executed_lines.py")
    hook = Path(sysconfig.get_paths()["purelib"]) / "hpcinv_executed_lines.pth"
    hook.write_text(HOOK.format(name=name, path=path))
    try:
        environment = os.environ | {"HPCINV_TEST_LINES": str(directory.absolute())}
        command = [sys.executable, "-m", "pytest", *arguments]
        code = subprocess.run(command, cwd=ROOT, env=environment, check=False).returncode
    finally:
        hook.unlink()
    write_sources(directory)
    return code


@dataclass(frozen=True)
class Trial:
    """What became of a fault.

    Attributes:
        outcome: one of `OUTCOMES`.
        by: the test that failed.
        tried, reaching: numbers of tests that were run, and that reach the fault.
        seconds: on the clock.
        limit: in seconds, for its tests.
    """

    outcome: str
    by: str
    tried: int
    reaching: int
    seconds: float
    limit: float


class Passing:
    """What is known of tests without a fault, for all copies."""

    def __init__(self) -> None:
        self.passed, self.failed = set[str](), set[str]()


class Copy:
    """A copy of the project in which one fault is tried at a time, with a cache of kernels of its own."""

    def __init__(self, directory: Path, record: Record, passing: Passing) -> None:
        self.root, self._pristine, self._warm = (directory / name for name in ("project", "pristine", "warm"))
        self._cache, self._temporary = directory / "cache", directory / "tmp"
        self._record, self._passing = record, passing
        listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True)
        for root in (self.root, self._pristine):
            for name in filter(None, listed.stdout.split("\0")):
                if (ROOT / name).is_file():
                    (root / name).parent.mkdir(parents=True, exist_ok=True)
                    shutil.copy2(ROOT / name, root / name)
        (self._warm / "hpcinv").mkdir(parents=True)
        kept = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "hpcinv"
        for pattern in ("points_*", "taylor_*", "hpcinv_*.so"):
            for file in kept.glob(pattern):
                shutil.copy2(file, self._warm / "hpcinv" / file.name)

    def _fill_cache(self, fault: Fault) -> None:
        """Begin with programs that are right, in files that a fault cannot change in the copy that is kept."""
        shutil.rmtree(self._cache, ignore_errors=True)  # the last fault may have left wrong programs there
        (self._cache / "hpcinv").mkdir(parents=True)
        if not str(fault.path).startswith(MAKERS):
            for file in (self._warm / "hpcinv").iterdir():
                if not file.name.endswith(".lock"):
                    (self._cache / "hpcinv" / file.name).hardlink_to(file)

    def tried(self, fault: Fault, limit: float) -> Trial:
        """Run tests until one finds the fault, all that reach it have passed, or the limit in s is used up."""
        file, begin = self.root / fault.path, monotonic()
        source = file.read_bytes()
        reaching = [name for name in self._record.ordered(fault) if name not in self._passing.failed]
        some = self._affordable(reaching, limit)
        self._fill_cache(fault)
        try:
            file.write_bytes(fault.planted(source))
            outcome, by = self._outcome(some, begin + limit)
        finally:
            file.write_bytes(source)
        if outcome == "survived" and len(some) < len(reaching):
            outcome = "undecided"
        return Trial(outcome, by, len(some), len(reaching), round(monotonic() - begin, 1), limit)

    def _affordable(self, names: Sequence[str], limit: float) -> list[str]:
        """Return the first tests that are not too many for the limit, and not too long together."""
        some, seconds = list[str](), 0.0
        for name in names:
            seconds += self._record.tests[name].seconds
            if some and (seconds > limit / 2 or len(some) > TESTS_PER_SECOND * limit):
                break
            some.append(name)
        return some

    def _outcome(self, tests: Sequence[str], ends: float) -> tuple[str, str]:
        """Run the first tests, then the others: pytest imports the files of all before the first test."""
        first = 0
        seconds = 0.0
        while first < min(FIRST_TESTS, len(tests)) and seconds < FIRST_SECONDS:
            seconds += self._record.tests[tests[first]].seconds
            first += 1
        for names in (tests[:first], tests[first:]):
            while some := [name for name in names if name not in self._passing.failed]:
                left = ends - monotonic()
                patience = START + SLOWER * sum(self._record.tests[name].seconds for name in some)
                done = self._pytest(self.root, self._cache, some, min(patience, left))
                if done is None and patience >= left:
                    return "undecided", ""
                if done is not None and done.returncode in (0, 5):
                    break
                failed = found_failures(done.stdout, some) if done is not None else []
                files = tuple(f"{name}::" for name in failed if "::" not in name)  # their collection failed
                to_check = [name for name in failed if "::" in name] or [n for n in some if n.startswith(files)] or some
                if self._passes_without(to_check, patience):
                    return "killed", failed[0] if failed else "pytest hangs" if done is None else "pytest ended"
                if not failed:
                    return "undecided", "the tests hang or end pytest without the fault, too"
                self._passing.failed.update(failed)
                if not set(failed) & set(some):
                    return "undecided", f"{failed[0]} fails without the fault, too"
        return "survived", ""

    def _passes_without(self, names: Sequence[str], patience: float) -> bool:
        """Return whether tests pass without the fault."""
        if unknown := [name for name in names if name not in self._passing.passed]:
            done = self._pytest(self._pristine, self._warm, unknown, patience)
            if done is None or done.returncode != 0:
                return False
            self._passing.passed.update(unknown)
        return True

    def _pytest(
        self, root: Path, cache: Path, names: Sequence[str], limit: float
    ) -> subprocess.CompletedProcess[str] | None:
        shutil.rmtree(self._temporary, ignore_errors=True)
        self._temporary.mkdir()
        command = [sys.executable, "-m", "pytest", "-n", "0", "-x", "-q", "--tb=no", "-p", "no:cacheprovider", *names]
        environment = os.environ | {"PYTHONPATH": str(root), "XDG_CACHE_HOME": str(cache)}
        environment |= {"TMPDIR": str(self._temporary), "PYTHONDONTWRITEBYTECODE": ""}
        with subprocess.Popen(
            command, cwd=root, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
            errors="replace", start_new_session=True,
        ) as process:  # fmt: skip
            try:
                output, _ = process.communicate(timeout=max(limit, 1.0))
            except subprocess.TimeoutExpired:
                with suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
                return None
        return subprocess.CompletedProcess(command, process.returncode, output)


def found_failures(output: str, names: Sequence[str]) -> list[str]:
    """Return the tests among those that were run, or the files, that a summary of pytest says to have failed."""
    found = list[str]()
    for line in re.findall(r"^(?:FAILED|ERROR) (\S+\.py.*)$", output, re.M):
        ids = [name for name in names if line == name or line.startswith(f"{name} - ")]
        found.append(max(ids, key=len, default=line.partition(" - ")[0]))
    return found


class Results:
    """A file with a line of JSON for each fault that was tried; in memory only, if there is no path."""

    def __init__(self, path: Path | None) -> None:
        self._path, self._lock, self._trials = path, Lock(), dict[Fault, Trial]()
        if path is not None and path.is_file():
            for text in path.read_text().splitlines():
                line = json.loads(text)
                fault = {name: line.pop(name) for name in Fault.__dataclass_fields__}
                self._trials[Fault(**fault | {"path": Path(fault["path"])})] = Trial(**line)

    def __getitem__(self, fault: Fault) -> Trial | None:
        return self._trials.get(fault)

    def add(self, fault: Fault, trial: Trial) -> None:
        """Keep one, and print it."""
        line: dict[str, Any] = asdict(fault) | {"path": str(fault.path)} | asdict(trial)
        what = fault.diff(ROOT) if trial.outcome != "killed" else f"{fault.path}: {fault.kind}"
        tests = trial.by if trial.outcome == "killed" else f"{trial.tried} of {trial.reaching} tests; {trial.by}"
        with self._lock:
            self._trials[fault] = trial
            print(f"{trial.outcome} after {trial.seconds:.0f} s ({tests.rstrip('; ')}): {what}", flush=True)
            if self._path is not None:
                with self._path.open("a") as file:
                    print(json.dumps(line), file=file)


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


def try_all(faults: Sequence[Fault], results: Results, record: Record, options: argparse.Namespace) -> None:
    """Try faults on several copies of the project at a time, for ``options.minutes`` or until all are tried."""
    passing, ends = Passing(), monotonic() + 60 * options.minutes
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as temporary:
        copies = Queue[Copy]()
        for number in range(options.jobs):
            copies.put(Copy(Path(temporary) / str(number), record, passing))

        def tried(fault: Fault) -> None:
            copy = copies.get()
            try:
                if monotonic() < ends:
                    results.add(fault, copy.tried(fault, options.limit))
            finally:
                copies.put(copy)

        pool = ThreadPoolExecutor(options.jobs)
        try:
            for future in [pool.submit(tried, fault) for fault in faults]:
                future.result()
        finally:
            pool.shutdown(cancel_futures=True)


def parsed(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """Return the options; ``record`` is a directory and what is for pytest."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    where = parser.add_mutually_exclusive_group(required=True)
    where.add_argument("--record", nargs=argparse.REMAINDER, metavar="DIR ...", help="run pytest with what follows DIR")
    where.add_argument("--lines", type=Path, metavar="DIR", help="the recorded lines")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=200, help="number of faults")
    parser.add_argument("--limit", type=float, default=120.0, help="seconds for the tests of a fault")
    parser.add_argument("--minutes", type=float, default=1e6, help="begin no fault after this time")
    parser.add_argument("--results", type=Path, metavar="FILE", help="keep results there, or continue them")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="faults that are tried at a time")
    parser.add_argument("paths", nargs="*", type=Path, help="files and folders of faults; hpcinv if there are none")
    options = parser.parse_args(arguments)
    if options.record == []:
        parser.error("--record needs a directory")
    return options


def main() -> int:
    options = parsed()
    if options.record:
        return record(Path(options.record[0]), options.record[1:])
    try:
        lines = Record(options.lines)
    except FileNotFoundError as error:
        print(f"no record: {error.filename} is missing. Make one by --record {options.lines}", file=sys.stderr)
        return 2
    if lines.changed:
        print(
            f"{len(lines.changed)} files have changed since; their tests may be others. Record again for all of them."
        )
    faults = drawn(options.paths or [Path("hpcinv")], options.seed, options.count)
    results = Results(options.results)
    done = {fault: trial for fault in faults if (trial := results[fault])}
    again = [fault for fault in done if done[fault].outcome == "undecided" and done[fault].limit < options.limit]
    try_all([*(fault for fault in faults if fault not in done), *again], results, lines, options)
    trials = [(fault, trial.outcome) for fault in faults if (trial := results[fault])]
    print("", *table(trials), sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
