"""Where Krylov iterations for a correction end: the solution decides, since the residual alone does not show it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.linear_cases import BEAM, MATERIALS, SHELF
from helpers.verification import Solved, job
from petsc4py import PETSc

from hpcinv import run
from hpcinv.base.parallel.petsc_vectors import norm
from hpcinv.base.parallel.runtime import MPI
from hpcinv.solver.equilibrium import Equilibrium
from hpcinv.solver.linear.convergence_test import Settling


def diagonal(comm: Any, entries: np.ndarray, test: Settling | None, tolerance: float) -> tuple[float, int]:
    """Error and iterations of FGMRES for ``D x = D 1``, without a preconditioner: soft motions hardly load it."""
    A = PETSc.Mat().createAIJ((len(entries), len(entries)), nnz=1, comm=comm)
    begin, end = A.getOwnershipRange()
    for i in range(begin, end):
        A.setValue(i, i, entries[i])
    A.assemble()
    ksp = PETSc.KSP().create(comm)
    ksp.setOperators(A)
    ksp.setType(PETSc.KSP.Type.FGMRES)
    ksp.pc.setType(PETSc.PC.Type.NONE)
    ksp.setGMRESRestart(200)
    ksp.setTolerances(rtol=tolerance, max_it=300)
    if test is not None:
        ksp.setConvergenceTest(test)
    x, b = A.createVecs()
    exact = b.duplicate()
    exact.set(1.0)
    A.mult(exact, b)
    ksp.solve(b, x)
    x.axpy(-1.0, exact)
    figures = norm(x) / norm(exact), ksp.getIterationNumber()
    for part in (A, ksp, x, b, exact):
        part.destroy()
    return figures


@pytest.mark.parallel([1, 2])
def test_soft_systems_are_corrected_for_longer_than_stiff_ones(comm: MPI.Intracomm) -> None:
    soft, stiff = np.geomspace(1e-3, 1.0, 60), np.geomspace(0.1, 1.0, 60)
    assert diagonal(comm, soft, None, 1e-2)[0] > 0.3  # the residual says that this is as good
    assert diagonal(comm, stiff, None, 1e-2)[0] < 0.05  # as this is
    test = Settling()
    errors, iterations = zip(*(diagonal(comm, entries, test, 1e-5) for entries in (soft, stiff)), strict=True)
    assert max(errors) < Settling.change
    assert iterations[1] < 0.7 * diagonal(comm, stiff, None, 1e-5)[1]
    test.precise = True
    assert diagonal(comm, stiff, test, 1e-5)[0] < 1e-9
    test.destroy()


@pytest.mark.parallel([1, 2])
def test_the_solvers_own_limits_hold(comm: MPI.Intracomm) -> None:
    entries, test = np.geomspace(1e-3, 1.0, 60), Settling()
    whole = diagonal(comm, entries, test, 1e-30)[1]
    assert diagonal(comm, entries, test, 0.1)[1] < whole
    test.most = 5
    assert diagonal(comm, entries, test, 1e-30)[1] == 5
    test.precise = True
    assert diagonal(comm, entries, test, 1e-30)[1] > 5
    test.destroy()


@pytest.mark.release
def test_the_jobs_own_tolerance_wins(comm: MPI.Intracomm) -> None:
    def iterations(**petsc: Any) -> int:
        solver = {"linear": "iterative", "petsc": petsc}
        (solution,) = run(job(**SHELF, material=MATERIALS["incompressible"], solver=solver), comm).solutions
        return sum(s.linear_iterations for s in solution.solves)

    usual = iterations()
    assert usual < iterations(ksp_rtol=1e-5) < iterations(ksp_rtol=1e-8)


def correction(equilibrium: Equilibrium, *, precise: bool) -> tuple[PETSc.Vec, int]:
    """The first one from the unloaded body, and the Krylov iterations it took."""
    x = equilibrium.system.rhs.duplicate()
    equilibrium.linear.configuration.set_accuracy(precise=precise)
    assert equilibrium.linear.back_substitute(equilibrium.system.rhs, x)
    return x, equilibrium.linear.take_iterations()


@pytest.mark.everyday("chunky-forward")
@pytest.mark.parallel([2, 1])
@pytest.mark.parametrize("analysis", ["inverse", "forward"])
@pytest.mark.parametrize("body", ["chunky", "slender"])
def test_a_correction_is_right_to_two_digits(body: str, analysis: str, comm: MPI.Intracomm) -> None:
    data: dict[str, Any] = {**SHELF, "material": MATERIALS["incompressible"]} if body == "chunky" else BEAM
    solved = Solved(job(**data, analysis=analysis, solver={"linear": "iterative"}), comm)
    solved.model.unknowns.state.x.array[:] = 0.0  # the residual of the solution is rounding
    equilibrium = solved.model.equilibrium(solved.weak_form)
    equilibrium.system.linearise(1.0)
    equilibrium.system.residual(equilibrium.system.rhs)
    equilibrium.linear.factorize()
    (short, few), (exact, many) = (correction(equilibrium, precise=precise) for precise in (False, True))
    short.axpy(-1.0, exact)
    assert norm(short) < 0.03 * norm(exact)
    assert few < many / 2
    short.destroy()
    exact.destroy()
    equilibrium.destroy()
