"""Whole processes, from prompt to prompt: jobs with the default certificate, without one, and another program.

Runs take turns, and the medians of elapsed and processor time are printed; kernels are compiled by a run before.
"ratio" is with by without a certificate; the last column has the check that takes longest. With --theirs, each round
also runs the command of another program for the same problem; "theirs" is its elapsed time over the certified run's.

Command: python benchmarks/certified_runs.py JOB … [--ranks 1 2] [--repeat 3] [--theirs "COMMAND"]
"""

import argparse
import json
import os
import re
import resource
import shlex
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from hpcinv.output.console import table_console, table_of_numbers
from hpcinv.trust.certificate.check import Verdict

MPIRUN = Path(sys.executable).parent / "mpirun"


def seconds(command: Sequence[str]) -> tuple[float, float]:
    """Return elapsed and processor time of a command."""
    settings = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    used, started = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run(command, env=settings, stdout=subprocess.DEVNULL)
    elapsed, after = time.perf_counter() - started, resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode not in (0, Verdict.FAIL.exit_code()):
        sys.exit(f"exit code {done.returncode}: {shlex.join(command)}")
    return elapsed, after.ru_utime + after.ru_stime - used.ru_utime - used.ru_stime


def run_of(job: Path, ranks: int, level: str, place: str) -> list[str]:
    """Return the command of a run with a level of the certificate."""
    command = [sys.executable, "-m", "hpcinv", "run", str(job), "--output", f"{place}/run", "--overwrite", "--quiet"]
    command += ["--certificate", level]
    return command if ranks == 1 else [str(MPIRUN), "-n", str(ranks), *command]


def longest_check(place: str) -> str:
    """Return the check of a certificate that takes longest, with its elapsed seconds."""
    lines = json.loads(Path(place, "run", "summary.json").read_text())["certificate"]["lines"]
    line = max(lines, key=lambda line: line["seconds"] or 0.0)
    return f"{re.split('[,:]| of ', line['name'])[0]}, {line['seconds']:.2f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("jobs", type=Path, nargs="+", help="job files")
    parser.add_argument("--ranks", type=int, nargs="+", default=[1])
    parser.add_argument("--repeat", type=int, default=3, help="rounds")
    parser.add_argument("--theirs", help="command of another program that solves the same problem")
    options = parser.parse_args()
    columns = ("certified, s", "processor, s", "without, s", "processor, s", "ratio", "ratio of processor")
    table = table_of_numbers("job", "ranks", *columns, *(["theirs"] if options.theirs else []), "longest check, s")
    for job in options.jobs:
        for ranks in options.ranks:
            with tempfile.TemporaryDirectory() as place:
                commands = [run_of(job, ranks, level, place) for level in ("standard", "off")]
                seconds(commands[0])
                check = longest_check(place)
                rounds = [
                    [
                        *(seconds(command) for command in commands),
                        *([seconds(shlex.split(options.theirs))] if options.theirs else []),
                    ]
                    for _ in range(options.repeat)
                ]
            medians = [
                [statistics.median(values) for values in zip(*column, strict=True)]
                for column in zip(*rounds, strict=True)
            ]
            (certified, used), (without, used_without), *theirs = medians
            figures = [f"{s:.1f}" for s in (certified, used, without, used_without)]
            ratios = [certified / without, used / used_without, *(elapsed / certified for elapsed, _ in theirs)]
            table.add_row(job.stem, str(ranks), *figures, *(f"{ratio:.2f}" for ratio in ratios), check)
    table_console().print(table)


if __name__ == "__main__":
    main()
