"""What a run with its default certificate takes on an empty cache, above the same run with all of it there.

The empty cache has neither programs nor the interpreter, which is compiled once for all jobs.

Command: python benchmarks/cold_kernels.py [JOB …]
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from hpcinv.output.console import table_console, table_of_numbers

ROOT = Path(__file__).parents[1]
NAMES = ("single-tetrahedron", "thick-sphere", "sagging-block", "pdms-beam", "muscle", "heart-wall")
JOBS = [*(ROOT / "jobs" / f"{name}.yaml" for name in NAMES), Path("shell.yaml")]


def run_here(job: str) -> None:
    """Run a job in this process; print its seconds as JSON: of the processor, with its children, and elapsed."""
    started = time.perf_counter()
    from hpcinv.__main__ import main

    with tempfile.TemporaryDirectory() as directory:
        main(["run", job, "--output", f"{directory}/run", "--quiet"])
    elapsed = time.perf_counter() - started
    used = processor_time(resource.RUSAGE_SELF) + processor_time(resource.RUSAGE_CHILDREN)
    print(json.dumps([used, elapsed]))


def processor_time(who: int) -> float:
    used = resource.getrusage(who)
    return used.ru_utime + used.ru_stime


def seconds(job: Path, kernels: Path) -> list[float]:
    """Return the seconds of a run with a directory of kernels."""
    settings = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    settings |= {"HPCINV_KERNELS": str(kernels), "OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}
    command = [sys.executable, __file__, "--here", str(job)]
    done = subprocess.run(command, env=settings, stdout=subprocess.PIPE, check=True, text=True)
    found: list[float] = json.loads(done.stdout.splitlines()[-1])
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "jobs", type=Path, nargs="*", default=JOBS, help="job files, or shell.yaml and other names of templates"
    )
    parser.add_argument("--here", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.here:
        run_here(str(options.jobs[0]))
        return
    parts = ("processor", "elapsed")
    table = table_of_numbers("job", *(f"{part}, s" for part in parts), "kernels there", "more by an empty cache")
    for job in options.jobs:
        with tempfile.TemporaryDirectory() as directory:
            if not job.exists():
                command = [sys.executable, "-m", "hpcinv", "new", job.stem, f"{directory}/{job.name}"]
                subprocess.run(command, stdout=subprocess.DEVNULL, check=True)
                job = Path(directory, job.name)
            cold, warm = (seconds(job, Path(directory, "kernels")) for _ in range(2))
        table.add_row(job.stem, *(f"{s:.1f}" for s in cold), f"{warm[0]:.1f}", f"{cold[0] - warm[0]:.1f}")
    table_console().print(table)


if __name__ == "__main__":
    main()
