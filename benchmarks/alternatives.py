"""What other discretisations and layouts would bring: discontinuous pressure, condensed or not; fewer points; blocks.

Run ``mpirun -n 1 python benchmarks/alternatives.py``. docs/notes/measurements.md shows what it prints.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

from bodies import block

import hpcinv.base.parallel.runtime  # its import order first

# isort: split
import basix.ufl
import numpy as np
import ufl
from bench_runs import WITHOUT_CERTIFICATE
from dolfinx import fem
from petsc4py import PETSc
from scipy import sparse

import hpcinv.model.assembly.tangent
from hpcinv.base.parallel.timings import SOLVER
from hpcinv.errors import SolveError
from hpcinv.job.job import Job, parse
from hpcinv.model.assembly.tangent import FormTangent
from hpcinv.model.spaces import Unknowns
from hpcinv.output.result import Result
from hpcinv.solver.linear.factorization import Direct

JOB = Path(__file__).parents[1] / "jobs" / "thick-sphere.yaml"
DIVISIONS = (4, 6, 8)
# jobs/study-sphere.yaml, which has them from the closed form with 30 digits
EXACT = {"inner-radius": 0.925436016079143, "stress": 4341.598088543859}
PRESSURES: dict[str, tuple[bool, Callable[[Any], Any] | None]] = {
    "Q2–Q1": (True, None),
    "Q2–P1 discontinuous": (True, lambda cell: basix.ufl.element("DPC", cell, 1)),
    "P2–P1": (False, None),
    "P2–P0 discontinuous": (False, lambda cell: basix.ufl.element("DG", cell, 0)),
}


def sphere(divisions: int, *, hexahedra: bool, kappa: str = "incompressible") -> Job:
    """The thick sphere of jobs/thick-sphere.yaml, inverse."""
    parameters = {"inner": "1 m", "outer": "1.5 m", "radial": divisions, "along": divisions, "hexahedra": hexahedra}
    return parse(
        {
            "job": "sphere",
            "mesh": {"file": "../meshes/thick_sphere.py", "parameters": parameters, "geometry_degree": 2},
            "material": {"law": "isochoric-neo-hookean", "mu": "10 kPa", "kappa": kappa},
            "effects": [{"effect": "pressure", "region": "inner", "pressure": "2 kPa"}],
            "supports": [{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"],
            "solver": {"linear": "direct"},
            "certificate": WITHOUT_CERTIFICATE,
            "quantities": [
                {"name": "inner-radius", "of": "norm(X, Y, Z)", "on": "inner", "reduce": "mean"},
                {"name": "stress", "of": "von_mises", "on": "inner", "reduce": "mean", "over": "current"},
            ],
        },
        JOB,
    )


@contextmanager
def pressure(element: Callable[[Any], Any] | None) -> Iterator[None]:
    """Within this context the pressure is in another space."""
    lagrange, asked = basix.ufl.element, []

    def chosen(family: str, cell: Any, degree: int, **rest: Any) -> Any:
        if rest:
            return lagrange(family, cell, degree, **rest)
        asked.append(degree)
        return element(cell) if element is not None and len(asked) % 2 == 0 else lagrange(family, cell, degree)

    with mock.patch("hpcinv.model.spaces.basix.ufl.element", chosen):
        yield


@contextmanager
def tangents(take: Callable[[PETSc.Mat], None]) -> Iterator[None]:
    """Show every tangent that is factorized."""
    prepare = Direct.prepare

    def shown(self: Direct, ksp: PETSc.KSP, matrix: PETSc.Mat) -> None:
        take(matrix)
        prepare(self, ksp, matrix)

    with mock.patch.object(Direct, "prepare", shown):
        yield


@contextmanager
def unknowns(take: Callable[[Unknowns], None]) -> Iterator[None]:
    """Show the unknowns of every model."""
    create = Unknowns.__init__

    def shown(self: Unknowns, *arguments: Any) -> None:
        create(self, *arguments)
        take(self)

    with mock.patch.object(Unknowns, "__init__", shown):
        yield


def _keep(matrices: list[PETSc.Mat], matrix: PETSc.Mat) -> None:
    matrices.append(matrix.copy())


def seconds_of(result: Result, phases: tuple[str, ...] = SOLVER) -> float:
    phase_seconds = result.statistics["timings"]["phases"]
    return sum(float(phase_seconds[phase]["max"]) for phase in phases if phase in phase_seconds)


def factorization(matrix: sparse.csr_array) -> tuple[float, float]:
    """Seconds (the fastest of three, with the ordering known) and Gflop."""
    arrays = (matrix.indptr.astype(PETSc.IntType), matrix.indices.astype(PETSc.IntType), matrix.data)
    A = PETSc.Mat().createAIJ(matrix.shape, csr=arrays)
    ksp = PETSc.KSP().create()
    ksp.setType("preonly")
    ksp.pc.setType("lu")
    ksp.pc.setFactorSolverType("mumps")
    taken = []
    for _ in range(4):
        A.scale(-1.0)  # another one, to PETSc
        ksp.setOperators(A)
        begun = time.perf_counter()
        ksp.setUp()
        taken.append(time.perf_counter() - begun)
    return min(taken[1:]), ksp.pc.getFactorMatrix().getMumpsRinfog(3) / 1e9


def condensed(K: sparse.csr_array, p: Any) -> sparse.csr_array:
    """The displacements' Schur complement where pressures of different cells have nothing in common."""
    u = np.setdiff1d(np.arange(K.shape[0]), p)
    D = K[p][:, p].tocsr()
    _, block_of = sparse.csgraph.connected_components(D)
    order = np.argsort(block_of, kind="stable")
    size = int(np.bincount(block_of)[0])
    entries = D[order][:, order].tocoo()
    blocks = np.zeros((len(p) // size, size, size))
    blocks[entries.row // size, entries.row % size, entries.col % size] = entries.data
    inverse = sparse.bsr_array((np.linalg.inv(blocks), np.arange(len(blocks)), np.arange(len(blocks) + 1)))
    return (K[u][:, u] - K[u][:, p[order]] @ inverse @ K[p[order]][:, u]).tocsr()


def pressures() -> None:
    print("incompressible sphere: errors relative to the closed form; then 100 times as stiff in volume: one tangent")
    for name, (hexahedra, element) in PRESSURES.items():
        for divisions in DIVISIONS:
            matrices: list[PETSc.Mat] = []
            spaces: list[Unknowns] = []
            with pressure(element):
                result = hpcinv.run(sphere(divisions, hexahedra=hexahedra), progress=False)
                with tangents(partial(_keep, matrices)), unknowns(spaces.append):
                    hpcinv.run(sphere(divisions, hexahedra=hexahedra, kappa="1 MPa"), progress=False)
            indptr, indices, data = matrices[0].getValuesCSR()
            K = sparse.csr_array((data, indices, indptr))
            taken, operations = factorization(K)
            solution = result.statistics["solutions"][0]
            errors = ", ".join(f"{what} {abs(result.quantities[what] / EXACT[what] - 1):.1e}" for what in EXACT)
            print(
                f"  {name}, {divisions} divisions, {K.shape[0]} unknowns: {errors}; solver {seconds_of(result):.2f} s"
                f" with {solution['factorizations']} factorizations; factorization {taken:.3f} s,"
                f" {operations:.1f} Gflop",
                flush=True,
            )
            if element is not None:
                begun = time.perf_counter()
                S = condensed(K, spaces[0].owned_pressure_dofs)
                condensing = time.perf_counter() - begun
                taken, operations = factorization(S)
                print(f"    condensed in {condensing:.3f} s: {taken:.3f} s, {operations:.1f} Gflop", flush=True)


def fewer_points() -> None:
    print("tangent with fewer quadrature points than the residual")
    for hexahedra, degree, what in ((True, 3, "8 of 27"), (False, 1, "1 of 4")):

        def create(self: FormTangent, weak_form: Any) -> None:
            integrals = weak_form.residual.integrals()
            cells = [i for i in integrals if i.integral_type() == "cell"]
            rest = [i for i in integrals if i.integral_type() != "cell"]
            fewer = [i.reconstruct(metadata={**i.metadata(), "quadrature_degree": degree}) for i in cells]  # noqa: B023
            state, trial = weak_form.unknowns.state, ufl.TrialFunction(weak_form.unknowns.space)
            form = ufl.derivative(ufl.Form([*fewer, *rest]), state, trial)
            self._form = fem.form(form)

        with mock.patch.object(FormTangent, "__init__", create):
            try:
                result = hpcinv.run(sphere(4, hexahedra=hexahedra), progress=False)
                iterations = result.statistics["solutions"][0]["newton_iterations"]
                print(f"  {what} points: {iterations} iterations")
            except SolveError as error:
                print(f"  {what} points: {str(error).splitlines()[0]}", flush=True)


def layouts() -> None:
    print("a product of the displacement block and a vector, block of 48,000 unknowns")
    matrices: list[PETSc.Mat] = []
    spaces: list[Unknowns] = []
    job = block(48_000, certificate=WITHOUT_CERTIFICATE, solver={"linear": "direct"})
    with tangents(partial(_keep, matrices)), unknowns(spaces.append):
        hpcinv.run(parse(dict(job), JOB), progress=False)
    rows = PETSc.IS().createGeneral(spaces[0].owned_displacement_dofs.tolist())
    for name, inodes in (("AIJ with inodes", False), ("AIJ", True)):
        PETSc.Options().setValue("mat_no_inode", inodes)
        A = matrices[0].createSubMatrix(rows, rows)
        print(f"  {name}: {_product(A):.2f} ms")
    A.setBlockSize(3)
    print(f"  BAIJ: {_product(A.convert('baij', out=PETSc.Mat())):.2f} ms", flush=True)


def _product(A: PETSc.Mat) -> float:
    """Milliseconds."""
    x, y = A.createVecRight(), A.createVecLeft()
    x.setRandom()
    taken = []
    for _ in range(10):
        begun = time.perf_counter()
        for _ in range(10):
            A.mult(x, y)
        taken.append(100 * (time.perf_counter() - begun))
    return min(taken)


if __name__ == "__main__":
    layouts()
    fewer_points()
    pressures()
