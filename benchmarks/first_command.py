"""Elapsed and processor time of README.md's first command, step by step: a clean clone with an empty package cache.

Packages are downloaded, so the time depends on the network too.

Command: python benchmarks/first_command.py [--clone DIRECTORY]
"""

import argparse
import os
import resource
import shlex
import subprocess
import sys
import tempfile
import time
import venv
from pathlib import Path

from hpcinv.output.console import table_console, table_of_numbers

ROOT = Path(__file__).parents[1]
RUN = "uv run mpirun -n 2 python -m hpcinv run jobs/pdms-beam.yaml"
STEPS = {
    "uv": "pip install uv",
    "environment": "uv sync",  # which `uv run` would do
    "first run": RUN,
    "second run": RUN,
}
OWN = ("PYTHONPATH", "VIRTUAL_ENV", "PYTHONDONTWRITEBYTECODE")
"""variables of this environment, which the other one would take"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clone", default=str(ROOT), help="repository to clone (this one)")
    options = parser.parse_args()
    table = table_of_numbers("step", "elapsed, s", "processor, s")
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        subprocess.run(
            ["git", "clone", "--quiet", "--depth", "1", f"file://{options.clone}", place / "clone"], check=True
        )
        venv.create(place / "python", with_pip=True)
        settings = {key: value for key, value in os.environ.items() if key not in OWN}
        settings |= {key: str(place / key) for key in ("UV_CACHE_DIR", "PIP_CACHE_DIR", "HPCINV_KERNELS")}
        for step, command in STEPS.items():
            before, started = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
            words = [str(place / "python" / "bin" / "python"), "-m", *shlex.split(command)]
            done = subprocess.run(words, cwd=place / "clone", env=settings, capture_output=True, text=True)
            elapsed, after = time.perf_counter() - started, resource.getrusage(resource.RUSAGE_CHILDREN)
            if done.returncode:
                sys.exit(f"{command} ended with exit code {done.returncode}:\n{done.stderr[-2000:]}")
            used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
            table.add_row(step, f"{elapsed:.0f}", f"{used:.0f}")
    table_console().print(table)


if __name__ == "__main__":
    main()
