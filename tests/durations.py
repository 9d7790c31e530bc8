"""What the tests take: ``python tests/durations.py [--cold] [--into DIRECTORY] [arguments of pytest]``.

Runs pytest and prints tables by folder and file, of the slowest tests, and of kernels by user. Fails if pytest fails,
or if a folder exceeds its budget. ``--show DIRECTORY`` prints the tables of an earlier run, which pytest records with
the variable ``HPCINV_TEST_DURATIONS=DIRECTORY``.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pandas as pd

ROOT = Path(__file__).parents[1]
BUDGETS = {"tests/parallel": 1.2, "tests/system": 4.7, "tests/unit": 3.5, "tests/verification": 8.0}
"""Processor time of folders from an empty cache, in 1000 reference calculations: 1.3 times the most that was seen.

A day on which the reference took 0.107 s instead of 0.194 s gave 1.3 times as many for nearly the same tests; on a busy
machine they took 0.9 to 1.1 times as many.
"""
COLUMNS = ["wall", "self", "children", "CPU", "compiling", "kernels"]


def read(directory: Path) -> tuple[pd.DataFrame, float]:
    """Return the phases of all tests (times in s), and the processor time of a reference calculation in s."""
    lines = [json.loads(text) for path in sorted(directory.glob("*.jsonl")) for text in path.read_text().splitlines()]
    phases = pd.DataFrame([line for line in lines if "test" in line])
    # What no process of the tests compiled belongs to the first test that saw it: a command under mpirun did.
    taken = {name for names in phases["compiled"] for name in names}
    kernels = []
    for compiled, seen in zip(phases["compiled"], phases["seen"], strict=True):
        kernels.append(len(compiled) + len(set(seen) - taken))
        taken |= set(seen)
    phases["kernels"], phases["CPU"] = kernels, phases["self"] + phases["children"]
    return phases, pd.Series([line["reference"] for line in lines if "reference" in line]).median()


def by_place(phases: pd.DataFrame) -> pd.DataFrame:
    """Return sums over the tests of each folder and file."""
    path = phases["test"].str.partition("::")[0]
    depth = range(1, 1 + path.str.count("/").max())
    places = [path.where(path.str.count("/") >= n).str.split("/").str[: n + 1].str.join("/") for n in depth]
    tables = [phases.groupby(place)[COLUMNS].sum() for place in places]
    return pd.concat([phases.groupby(path)[COLUMNS].sum(), *tables]).groupby(level=0).first().sort_index()


def report(directory: Path, rows: int) -> list[str]:
    """Print the tables of a recording, with so many rows for single tests; return the folders above their budgets."""
    phases, unit = read(directory)
    places, tests = by_place(phases), phases.groupby("test")[COLUMNS].sum()
    pd.options.display.float_format, pd.options.display.width = "{:.1f}".format, 200
    pd.options.display.max_colwidth = 140
    print(f"By folder and file (s, {len(tests)} tests)", places.to_string(), sep="\n", end="\n\n")
    print("By phase (s)", phases.groupby("phase")[COLUMNS].sum().to_string(), sep="\n", end="\n\n")
    print("Slowest tests (s)", tests.nlargest(rows, "CPU").to_string(), sep="\n", end="\n\n")
    print("Kernels by user (s)", tests.nlargest(rows, "kernels").to_string(), sep="\n", end="\n\n")
    print(f"Budgets (processor time in 1000 reference calculations, each {unit:.3f} s)")
    used = places["CPU"].reindex(list(BUDGETS), fill_value=0) / unit / 1000
    for folder, budget in BUDGETS.items():
        print(f"{used[folder]:8.2f} of {budget}  {folder}")
    return [folder for folder, budget in BUDGETS.items() if used[folder] > budget]


def record(directory: Path, cold: bool, arguments: list[str]) -> int:
    """Run pytest and keep the records of all its processes; return its exit code."""
    environment = os.environ | {"HPCINV_TEST_DURATIONS": str(directory)}
    if cold:
        environment["XDG_CACHE_HOME"] = str(directory / "cache")
    return subprocess.run(
        [sys.executable, "-m", "pytest", *arguments], cwd=ROOT, env=environment, check=False
    ).returncode


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cold", action="store_true", help="start from an empty cache of kernels")
    parser.add_argument("--show", type=Path, metavar="DIRECTORY", help="print the tables of earlier records")
    parser.add_argument("--into", type=Path, metavar="DIRECTORY", help="keep the records there")
    parser.add_argument("--rows", type=int, default=25, help="number of single tests in a table")
    options, arguments = parser.parse_known_args()
    with tempfile.TemporaryDirectory() as temporary:
        directory = (options.show or options.into or Path(temporary)).absolute()
        directory.mkdir(parents=True, exist_ok=True)
        code = 0 if options.show else record(directory, options.cold, arguments)
        if not any(directory.glob("*.jsonl")):
            print(f"no records in {directory}", file=sys.stderr)
            return code or 2
        over = report(directory, options.rows)
    if over:
        print(f"more processor time than the budget: {', '.join(over)}. Shorten the tests.", file=sys.stderr)
        return code or 1
    return code


if __name__ == "__main__":
    sys.exit(main())
