"""Continuation by load steps, by power series and by default, on bodies from publications.

Jobs are solved by ``solver: {continuation: steps}``, ``series`` and ``auto``, with factors and without nested iteration
and certificate. Of each the table has factorizations, failed solves in brackets, and processor seconds of set-up and
solution in a warm process, on this rank. Where the full load is not reached, the load factor stands first. The last two
columns are the seconds of ``auto`` over the seconds of ``steps``, and the largest difference of their displacements,
relative to the largest. Scenes of SANM are solved if ``HPCINV_SCENES`` names their folder
(`benchmarks/published/sanm`).

Command: mpirun -n 1 python benchmarks/continuation.py [jobs …]
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import hpcinv
from hpcinv.errors import HpcinvError
from hpcinv.mesh import build_body
from hpcinv.methods import DirectMethod
from hpcinv.parallel.runtime import MPI
from hpcinv.parallel.timings import Timings
from hpcinv.solver.equations import Equations
from hpcinv.solver.newton import Solve

ROOT = Path(__file__).parents[1]
PUBLISHED = (
    *("cook/cook", "cook/cook-incompressible", "land/problem-1", "land/problem-2", "land/problem-3"),
    *("elastica/elastica", "bisshopp/cantilever", "balloon/balloon", "calculix/beamnld", "code-aster/ssnv122"),
    *("sze/shear", "sze/slit"),
)
SETTINGS = {"linear": "direct", "nested_iteration": "off"}
CONTINUATIONS = ("steps", "series", "auto")


@dataclass(frozen=True)
class Run:
    """Solves of a job, the displacement at their end on this rank, and the processor seconds that they took there."""

    solves: Sequence[Solve]
    displacement: npt.NDArray[np.float64]
    seconds: float

    @property
    def load(self) -> float:
        return max((solve.load for solve in self.solves if solve.outcome.accepted), default=0.0)

    def __str__(self) -> str:
        factorizations = sum(solve.factorizations for solve in self.solves)
        failed = sum(not solve.outcome.accepted for solve in self.solves)
        end = "" if self.load == 1.0 else f"load {self.load:.6g}: "
        return f"{end}{factorizations} ({failed}), {self.seconds:.2f} s"


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
    for path in sorted((ROOT / "jobs" / "hard").glob("*.yaml")):
        yield path, 1.0


def solved(path: Path, factor: float, continuation: str, comm: MPI.Intracomm) -> Run:
    job = hpcinv.load(path)
    changes: dict[str, Any] = {f"solver.{key}": value for key, value in SETTINGS.items()}
    changes |= {"solver.continuation": continuation}
    if factor != 1.0:
        gravity = job.data["effects"][0]["acceleration"]
        changes["effects[0].acceleration"] = [f"{factor * float(str(g).split()[0])} m/s^2" for g in gravity]
    job, begin = job.with_(changes), time.process_time()
    equations = Equations(job, build_body(job.mesh, job.regions, comm, resolve=job.resolve), Timings())
    method = DirectMethod(equations, job.directions[0])
    solves = list(method.solves())
    method.equilibrium.destroy()
    return Run(solves, equations.unknowns.displacement().x.array.copy(), time.process_time() - begin)


def difference(steps: Run, other: Run) -> str:
    if not steps.load == other.load == 1.0:
        return ""
    u, v = steps.displacement, other.displacement
    return f"{np.abs(u - v).max() / np.abs(u).max():.0e}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("jobs", nargs="*", type=Path, help="those to run; left out, all")
    chosen = [(path, 1.0) for path in parser.parse_args().jobs] or jobs()
    comm = MPI.COMM_WORLD
    say(comm, "| job | load steps | power series | auto | auto ÷ steps | difference |")
    say(comm, "|---|---|---|---|---|---|")
    for path, factor in chosen:
        try:
            solved(path, factor, "auto", comm)  # loads kernels
            steps, series, auto = (solved(path, factor, continuation, comm) for continuation in CONTINUATIONS)
        except HpcinvError:  # a job that is hard to set up
            continue
        name = path.stem if factor == 1.0 else f"{path.stem}, weight ×{factor:g}"
        ratio = f"{auto.seconds / steps.seconds:.2f}"
        say(comm, f"| {name} | {steps} | {series} | {auto} | {ratio} | {difference(steps, auto)} |")


def say(comm: MPI.Intracomm, line: str) -> None:
    if comm.rank == 0:
        print(line, flush=True)


if __name__ == "__main__":
    main()
