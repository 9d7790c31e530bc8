"""Continuation by load steps, by power series and by default, on bodies from publications.

Jobs are solved by ``solver: {continuation: steps}``, ``series`` and ``auto``, with factors and without nested iteration
and certificate. Of each the table has factorizations, failed solves in brackets, and processor seconds of the whole run
in a warm process, on this rank. The last two columns are the seconds of ``auto`` over the seconds of ``steps``, and the
largest difference of their shapes, relative to the displacement.
Scenes of SANM are solved if ``HPCINV_SCENES`` names their folder (`benchmarks/published/sanm`).

Command: mpirun -n 1 python benchmarks/continuation.py [jobs …]
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import hpcinv
from hpcinv.errors import HpcinvError
from hpcinv.output.result import Result
from hpcinv.parallel.runtime import MPI

ROOT = Path(__file__).parents[1]
PUBLISHED = (
    *("cook/cook", "cook/cook-incompressible", "land/problem-1", "elastica/elastica"),
    *("balloon/balloon", "euler/column"),
)
SETTINGS = {"linear": "direct", "nested_iteration": "off"}
CONTINUATIONS = ("steps", "series", "auto")


@dataclass(frozen=True)
class Run:
    """A result, ``None`` if there is none, and the processor seconds that it took on this rank."""

    result: Result | None
    seconds: float

    def __str__(self) -> str:
        if self.result is None:
            return f"not solved, {self.seconds:.2f} s"
        solution = self.result.solutions[0]
        failed = sum(not solve.outcome.accepted for solve in solution.solves)
        return f"{solution.factorizations} ({failed}), {self.seconds:.2f} s"


def jobs() -> Iterator[tuple[Path, float]]:
    """Jobs, and factors of their gravity."""
    scenes = os.environ.get("HPCINV_SCENES")
    for path in sorted(Path(scenes).glob("*.yaml")) if scenes else ():
        yield path, 1.0
    for name in ("pdms-beam-forward", "pdms-beam"):
        for factor in (1.0, 4.0):
            yield ROOT / "jobs" / f"{name}.yaml", factor
    for name in PUBLISHED:
        yield ROOT / "benchmarks" / "published" / f"{name}.yaml", 1.0


def solved(path: Path, factor: float, continuation: str, comm: MPI.Intracomm) -> Run:
    job = hpcinv.load(path)
    changes: dict[str, Any] = {f"solver.{key}": value for key, value in SETTINGS.items()}
    changes |= {"solver.continuation": continuation, "certificate": "off"}
    if factor != 1.0:
        gravity = job.data["effects"][0]["acceleration"]
        changes["effects[0].acceleration"] = [f"{factor * float(str(g).split()[0])} m/s^2" for g in gravity]
    begin = time.process_time()
    try:
        result = hpcinv.run(job.with_(changes), comm, progress=False)
    except HpcinvError:
        result = None
    return Run(result, time.process_time() - begin)


def difference(steps: Result | None, other: Result | None) -> str:
    if steps is None or other is None or steps.body.mesh.comm.size > 1:
        return ""
    shapes = [result.solutions[0].u for result in (steps, other)]
    return f"{np.abs(shapes[0] - shapes[1]).max() / np.abs(shapes[0]).max():.0e}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("jobs", nargs="*", type=Path, help="those to run; left out, all")
    chosen = [(path, 1.0) for path in parser.parse_args().jobs] or jobs()
    comm = MPI.COMM_WORLD
    say(comm, "| job | load steps | power series | auto | auto ÷ steps | difference |")
    say(comm, "|---|---|---|---|---|---|")
    for path, factor in chosen:
        solved(path, factor, "auto", comm)  # loads kernels
        steps, series, auto = (solved(path, factor, continuation, comm) for continuation in CONTINUATIONS)
        name = path.stem if factor == 1.0 else f"{path.stem}, weight ×{factor:g}"
        ratio = f"{auto.seconds / steps.seconds:.2f}"
        say(comm, f"| {name} | {steps} | {series} | {auto} | {ratio} | {difference(steps.result, auto.result)} |")


def say(comm: MPI.Intracomm, line: str) -> None:
    if comm.rank == 0:
        print(line, flush=True)


if __name__ == "__main__":
    main()
