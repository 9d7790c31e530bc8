"""What a ledger of many cases takes: files, bytes, time to write it, and time of processor to read status and table.

One process claims the cases in blocks and commits a record for each, as large as a record of the paper's Monte Carlo.
Another process reads them. Plans are not part of the times (see sweep_planning.py): keys are drawn, not computed.

Command: python benchmarks/ledger.py [COUNT ...]
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
BLOCK = 256


def plan_of(count: int, store: Path) -> Any:
    """Return a plan whose cases have made-up keys."""
    from hpcinv.job.yaml_reader import read_yaml
    from hpcinv.studies.sweep.cases import Cases
    from hpcinv.studies.sweep.sweep_plan import SweepPlan, read_sweep

    jobs = ROOT / "jobs"
    content = read_yaml(jobs / "paper-monte-carlo.yaml")
    file = read_sweep({**content, "store": str(store), "axes": [{**content["axes"][0], "count": count}]}, jobs)
    cases = Cases(file.sweep)
    for number in range(count):
        cases.append(f"{number * 2654435761 % 2**32:08x}{number:012x}", "group", (float(number),), jobs)
    return SweepPlan(file.path, file.sweep, file.base, file.data, file.is_untrusted, cases)


def record(number: int) -> Any:
    from hpcinv.studies.batch.ledger.case_record import CaseRecord

    iterations = [{"residual": 1 / (k + number + 1), "step": 0.1 * k, "energy": -1.5 * k} for k in range(60)]
    statistics = {
        "status": "converged",
        "job": {"material": {"law": "neo-hookean", "mu": 1e4 + number, "lam": 1e5}, "text": "block " * 200},
        "machine": {"ranks": 1, "host": "node"},
        "mesh": {"unknowns": 1029, "cells": 162},
        "solutions": [{"factorizations": 4, "newton_iterations": 9, "solves": iterations}],
        "quantities": {"height": 0.2 + 1e-6 * number, "tip": [0.1, 0.2, 1e-7 * number]},
        "certificate": {"verdict": "pass", "lines": iterations, "estimate": None},
        "peak_memory": {"ranks": [210_000_000]},
    }
    return CaseRecord("converged", "", statistics, 0.1, 1)


def write(count: int, store: Path) -> dict[str, float]:
    from hpcinv.studies.batch.ledger.holder import Holder
    from hpcinv.studies.batch.ledger.ledger import Ledger

    keys = [*plan_of(count, store).cases.keys]
    with Holder(store) as holder:
        ledger = Ledger(store, holder)
        begun = time.perf_counter()
        for first in range(0, count, BLOCK):
            for number, claim in enumerate(ledger.claim_all(keys[first : first + BLOCK]), first):
                assert ledger.commit(claim, record(number))
        seconds = time.perf_counter() - begun
        ledger.close()
    files = [path for path in store.rglob("*") if path.is_file()]
    return {"write": seconds, "files": len(files), "bytes": sum(path.stat().st_size for path in files)} | memory()


def read(count: int, store: Path, *, table: bool) -> dict[str, float]:
    from hpcinv.studies.batch.status import lines
    from hpcinv.studies.sweep.results import finished, outcomes, status_of
    from hpcinv.studies.sweep.table import SweepTable

    plan = plan_of(count, store)
    begun = time.process_time()
    ledger = plan.ledger
    if table:
        assert len(SweepTable(plan, finished(plan, ledger)).columns()["height"]) == count
    else:
        assert f"{count:,} of {count:,}" in lines(status_of(plan, ledger, outcomes(plan, ledger)))[0]
    return {"read": time.process_time() - begun} | memory()


def memory() -> dict[str, float]:
    return {"memory": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("counts", nargs="*", type=int, default=[1_000, 10_000, 100_000])
    parser.add_argument("--here", nargs=2, metavar=("STEP", "STORE"), help="one step in this process, printed as JSON")
    options = parser.parse_args()
    if options.here:
        step, store = options.here
        count = options.counts[0]
        found = write(count, Path(store)) if step == "write" else read(count, Path(store), table=step == "table")
        print(json.dumps(found))
        return
    print("    cases  files     MB  write a case [µs]  status [s]  table [s]  memory [MB] to write, of status, table")
    for count in options.counts:
        with tempfile.TemporaryDirectory() as place:
            written, status, table = (
                _step(step, count, Path(place) / "store") for step in ("write", "status", "table")
            )
        print(
            f"{count:9,} {written['files']:6.0f} {written['bytes'] / 1e6:6.0f} {1e6 * written['write'] / count:18.0f}"
            f" {status['read']:11.2f} {table['read']:10.2f}"
            f" {written['memory']:21.0f} {status['memory']:9.0f} {table['memory']:6.0f}",
            flush=True,
        )


def _step(step: str, count: int, store: Path) -> dict[str, float]:
    command = [sys.executable, __file__, str(count), "--here", step, str(store)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    found: dict[str, float] = json.loads(done.stdout)
    return found


if __name__ == "__main__":
    main()
