"""What a sweep saves against a process for each case, and what a second rank brings, in one run.

The cases come from a sweep file, by default 240 silicone beams of four laws. A shell loop of single-rank processes,
two side by side, runs some of them, evenly spread over the sweep; then the sweep runs on one rank and on two, in empty
stores. Kernels are compiled beforehand; all times are from command to prompt, and include start-up.

Command: python benchmarks/sweep_throughput.py [--sweep FILE] [--by-hand 24]
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import yaml

from hpcinv.job.yaml_reader import read_yaml
from hpcinv.studies.sweep.sweep_plan import SweepPlan, load_sweep

ROOT = Path(__file__).parents[1]
MPIRUN = Path(sys.executable).parent / "mpirun"


def hpcinv(ranks: int, *arguments: object) -> None:
    command = [str(MPIRUN), "-n", str(ranks), sys.executable, "-m", "hpcinv", *map(str, arguments)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)


def shell_loop(plan: SweepPlan, count: int, directory: Path) -> float:
    """Seconds per case of single-rank processes, two side by side."""
    files = []
    for case in plan.cases[:: len(plan.cases) // count][:count]:
        # Next to the sweep's job, where its paths begin.
        files.append(plan.base.parent / f".{plan.sweep.sweep}-{case.key}.yaml")
        files[-1].write_text(yaml.safe_dump(dict(plan.content(case)), sort_keys=False, allow_unicode=True))
    try:
        begun = time.perf_counter()
        with ThreadPoolExecutor(2) as pool:
            list(pool.map(lambda file: hpcinv(1, "run", file, "--output", directory / file.stem), files))
        return (time.perf_counter() - begun) / len(files)
    finally:
        for file in files:
            file.unlink()


def sweep(plan: SweepPlan, ranks: int, directory: Path) -> float:
    """Seconds per case of the sweep in an empty store."""
    content = read_yaml(plan.path)
    file = plan.path.with_name(f".{plan.sweep.sweep}-benchmark.yaml")
    file.write_text(yaml.safe_dump(content | {"store": str(directory / f"store-{ranks}")}, sort_keys=False))
    try:
        begun = time.perf_counter()
        hpcinv(ranks, "sweep", "run", file)
        return (time.perf_counter() - begun) / len(plan.cases)
    finally:
        file.unlink()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sweep", type=Path, default=ROOT / "jobs" / "sweep-beam-laws.yaml")
    parser.add_argument("--by-hand", type=int, default=24, help="cases that the shell loop runs")
    options = parser.parse_args()
    plan = load_sweep(options.sweep)
    with tempfile.TemporaryDirectory() as temporary:
        directory = Path(temporary)
        reuse_groups = {group: place for place, group in enumerate(plan.cases.reuse_groups)}
        shell_loop(replace(plan, cases=plan.cases.chosen([*reuse_groups.values()])), len(reuse_groups), directory / "0")
        loop = shell_loop(plan, options.by_hand, directory)
        single, two = sweep(plan, 1, directory), sweep(plan, 2, directory)
    print(f"{len(plan.cases)} cases of {plan.path.name}; seconds per case from command to prompt")
    print(f"  a process for each, two side by side ({options.by_hand} of the cases)  {loop:.3f}")
    print(f"  sweep, 1 rank                                             {single:.3f}")
    print(f"  sweep, 2 ranks, 1 per case                                {two:.3f}")
    print(f"sweep on 2 ranks against a process for each: {loop / two:.1f} times the throughput")
    print(f"2 ranks against 1: {single / two:.2f} times")


if __name__ == "__main__":
    main()
