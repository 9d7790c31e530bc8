"""Factors in single precision, and factors of earlier tangents: the same answers, and what happens where they fail."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from helpers.linear_cases import BEAM, MATERIALS, SHELF
from helpers.verification import Solved, box, job
from petsc4py import PETSc

import hpcinv.solver.linear.selection
from hpcinv import run
from hpcinv.base.parallel.petsc_vectors import norm
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.model.assembly.system import System
from hpcinv.output.result import Result
from hpcinv.solver.linear.convergence_test import Refinement
from hpcinv.solver.linear.refined import Refined
from hpcinv.solver.linear.selection import Choice
from hpcinv.solver.linear_solver import LinearSolver

SINGLE = Choice("direct", "", precision="single", is_refined=True)


@pytest.fixture
def rounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Single precision at any size."""
    monkeypatch.setattr(hpcinv.solver.linear.selection, "SINGLE", 0.0)


def solved(comm: MPI.Intracomm, **data: Any) -> tuple[Result, dict[str, Any]]:
    solver = {"continuation": "steps"} | data.get("solver", {})  # of compact bodies, series take double precision
    result = run(job(**data | {"solver": solver}), comm)
    linear: dict[str, Any] = result.statistics["solutions"][0]["linear"]
    return result, linear


def difference(comm: MPI.Intracomm, first: Result, other: Result) -> float:
    """Largest difference of the shapes, relative to the displacement."""
    largest = float(np.abs(first.shape - other.shape).max(initial=0.0))
    return float(comm.allreduce(largest, op=MPI.MAX)) / first.solutions[0].largest_displacement


@pytest.mark.everyday("-compressible-inverse", "-incompressible-inverse")
@pytest.mark.parallel([1, 3, 2])
@pytest.mark.parametrize(("material", "analysis"), list(itertools.product(MATERIALS, ["inverse", "forward"])))
@pytest.mark.usefixtures("rounded")
def test_rounded_and_kept_factors_give_the_answer_of_double_precision(
    material: str, analysis: str, comm: MPI.Intracomm
) -> None:
    data = {**SHELF, "material": MATERIALS[material], "analysis": analysis}
    double, linear = solved(comm, **data, solver={"linear": "direct", "petsc": {"pc_precision": "double"}})
    assert linear["note"] == ""
    assert linear["iterations"] == 0
    single, linear = solved(comm, **data, solver={"linear": "direct"})
    assert linear["note"] == "factors in single precision, refined by FGMRES"
    assert linear["fallback"] is None
    assert linear["iterations"] > 0
    assert difference(comm, single, double) < 1e-10
    of_double, of_single = (result.solutions[0] for result in (double, single))
    assert of_single.factorizations <= of_double.factorizations
    assert {sign for solve in of_single.solves for sign in solve.signs} == {
        sign for solve in of_double.solves for sign in solve.signs
    }
    counts = [
        sum(len(solve.iterations) for solve in solver_statistics.solves) for solver_statistics in (of_double, of_single)
    ]
    assert counts[1] <= counts[0] + 2


@pytest.mark.everyday("inverse")
@pytest.mark.parametrize("analysis", ["inverse", "forward"])
@pytest.mark.usefixtures("rounded")
def test_a_slender_body_that_turns_far_needs_no_double_precision(analysis: str, comm: MPI.Intracomm) -> None:
    single, linear = solved(comm, **BEAM, analysis=analysis)
    assert linear["fallback"] is None
    double, _ = solved(comm, **BEAM, analysis=analysis, solver={"petsc": {"pc_precision": "double"}})
    assert difference(comm, single, double) < 1e-10


@pytest.mark.release
@pytest.mark.parallel([1, 2])
@pytest.mark.usefixtures("rounded")
def test_blocks_of_low_rank_do_as_well(comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hpcinv.solver.linear.selection, "LOW_RANK", 0.0)
    data = {**SHELF, "material": MATERIALS["incompressible"], "solver": {"linear": "direct"}}
    compressed, linear = solved(comm, **data)
    assert linear["note"] == "factors in single precision, with blocks of low rank, refined by FGMRES"
    monkeypatch.setattr(hpcinv.solver.linear.selection, "SINGLE", np.inf)
    double, linear = solved(comm, **data)
    assert linear["note"] == ""
    assert difference(comm, compressed, double) < 1e-10


@pytest.mark.parallel([2, 1])
@pytest.mark.usefixtures("rounded")
def test_a_body_too_badly_conditioned_for_single_precision_is_solved_in_double(comm: MPI.Intracomm) -> None:
    rod: dict[str, Any] = {
        "mesh": box((40, 1, 1), lx=400.0),  # (400:1)² times softer in bending than in tension
        "material": {"law": "neo-hookean", "young": "10 kPa", "poisson": 0.49999},
        "effects": [{"effect": "gravity", "acceleration": [0, -9.81, 0], "density": 1e-6}],
        "supports": [{"region": "x0", "fix": ["x", "y", "z"]}],
    }
    single, linear = solved(comm, **rod, solver={"linear": "direct", "rescue": []})
    assert linear["fallback"] == "factors in single precision did not suffice: double precision from there on"
    assert linear["note"] == ""
    assert 0 < linear["iterations"] <= 50  # those that failed
    double, _ = solved(comm, **rod, solver={"linear": "direct", "petsc": {"pc_precision": "double"}})
    # The same arithmetic from there on; each solve leaves an error of up to Newton's tolerance, 1e-12.
    assert difference(comm, single, double) < 4e-12


