"""What planning a sweep takes: all cases are checked, and get their keys, before the first one runs.

The paper's Monte Carlo with more and more cases, each in a process of its own: seconds of processor from the import of
hpcinv to the line with the number of cases, seconds and microseconds per case for their plan, and the peak memory.

Command: python benchmarks/sweep_planning.py [COUNT ...]
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]


def measure(count: int) -> dict[str, float]:
    """Plan a sweep in this process; times of processor (s) and memory (MB)."""
    from hpcinv.job.yaml_reader import read_yaml
    from hpcinv.studies.sweep.sweep_plan import read_sweep

    jobs = ROOT / "jobs"
    content = read_yaml(jobs / "paper-monte-carlo.yaml")
    file = read_sweep({**content, "axes": [{**content["axes"][0], "count": count}]}, jobs)
    known = time.process_time()
    plan = file.plan()
    seconds = time.process_time() - known
    assert len(plan.cases) == file.case_count == count
    return {"first": known, "plan": seconds, "memory": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("counts", nargs="*", type=int, default=[1_000, 10_000, 100_000, 1_000_000])
    parser.add_argument("--here", action="store_true", help="measure in this process, and print JSON")
    options = parser.parse_args()
    if options.here:
        print(json.dumps(measure(options.counts[0])))
        return
    print("    cases  first line [s]  plan [s]  a case [µs]  memory [MB]")
    for count in options.counts:
        done = subprocess.run(
            [sys.executable, __file__, str(count), "--here"], check=True, capture_output=True, text=True
        )
        found = json.loads(done.stdout)
        per_case = 1e6 * found["plan"] / count
        print(f"{count:9,} {found['first']:15.2f} {found['plan']:9.2f} {per_case:12.0f} {found['memory']:12.0f}")


if __name__ == "__main__":
    main()
