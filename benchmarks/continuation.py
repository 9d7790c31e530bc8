"""Load steps and power series: factorizations and failed solves of bodies from publications, counted, not timed.

Jobs are solved once by ``solver: {continuation: steps}`` and once by ``series``, with factors and without nested
iteration and certificate. The last column is the largest difference of the shapes, relative to the displacement.
Scenes of SANM are solved if ``HPCINV_SCENES`` names their folder (`benchmarks/published/sanm`).

Command: mpirun -n 1 python benchmarks/continuation.py [jobs …]
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
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


def solved(path: Path, factor: float, continuation: str, comm: MPI.Intracomm) -> Result | None:
    job = hpcinv.load(path)
    changes: dict[str, Any] = {f"solver.{key}": value for key, value in SETTINGS.items()}
    changes |= {"solver.continuation": continuation, "certificate": "off"}
    if factor != 1.0:
        gravity = job.data["effects"][0]["acceleration"]
        changes["effects[0].acceleration"] = [f"{factor * float(str(g).split()[0])} m/s^2" for g in gravity]
    try:
        return hpcinv.run(job.with_(changes), comm, progress=False)
    except HpcinvError:
        return None


def counts(result: Result | None) -> str:
    """Return factorizations, and solves that failed in brackets."""
    if result is None:
        return "not solved"
    solution = result.solutions[0]
    return f"{solution.factorizations} ({sum(not solve.outcome.accepted for solve in solution.solves)})"


def difference(steps: Result | None, series: Result | None) -> str:
    if steps is None or series is None or steps.body.mesh.comm.size > 1:
        return ""
    shapes = [result.solutions[0].u for result in (steps, series)]
    return f"{np.abs(shapes[0] - shapes[1]).max() / np.abs(shapes[0]).max():.0e}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("jobs", nargs="*", type=Path, help="those to run; left out, all")
    chosen = [(path, 1.0) for path in parser.parse_args().jobs] or jobs()
    comm = MPI.COMM_WORLD
    say(comm, "| job | load steps: factorizations (failed solves) | power series | difference |")
    say(comm, "|---|---|---|---|")
    for path, factor in chosen:
        steps, series = (solved(path, factor, continuation, comm) for continuation in ("steps", "series"))
        name = path.stem if factor == 1.0 else f"{path.stem}, weight ×{factor:g}"
        say(comm, f"| {name} | {counts(steps)} | {counts(series)} | {difference(steps, series)} |")


def say(comm: MPI.Intracomm, line: str) -> None:
    if comm.rank == 0:
        print(line, flush=True)


if __name__ == "__main__":
    main()
