"""Complete solves with the iterative configuration: Krylov iterations over materials, shapes and directions.

Each is also solved directly, and the largest difference of the recovered nodes relative to the displacement is printed.

Command: mpirun -n 1 python benchmarks/linear_solvers.py [--divisions 8] [--beam "3 mm"]
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from bench_runs import WITHOUT_CERTIFICATE

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.job.job import parse
from hpcinv.output.result import Result

JOBS = Path(__file__).parents[1] / "jobs"
MATERIALS: dict[str, dict[str, Any]] = {
    "ν = 0.3": {"law": "neo-hookean", "young": "10 kPa", "poisson": 0.3},
    "ν = 0.45": {"law": "neo-hookean", "young": "10 kPa", "poisson": 0.45},
    "ν = 0.499": {"law": "neo-hookean", "young": "10 kPa", "poisson": 0.499},
    "ν = 0.49999": {"law": "neo-hookean", "young": "10 kPa", "poisson": 0.49999},
    "incompressible": {"law": "isochoric-neo-hookean", "mu": "3.33 kPa", "kappa": "incompressible"},
}
SILICONE = {"law": "mooney-rivlin", "c1": 101709.668, "c2": 151065.460, "d1": 7.965272689e8}


def shapes(n: int, size: str) -> dict[str, dict[str, Any]]:
    """Mesh, load and materials of each body."""

    def block(length: int, divisions: int, width: int, load: float) -> dict[str, Any]:
        parameters = {"lx": length, "nx": divisions, "ny": width, "nz": width}
        return {
            "mesh": {"file": "../meshes/box.py", "parameters": parameters},
            "effects": [{"effect": "gravity", "acceleration": [0, -9.81 * load, 0], "density": 1000}],
            "supports": [{"region": "x0", "fix": ["x", "y", "z"]}],
        }

    beam = {
        "mesh": {"file": "../meshes/pdms_beam.py", "parameters": {"size": size}, "geometry_degree": 2},
        "effects": [{"effect": "gravity", "acceleration": [0, -9.81, 0], "density": 963}],
        "supports": [{"region": "clamp", "fix": ["x", "y", "z"]}],
    }
    return {
        "cube": block(1, n, n, 0.1),
        "rod 10:1": block(10, 5 * n, n // 2, 2e-4),
        "rod 40:1": block(40, 15 * n // 2, n // 4, 2e-6),
        "silicone beam": beam,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--divisions", type=int, default=8, help="of the cube's edges, divisible by 4")
    parser.add_argument("--beam", default="3 mm", help="size of the beam's cells")
    options = parser.parse_args()
    say("| body | material | direction | unknowns | tangents | corrections | Krylov | per correction | difference |")
    say("|---|---|---|---|---|---|---|---|---|")
    for shape, data in shapes(options.divisions, options.beam).items():
        for name, material in ({"silicone": SILICONE} if shape == "silicone beam" else MATERIALS).items():
            for analysis in ("inverse", "forward"):
                row(shape, name, analysis, data | {"material": material, "analysis": analysis})


def row(shape: str, material: str, analysis: str, data: dict[str, Any]) -> None:
    direct, iterative = (solved(data, linear) for linear in ("direct", "iterative"))
    (solution,) = iterative.statistics["solutions"]
    largest = float(np.abs(direct.shape - iterative.shape).max(initial=0.0))
    difference = MPI.COMM_WORLD.allreduce(largest, op=MPI.MAX) / direct.solutions[0].largest_displacement
    krylov, corrections = solution["linear"]["iterations"], solution["newton_iterations"]
    unknowns = iterative.statistics["mesh"]["unknowns"]
    cells = [
        shape,
        material,
        analysis,
        unknowns,
        solution["factorizations"],
        corrections,
        krylov,
        f"{krylov / corrections:.0f}",
    ]
    if solution["linear"]["fallback"]:
        cells[-1] = solution["linear"]["fallback"]
    say(f"| {' | '.join(map(str, cells))} | {difference:.0e} |")


def solved(data: dict[str, Any], linear: str) -> Result:
    job = {**data, "solver": {"linear": linear, "rescue": []}, "certificate": WITHOUT_CERTIFICATE}
    return hpcinv.run(parse(job, JOBS / "benchmark.yaml"), MPI.COMM_WORLD, progress=False)


def say(line: str) -> None:
    if MPI.COMM_WORLD.rank == 0:
        print(line, flush=True)


if __name__ == "__main__":
    main()
