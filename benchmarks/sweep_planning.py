"""What planning a sweep takes: all cases are checked, and get their keys, before the first one runs.

The paper's Monte Carlo with more and more cases, each in a process of its own: seconds of processor from the import of
hpcinv to the line with the number of cases, seconds and microseconds per case for their plan, microseconds to choose
the next case (the first 20,000 of them, without a store), and the peak memory.

Command: python benchmarks/sweep_planning.py [COUNT ...]
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

if TYPE_CHECKING:
    from hpcinv.studies.sweep.queue import Queue

ROOT = Path(__file__).parents[1]
MOST_CHOSEN = 20_000


def measure(count: int) -> dict[str, float]:
    """Plan a sweep in this process; times of processor (s) and memory (MB)."""
    from hpcinv.job.yaml_reader import read_yaml
    from hpcinv.studies.sweep.queue import Queue
    from hpcinv.studies.sweep.sweep_plan import read_sweep

    jobs = ROOT / "jobs"
    content = read_yaml(jobs / "paper-monte-carlo.yaml")
    file = read_sweep({**content, "axes": [{**content["axes"][0], "count": count}]}, jobs)
    known = time.process_time()
    plan = file.plan()
    seconds = time.process_time() - known
    assert len(plan.cases) == file.case_count == count
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    begun = time.process_time()
    chosen = choose(Queue(plan, cast(Any, Uncontested()), begin=0.0, patience=1.0))
    return {"first": known, "plan": seconds, "choose": (time.process_time() - begun) / chosen, "memory": memory}


class Uncontested:
    """A ledger without files: every case is open until it is claimed."""

    def states(self, keys: Sequence[str]) -> dict[str, Any]:
        return dict.fromkeys(keys, SimpleNamespace(name="open", died=0, living=False))

    def claim_all(self, keys: Iterable[str]) -> list[Any]:
        return [SimpleNamespace(key=key, run=None) for key in keys]

    def holder_count(self) -> int:
        return 1


def choose(queue: Queue) -> int:
    """Take cases as a sweep does, as if each took 0.1 s; return their number."""
    for number in range(MOST_CHOSEN):
        if queue._claim() is None:
            return number
        queue._ahead()
        queue._solved, queue._seconds = number + 1, 0.1 * (number + 1)
    return MOST_CHOSEN


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("counts", nargs="*", type=int, default=[1_000, 10_000, 100_000, 1_000_000])
    parser.add_argument("--here", action="store_true", help="measure in this process, and print JSON")
    options = parser.parse_args()
    if options.here:
        print(json.dumps(measure(options.counts[0])))
        return
    print("    cases  first line [s]  plan [s]  a case [µs]  next one [µs]  memory [MB]")
    for count in options.counts:
        done = subprocess.run(
            [sys.executable, __file__, str(count), "--here"], check=True, capture_output=True, text=True
        )
        found = json.loads(done.stdout)
        per_case = 1e6 * found["plan"] / count
        print(f"{count:9,} {found['first']:15.2f} {found['plan']:9.2f} {per_case:12.0f} ", end="")
        print(f"{1e6 * found['choose']:14.0f} {found['memory']:12.0f}")


if __name__ == "__main__":
    main()
