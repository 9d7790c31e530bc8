"""The table of the README on hard cases: every job of jobs/hard, what makes it hard, how it ends, and what that costs.

Jobs are run as they are, with their certificates. The Newton iterations, with the factorizations in brackets, count the
solve alone; seconds count the whole run without the compilation of its kernels.

Command: mpirun -n 1 python benchmarks/hard_cases.py [jobs …]
"""

from __future__ import annotations

import argparse
import json
import re
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import HpcinvError

JOBS = Path(__file__).parents[1] / "jobs" / "hard"
HEADINGS = ("case", "what makes it hard", "how it ends", "Newton iterations (factorizations)", "s")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("jobs", nargs="*", type=Path, default=sorted(JOBS.glob("*.yaml")), help="those to run")
    rows = [row(job, MPI.COMM_WORLD) for job in parser.parse_args().jobs]
    if MPI.COMM_WORLD.rank == 0:
        for cells in (HEADINGS, ("---",) * len(HEADINGS), *rows):
            print(f"| {' | '.join(cells)} |")


def row(path: Path, comm: MPI.Intracomm) -> tuple[str, ...]:
    """One job's line of the table."""
    with tempfile.TemporaryDirectory() as temporary:
        directory = comm.bcast(Path(temporary)) / "results"
        begin = time.perf_counter()
        try:
            result = hpcinv.run(hpcinv.load(path), comm, directory=directory, progress=False)
        except HpcinvError as error:
            message = re.sub(r"^\S+\.yaml: (supports: )?", "", error.message.splitlines()[0])
            ending = f"exit code {error.exit_code}: {message}"
        else:
            ending = certified(result.statistics["certificate"])
        seconds = time.perf_counter() - begin
        summary = directory / "summary.json"
        comm.barrier()
        statistics = json.loads(summary.read_text()) if summary.exists() else None
    cost, seconds = (effort(statistics)) if statistics else ("0 (0)", seconds)
    return path.stem, heading("Hard", path), ending, cost, f"{seconds:.1f}"


def heading(name: str, path: Path) -> str:
    """What the head of a job file says under a name, on however many lines."""
    match = re.search(rf"^# {name} +(.*(?:\n#            .*)*)", path.read_text(), re.MULTILINE)
    assert match is not None
    return re.sub(r"\n# +", " ", match[1])


def certified(certificate: Mapping[str, Any]) -> str:
    """The verdict, and what it is about if it is not good."""
    lines = [line for line in certificate["lines"] if line["verdict"] == certificate["verdict"]]
    if certificate["verdict"] == "pass":
        return "converged, certificate passes"
    code = "exit code 6: " if certificate["verdict"] == "fail" else ""
    return f"{code}converged, {certificate['verdict']}: {', '.join(line['name'] for line in lines)}"


def effort(statistics: Mapping[str, Any]) -> tuple[str, float]:
    """Iterations and factorizations of all solutions, and seconds."""
    solutions, timings = statistics["solutions"], statistics["timings"]
    iterations, factorizations = (
        sum(solution[key] for solution in solutions) for key in ("newton_iterations", "factorizations")
    )
    compilation = timings["phases"].get("programs", {"max": 0.0})["max"]
    return f"{iterations} ({factorizations})", timings["total"] - compilation


if __name__ == "__main__":
    main()
