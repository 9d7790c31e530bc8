"""Modes of forward tangents, spurious and physical ones, and what confirming them takes (docs/theory/stability.md).

``modes`` solves ``K v = ω M v`` on the discrete kernel of the volume constraint, with M the linear elastic energy, and
prints the lowest ω with the root mean square of the volume change over the gradient's. ``counts`` prints how many
negative eigenvalues the tangent has, and how many of them are confirmed with other penalties than the certificate's.
``price`` prints seconds: of a run without a certificate, of counting, and of confirming, kernels having been compiled.
``without-factors`` prints tangents and Krylov iterations of an iterative solve, seconds of it and of the line on
stability by iteration, and their ratio.

Command: mpirun -n 1 python benchmarks/stability.py modes|counts|price|without-factors
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from functools import partial
from math import pi, tanh
from pathlib import Path
from typing import Any

import hpcinv.base.parallel.runtime

# isort: split
import dolfinx.fem.petsc as fem_petsc
import numpy as np
import numpy.typing as npt
import scipy.linalg
import scipy.sparse
import ufl
from bench_runs import Findings
from bodies import beam
from bodies import block as block_of
from dolfinx import fem

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.job.job import Job, load, parse
from hpcinv.output.result import Result
from hpcinv.results.solution import Solution
from hpcinv.solver.equations import Equations
from hpcinv.trust.stability import confirmation
from hpcinv.trust.stability.inertia import inertia

ROOT = Path(__file__).parents[1]
NO_CERTIFICATE = "off"
PENALTIES = (0.0, 1.0, 5.0, 10.0, 20.0, 100.0)
"""Of which the certificate's is one."""


def block(divisions: tuple[int, int], stretch: float, *, height: float = 1.0, half: bool, hexahedra: bool) -> Job:
    """In plane strain between smooth plates, pressed to ``stretch``; its lower face free, or on a plane of symmetry."""
    nx, ny = divisions
    parameters = {"nx": nx, "ny": ny, "nz": 1, "ly": height, "lz": 0.2, "hexahedra": hexahedra}
    supports: list[dict[str, Any]] = [{"region": region, "fix": [region[0]]} for region in ("x0", "z0", "z1")]
    supports.append({"region": "x1", "displacement": [stretch - 1, None, None]})
    springs = {"effect": "elastic-foundation", "region": "x0", "tangential": 1e-5}  # against motion up and down
    data = {
        "analysis": "forward",
        "mesh": {"file": str(ROOT / "meshes" / "box.py"), "parameters": parameters},
        "material": {"law": "isochoric-neo-hookean", "mu": 1.0, "kappa": "incompressible"},
        "supports": [*supports, {"region": "y0", "fix": ["y"]}] if half else supports,
        "effects": [] if half else [springs],
        "certificate": NO_CERTIFICATE,
    }
    return parse(data, ROOT / "block.yaml")


def column(divisions: tuple[int, int], kh: float, share: float, *, hexahedra: bool) -> Job:
    """Pressed by a share of the strain at which it buckles with the wave number k and the half-height h."""
    stretches = np.linspace(0.99, 0.5, 100_000)
    s = stretches**2
    is_unstable = 4 * s * np.array([tanh(kh * v) for v in s]) < (1 + s**2) ** 2 * tanh(kh)
    critical = float(stretches[np.argmax(is_unstable != is_unstable[0])])
    height = 2 * kh * critical**2 / pi
    return block(divisions, 1 - share * (1 - critical), height=height, half=False, hexahedra=hexahedra)


def cases() -> Iterator[tuple[str, Job]]:
    for hexahedra in (True, False):
        kind = "hexahedra" if hexahedra else "tetrahedra"
        for n in (4, 6, 8):
            yield f"half-block, 0.75, {kind} {n}", block((n, n), 0.75, half=True, hexahedra=hexahedra)
        for share in (0.99, 1.01, 1.03, 1.1):
            yield f"column, kh = 1, {share}, {kind} 8×4", column((8, 4), 1.0, share, hexahedra=hexahedra)
        yield f"column, kh = 0.3, 1.1, {kind} 4×1", column((4, 1), 0.3, 1.1, hexahedra=hexahedra)
        for stretch in (0.55, 0.53, 0.49):
            yield f"half-block, {stretch}, {kind} 8", block((8, 8), stretch, half=True, hexahedra=hexahedra)


def solved(job: Job) -> tuple[Result, Equations, Solution]:
    result = hpcinv.run(job, MPI.COMM_WORLD, progress=False)
    model, solution = Equations(job, result.body, Timings()), result.solutions[0]
    model.put(solution.moved_to(solution.reference_nodes))
    return result, model, solution


def dense(form: Any, model: Equations, diagonal: float) -> npt.NDArray[np.float64]:
    matrix = fem_petsc.assemble_matrix(fem.form(form), bcs=model.supports.conditions, diag=diagonal)
    matrix.assemble()
    begins, columns, values = matrix.getValuesCSR()
    matrix_values: npt.NDArray[np.float64] = scipy.sparse.csr_matrix(
        (values, columns, begins), matrix.getSize()
    ).toarray()
    matrix.destroy()
    return matrix_values


