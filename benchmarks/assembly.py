"""Where the time of the tangent goes, and what other ways of assembling it take: processor time, in one run.

The ways take turns and the fastest of each counts, so that a noisy machine is unfair to none. "DOLFINx" is UFL's
derivative of the residual, compiled by FFCx and inserted by PETSc; "moduli" is hpcinv's, and what follows its parts:
moduli at points, their products with basis functions, and adding them up in their places.

Command: mpirun -n 1 python benchmarks/assembly.py [--repeat 5] [--cases beam sphere-hexahedra …] [--flags]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import hpcinv.base.parallel.runtime  # noqa: F401  (its import order first)

# isort: split
import dolfinx.fem.petsc as fem_petsc
import ufl
from dolfinx import fem
from petsc4py import PETSc

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.job.job import parse
from hpcinv.mesh import build_body
from hpcinv.model.assembly.csr_tangent import FilledTangent
from hpcinv.solver.equations import Equations

JOBS = Path(__file__).parents[1] / "jobs"
BEAM: dict[str, Any] = {
    "mesh": {"file": "../meshes/pdms_beam.py", "parameters": {"size": "2.2 mm"}, "geometry_degree": 2},
    "material": {"law": "mooney-rivlin", "c1": 101709.668, "c2": 151065.460, "d1": 7.965272689e8},
    "effects": [{"effect": "gravity", "acceleration": [0, -9.81, 0], "density": 963}],
    "supports": [{"region": "clamp", "fix": ["x", "y", "z"]}],
}
SPHERE: dict[str, Any] = {
    "mesh": {"file": "../meshes/thick_sphere.py", "geometry_degree": 2},
    "material": {"law": "isochoric-neo-hookean", "mu": "10 kPa", "kappa": "incompressible"},
    "effects": [{"effect": "pressure", "region": "inner", "pressure": "2 kPa"}],
    "supports": [{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"],
}
COARSE = {"mesh": BEAM["mesh"] | {"parameters": {"size": "4 mm"}}}
OGDEN = {"law": "ogden", "mu": ["0.63 MPa", "1.2 kPa", "-10 kPa"], "alpha": [1.3, 5, -2], "kappa": "2 GPa"}


def sphere(*, hexahedra: bool) -> dict[str, Any]:
    parameters = {"radial": 4, "along": 4, "hexahedra": hexahedra}
    return {**SPHERE, "mesh": SPHERE["mesh"] | {"parameters": parameters}, "analysis": "inverse"}


CASES: dict[str, dict[str, Any]] = {
    "beam": {"analysis": "inverse", **BEAM},
    "beam-forward": {"analysis": "forward", **BEAM},
    "beam-cubic": {"analysis": "inverse", **BEAM, **COARSE, "discretisation": {"displacement": 3}},
    "beam-compressible": {
        "analysis": "inverse",
        **BEAM,
        "material": {"law": "neo-hookean", "young": "1 MPa", "poisson": 0.3},
    },
    "beam-ogden": {"analysis": "inverse", **BEAM, **COARSE, "material": OGDEN},
    "sphere-tetrahedra": sphere(hexahedra=False),
    "sphere-hexahedra": sphere(hexahedra=True),
}
FLAGS = (
    ["-O1"],
    ["-O1", "-mavx"],
    ["-O2"],
    ["-O2", "-mavx"],
    ["-O1", "-ftree-vectorize", "-march=native"],
    ["-O2", "-march=native"],
    ["-O3", "-march=native"],
)


def fastest(ways: dict[str, Callable[[], object]], repeat: int) -> dict[str, float]:
    """Milliseconds of processor time of each."""
    best = dict.fromkeys(ways, float("inf"))
    for _ in range(repeat):
        for name, way in ways.items():
            start = time.process_time()
            way()
            best[name] = min(best[name], 1e3 * (time.process_time() - start))
    return best


def model_of(data: dict[str, Any]) -> Equations:
    job = parse(data, JOBS / "benchmark.yaml")
    return Equations(job, build_body(job.mesh, job.regions, MPI.COMM_WORLD, resolve=job.resolve), Timings())


def profile(name: str, data: dict[str, Any], repeat: int) -> None:
    model = model_of(data)
    weak_form, conditions = model.weak_form(data["analysis"]), model.supports.conditions
    weak_form.parameters.set_load(1.0)
    form = fem.form(ufl.derivative(weak_form.residual, weak_form.unknowns.state))
    theirs = fem_petsc.create_matrix(form)
    tangent = FilledTangent(weak_form)
    matrix, assemble = tangent.create_matrix(conditions)

    def dolfinx() -> None:
        theirs.zeroEntries()
        fem_petsc.assemble_matrix(theirs, form, bcs=conditions)
        theirs.assemble()

    def evaluate() -> None:
        for part in tangent._volume:
            for cells in part.chunks():
                part._values(weak_form.unknowns.mesh, part.cells[cells])

    def contract() -> None:
        for part in tangent._volume:
            for _ in part:
                pass

    times = fastest({"DOLFINx": dolfinx, "moduli": assemble, "points": evaluate, "matrices": contract}, repeat)
    theirs.axpy(-1.0, matrix, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
    gap = theirs.norm(PETSc.NormType.INFINITY) / matrix.norm(PETSc.NormType.INFINITY)
    total, points, matrices = times["moduli"], times["points"], times["matrices"]
    say(
        f"{name:20}{model.unknowns.size:9}{times['DOLFINx']:9.0f}{total:9.0f}{times['DOLFINx'] / total:7.1f}x"
        f"{points:9.0f}{matrices - points:9.0f}{total - matrices:9.0f}{gap:10.0e}"
    )


def say(line: str) -> None:
    if MPI.COMM_WORLD.rank == 0:
        print(line, flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--cases", nargs="*", choices=CASES, default=list(CASES))
    options = parser.parse_args()
    say(
        f"{'ms':20}{'unknowns':>9}{'DOLFINx':>9}{'moduli':>9}{'ratio':>8}{'points':>9}{'products':>9}{'places':>9}{'gap':>10}"
    )
    for name in options.cases:
        profile(name, CASES[name], options.repeat)


if __name__ == "__main__":
    main()
