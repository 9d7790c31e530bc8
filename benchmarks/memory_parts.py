"""Bytes of resident memory per unknown that each part of an iterative solve adds, on the sum of all ranks.

The body is the cube of krylov_counts.py. "at most" is the peak during a part, above the memory before it.

Command: mpirun -n RANKS python benchmarks/memory_parts.py [--size 100000] [--kind "P2, incompressible"]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from assembly import JOBS, say
from krylov_counts import KINDS, cube

# isort: split
import hpcinv.base.parallel.runtime  # noqa: F401  (its import order first)

# isort: split
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings, peak, resident
from hpcinv.job.job import parse
from hpcinv.mesh import build_body
from hpcinv.results.solution import solution_of
from hpcinv.solver.equations import Equations
from hpcinv.trust.certificate import CheckedRun, certify

SMALL = 2_000  # unknowns of the body that is measured first


def measure(size: int, kind: str) -> tuple[int, list[tuple[str, float, float]]]:
    """Return the number of unknowns, and for each part its name, the bytes that it adds, and those at most."""
    comm, rows = MPI.COMM_WORLD, list[tuple[str, float, float]]()

    def measured(name: str, part: Callable[[], Any]) -> Any:
        """Return what a part returns, and record its memory."""
        comm.Barrier()
        before = resident()
        made = part()
        kept, most = (comm.allreduce(max(value - before, 0)) for value in (resident(), peak()))
        rows.append((name, kept, most))
        return made

    job = parse(cube(size, *KINDS[kind]), JOBS / "benchmark.yaml")
    body = measured("mesh", lambda: build_body(job.mesh, job.regions, comm, resolve=job.resolve))
    model = measured("spaces and supports", lambda: Equations(job, body, Timings()))
    equilibrium = measured("forms and solver", lambda: model.equilibrium(model.weak_form("inverse")))
    measured("tangent", lambda: equilibrium.system.linearise(1.0))
    measured("preconditioner", equilibrium.linear.factorize)
    measured("Krylov vectors", lambda: equilibrium.correct(1.0))
    solution = solution_of(model, "inverse", equilibrium.system.weak_form, ())
    iterative = replace(solution, linear=equilibrium.linear.used)
    model.release(equilibrium)
    measured("certificate", lambda: certify(CheckedRun(model, [iterative], {})))
    return model.unknowns.size, rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=100_000, help="unknowns, about")
    parser.add_argument("--kind", choices=KINDS, default="P2, incompressible")
    options = parser.parse_args()
    measure(SMALL, options.kind)  # loads libraries and kernels
    unknowns, rows = measure(options.size, options.kind)
    say(f"{options.kind}: {unknowns} unknowns, {MPI.COMM_WORLD.size} ranks")
    say(f"{'bytes per unknown':22}{'kept':>8}{'at most':>10}")
    for name, kept, most in rows:
        say(f"{name:22}{kept / unknowns:8.0f}{most / unknowns:10.0f}")


if __name__ == "__main__":
    main()