def modes(job: Job, number: int = 3) -> list[str]:
    _, model, _ = solved(job)
    unknowns, weak_form = model.unknowns, model.weak_form("forward")
    weak_form.parameters.set_load(1.0)
    kin, trial = weak_form.kinematics, ufl.TrialFunction(unknowns.space)
    v, w = (kin.Grad(f) * kin.F_inverse for f in (unknowns.v, ufl.split(trial)[0]))
    forms = [ufl.inner(ufl.sym(v), ufl.sym(w)) * 2, ufl.tr(v) * ufl.tr(w), ufl.inner(v, w)]
    K = dense(ufl.derivative(weak_form.residual, unknowns.state, trial), model, 1.0)
    M, D, G = (dense(kin.dV(form), model, 0.0) for form in forms)
    held = [part.dofs for part in model.supports.prescribed]
    u = np.setdiff1d(unknowns.owned_displacement_dofs, np.concatenate(held))
    uu = np.ix_(u, u)
    kernel = scipy.linalg.null_space(K[np.ix_(unknowns.owned_pressure_dofs, u)], rcond=1e-11)
    K, M = (kernel.T @ matrix[uu] @ kernel for matrix in (K, M))
    M += 1e-8 * np.eye(len(M))  # motion up and down strains nothing
    values, vectors = scipy.linalg.eigh((K + K.T) / 2, (M + M.T) / 2, subset_by_index=[0, number - 1])
    shapes = (kernel @ vectors).T
    ratios = [np.sqrt((x @ D[uu] @ x) / (x @ G[uu] @ x)) for x in shapes]
    return [f"{value:+.3f} ({ratio:.3f})" for value, ratio in zip(values, ratios, strict=True)]


def negative(model: Equations) -> int:
    equilibrium = model.equilibrium(model.weak_form("forward"))
    equilibrium.system.linearise(1.0)
    counted = inertia(equilibrium.system.matrix)
    model.release(equilibrium)
    assert counted is not None
    return counted.negative - model.unknowns.pressure_size


def counts(job: Job) -> list[str]:
    result, model, solution = solved(job)
    texts = []
    texts.append(str(negative(model)))
    for penalty in PENALTIES:
        # A constant of the form: one kernel serves all penalties.
        confirmation.PENALTY = fem.Constant(result.body.mesh, penalty)
        confirmed = confirmation.confirm(model, solution)
        texts.append("-" if confirmed is None else str(confirmed.directions))
    return texts


def price(job: Job) -> list[str]:
    no_certificate = type(job.certificate).model_validate(NO_CERTIFICATE)
    job = job.model_copy(update={"certificate": no_certificate})
    seconds = []
    for _ in range(2):  # kernels are there the second time
        begin = time.perf_counter()
        _, model, solution = solved(job)
        seconds = [time.perf_counter() - begin]
        for count in (negative, partial(confirmation.confirm, solution=solution)):
            begin = time.perf_counter()
            count(model)
            seconds.append(time.perf_counter() - begin)
    return [str(model.unknowns.size), *(f"{value:.2f}" for value in seconds)]


def iteration_rows(size: int) -> Iterator[list[str]]:
    """The lowest eigenvalue by iteration after an iterative solve, which is its measure."""
    certificate = {"level": "off", "stability": True}
    for name, body, analysis in (("block", block_of, "inverse"), ("beam", beam, "forward")):
        data = body(size, analysis=analysis, certificate=certificate, solver={"linear": "iterative"})
        result = hpcinv.run(hpcinv.load(data), MPI.COMM_WORLD, progress=False)
        (line,) = (line for line in result.certificate.lines if line.name.startswith("stability"))
        phases = result.statistics["timings"]["phases"]
        work = ("newton", "residual", "tangent", "factorization", "linear solve", "admissibility check")
        solve = sum(phases[phase]["max"] for phase in work if phase in phases)
        summary, seconds = result.statistics, line.seconds or 0.0
        solution = summary["solutions"][0]
        effort = [summary["mesh"]["unknowns"], solution["factorizations"], solution["linear"]["iterations"]]
        yield [f"{name}, {analysis}", *map(str, effort), f"{solve:.1f}", f"{seconds:.1f}", f"{seconds / solve:.2f}"]


TABLES = {
    "modes": ["case", "first", "second", "third"],
    "counts": ["case", "tangent", *map(str, PENALTIES)],
    "price": ["job", "unknowns", "solve", "count", "confirm"],
    "without-factors": ["body", "unknowns", "tangents", "Krylov", "solve s", "stability s", "ratio"],
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=tuple(TABLES))
    parser.add_argument("--size", type=int, default=160_000, help="unknowns without factors, about (160000)")
    options = parser.parse_args()
    what = options.what
    rows: list[list[str]]
    if what == "without-factors":
        rows = list(iteration_rows(options.size))
    elif what == "price":
        names = ("coil-through-itself", "standing-beam")
        rows = [[name, *price(load(ROOT / "jobs" / "hard" / f"{name}.yaml"))] for name in names]
    else:
        rows = [[name, *(modes if what == "modes" else counts)(job)] for name, job in cases()]
    Findings(f"stability: {what}", TABLES[what], rows).show()


if __name__ == "__main__":
    main()
