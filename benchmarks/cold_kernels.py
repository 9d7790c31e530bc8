"""What a run takes on an empty cache, above the same run with all of it there.

A cache without programs is one of a law or body that is new; an empty one also lacks the code in C, which is compiled
once for all jobs.

Command: python benchmarks/cold_kernels.py [JOB …]
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

from hpcinv.output.console import table_console, table_of_numbers

ROOT = Path(__file__).parents[1]
LEFT_OUT = ("sweep", "study", "identify", "paper", "million", "partitioned", "uncertain")
"""beginnings of names: other commands, long jobs, and meshes that are made beforehand"""
JOBS = [job for job in sorted((ROOT / "jobs").glob("*.yaml")) if not job.name.startswith(LEFT_OUT)]


def run_here(job: str) -> None:
    """Run a job in this process; print its seconds of the processor, with its children, as JSON."""
    from hpcinv.__main__ import main

    with tempfile.TemporaryDirectory() as directory:
        main(["run", job, "--output", f"{directory}/run", "--quiet"])
    used = processor_time(resource.RUSAGE_SELF) + processor_time(resource.RUSAGE_CHILDREN)
    print(json.dumps(used))


def processor_time(who: int) -> float:
    used = resource.getrusage(who)
    return used.ru_utime + used.ru_stime


def seconds(job: Path, kernels: Path) -> float:
    """Return the seconds of a run with a directory of kernels."""
    settings = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    settings |= {"HPCINV_KERNELS": str(kernels), "OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}
    command = [sys.executable, __file__, "--here", str(job)]
    done = subprocess.run(command, env=settings, stdout=subprocess.PIPE, check=True, text=True)
    found: float = json.loads(done.stdout.splitlines()[-1])
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
    table = table_of_numbers("job", "warm, s", "more without programs", "more by an empty cache")
    for job in options.jobs:
        with tempfile.TemporaryDirectory() as directory:
            if not job.exists():
                command = [sys.executable, "-m", "hpcinv", "new", job.stem, f"{directory}/{job.name}"]
                subprocess.run(command, stdout=subprocess.DEVNULL, check=True)
                job = Path(directory, job.name)
            kernels = Path(directory, "kernels")
            empty, warm = seconds(job, kernels), seconds(job, kernels)
            for program in kernels.glob("points_*"):
                program.unlink()
            without, warm_again = seconds(job, kernels), seconds(job, kernels)
            warm = min(warm, warm_again)
        table.add_row(job.stem, f"{warm:.1f}", f"{without - warm:.1f}", f"{empty - warm:.1f}")
    table_console().print(table)


if __name__ == "__main__":
    main()