@pytest.mark.release
@pytest.mark.usefixtures("rounded")
def test_a_job_may_have_double_precision_or_single_at_any_size(
    comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = {**SHELF, "material": MATERIALS["compressible"]}
    assert solved(comm, **data, solver={"linear": "direct", "petsc": {"pc_precision": "double"}})[1]["note"] == ""
    monkeypatch.setattr(hpcinv.solver.linear.selection, "SINGLE", np.inf)
    assert solved(comm, **data, solver={"linear": "direct"})[1]["note"] == ""
    single = solved(comm, **data, solver={"linear": "direct", "petsc": {"pc_precision": "single"}})[1]
    assert single["note"].startswith("factors in single precision")


@pytest.mark.everyday("inverse")
@pytest.mark.usefixtures("rounded")
@pytest.mark.parametrize("analysis", ["inverse", "forward"])
def test_the_tolerance_of_a_job_counts_with_factors_in_single_precision(analysis: str, comm: MPI.Intracomm) -> None:
    data = {**SHELF, "material": MATERIALS["compressible"], "analysis": analysis}
    shapes = {}
    for tolerance in (1e-3, 1e-10):
        result, linear = solved(comm, **data, solver={"linear": "direct", "petsc": {"ksp_rtol": tolerance}})
        assert linear["fallback"] is None
        assert linear["note"].startswith("factors in single precision")
        shapes[tolerance] = result, linear["iterations"]
    (rough, few), (exact, many) = shapes.values()
    assert few < many
    assert difference(comm, rough, exact) < 1e-8


@pytest.mark.release
@pytest.mark.parallel([1, 2])
def test_systems_without_newton_are_solved_to_ten_digits(comm: MPI.Intracomm) -> None:
    body = Solved(job(**BEAM | {"analysis": "inverse"}), comm)
    system = System(body.weak_form, body.model.supports, Timings())
    system.linearise(1.0)
    system.residual(system.rhs)
    system.rhs.setRandom()
    solutions = []
    for choice in (Choice("direct", ""), SINGLE):
        linear = LinearSolver(system, {}, choice)
        x = system.rhs.duplicate()
        assert linear.solve(system.rhs, x)
        solutions.append(x)
        linear.destroy()
    size = norm(solutions[0])
    solutions[0].axpy(-1.0, solutions[1])
    assert norm(solutions[0]) < 1e-8 * size  # rounding errors of double precision times the condition of the beam
    system.destroy()


def test_factors_are_renewed_where_the_determinant_may_have_changed_its_sign(comm: MPI.Intracomm) -> None:
    n = 20
    A = PETSc.Mat().createAIJ((n, n), nnz=1, comm=comm)
    entries = np.linspace(1.0, 1.2, n)

    def assemble() -> None:
        for i in range(n):
            A.setValue(i, i, entries[i])
        A.assemble()

    assemble()
    configuration = Refined(low_rank=False)
    ksp = PETSc.KSP().create(comm)
    ksp.setOperators(A)
    ksp.setType(PETSc.KSP.Type.FGMRES)
    ksp.pc.setType(PETSc.PC.Type.LU)
    ksp.pc.setFactorSolverType("mumps")
    configuration.prepare(ksp, A)
    ksp.setUp()
    ksp.pc.setReusePreconditioner(True)
    x, b = A.createVecs()
    b.set(1.0)
    renewals = []
    for entry in (1.1, 0.2, -0.2):
        entries[7] = entry
        assemble()
        assert configuration.keep(ksp)
        ksp.solve(b, x)
        renewals.append(configuration.must_renew(ksp))
    assert renewals == [False, False, True]
    configuration.destroy()
    for part in (A, x, b, ksp):
        part.destroy()


def test_without_prospect_kept_factors_are_given_up(comm: MPI.Intracomm) -> None:
    """The iterations are counted: a diagonal that is far from the factors' takes many."""
    test = Refinement()
    test.is_kept, test.patience = True, 10.0
    for spread, gives_up in ((1.2, False), (1e4, True)):
        A = PETSc.Mat().createAIJ((100, 100), nnz=1, comm=comm)
        for i, entry in enumerate(np.geomspace(1.0, spread, 100)):
            A.setValue(i, i, entry)
        A.assemble()
        ksp = PETSc.KSP().create(comm)
        ksp.setOperators(A)
        ksp.setType(PETSc.KSP.Type.FGMRES)
        ksp.pc.setType(PETSc.PC.Type.NONE)
        ksp.setConvergenceTest(test)
        x, b = A.createVecs()
        b.set(1.0)
        ksp.solve(b, x)
        assert test.gave_up is gives_up
        assert ksp.getIterationNumber() <= 6
        for part in (A, x, b, ksp):
            part.destroy()
    test.destroy()
