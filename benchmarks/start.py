"""Processor time from prompt to prompt of commands on small jobs, user and system, with kernels compiled before.

Command: python benchmarks/start.py [--against DIRECTORY] [--repeat 9]

Commands of this source tree and of another, such as the last version's, take turns; the ratio of their medians is
printed, since a busy machine slows both. Both run in the same environment, without writing into the trees.
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

from hpcinv.output.console import table_console, table_of_numbers

ROOT = Path(__file__).parents[1]
JOB = str(ROOT / "jobs" / "single-tetrahedron.yaml")
COMMANDS = (
    ("--version",),
    ("validate", JOB),
    ("run", JOB, "--overwrite", "--output", "results"),
)


def processor_time(tree: Path, command: tuple[str, ...], place: Path) -> float:
    """Return the seconds of one command and of processes that it starts."""
    settings = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    settings |= {"PYTHONPATH": str(tree), "PYTHONPYCACHEPREFIX": str(place / "compiled"), "OMP_NUM_THREADS": "1"}
    with subprocess.Popen(
        [sys.executable, "-m", "hpcinv", *command], cwd=place, env=settings, stdout=subprocess.DEVNULL
    ) as process:
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        sys.exit(f"{tree}: hpcinv {' '.join(command)} ended with exit code {process.returncode}")
    return used.ru_utime + used.ru_stime


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--against", type=Path, metavar="DIRECTORY", help="root of another source tree")
    parser.add_argument("--repeat", type=int, default=9, help="times that each command is measured")
    options = parser.parse_args()
    trees = [ROOT] if options.against is None else [ROOT, options.against.resolve()]
    table = table_of_numbers("command", "s", *(("s before", "ratio") if len(trees) == 2 else ()))
    for command in COMMANDS:
        with tempfile.TemporaryDirectory() as name:
            for tree in trees:  # compiles modules, and kernels if they are missing
                processor_time(tree, command, Path(name))
            times = [[processor_time(tree, command, Path(name)) for tree in trees] for _ in range(options.repeat)]
        medians = [statistics.median(column) for column in zip(*times, strict=True)]
        ratio = [f"{medians[0] / medians[1]:.2f}"] if len(medians) == 2 else []
        table.add_row(" ".join(Path(word).name for word in command[:2]), *(f"{s:.2f}" for s in medians), *ratio)
    table_console().print(table)


if __name__ == "__main__":
    main()
