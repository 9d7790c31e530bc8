"""The direct solver says why a factorization failed."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from petsc4py import PETSc

from hpcinv.model.outcome import Outcome
from hpcinv.solver.linear.factorization import Direct


def test_entries_that_are_not_numbers_are_not_reported_as_lack_of_memory() -> None:
    """MUMPS reports a workspace that is too small. Multigrid, which was tried then, ended the run."""
    size = 2000
    columns = np.arange(size)[:, None] + np.arange(-1, 2)
    rows, columns = np.repeat(np.arange(size + 1), 3)[: 3 * size], columns.clip(0, size - 1).ravel()
    matrix = PETSc.Mat().createAIJ([size, size], nnz=3)
    for row, column in zip(rows.tolist(), columns.tolist(), strict=True):
        matrix[row, column] = 2.0 if row == column else -1.0
    matrix[size // 2, size // 2] = np.nan
    matrix.assemble()
    ksp = PETSc.KSP().create()
    ksp.setType(PETSc.KSP.Type.PREONLY)
    ksp.pc.setType(PETSc.PC.Type.LU)
    ksp.pc.setFactorSolverType("mumps")
    ksp.setOperators(matrix)
    b, x = matrix.createVecs()
    b.set(1.0)
    ksp.solve(b, x)
    assert ksp.getConvergedReason() < 0
    solver = Direct(symmetric=False)
    assert not solver.larger_workspace(ksp)
    assert solver.failure(ksp) is Outcome.LINEAR_SOLVER


@pytest.mark.parametrize(
    ("code", "failure"),
    [
        (-9, Outcome.NO_MEMORY),  # workspace
        (-17, Outcome.NO_MEMORY),  # buffer for messages
        (-13, Outcome.NO_MEMORY),  # allocation
        (-19, Outcome.MEMORY_LIMIT),  # ICNTL(23)
        (-10, Outcome.LINEAR_SOLVER),  # singular
    ],
)
def test_codes_of_mumps_are_distinguished(code: int, failure: Outcome, monkeypatch: pytest.MonkeyPatch) -> None:
    """Only a lack of workspace or buffers is worth a repetition, as long as there is memory for it."""
    identity = PETSc.Mat().createAIJ([100, 100], nnz=1)
    identity.setDiagonal(identity.createVecLeft())
    identity.assemble()

    class Factors:
        def getMumpsInfog(self, number: int) -> int:
            return {1: code, 17: 1}[number]

        def getMumpsIcntl(self, number: int) -> int:
            return {14: 60}[number]

    monkeypatch.setattr("hpcinv.solver.linear.factorization.is_mumps", lambda pc: True)
    pc = SimpleNamespace(getFactorMatrix=Factors, getOperators=lambda: (identity, identity))
    ksp: Any = SimpleNamespace(pc=pc, getOperators=pc.getOperators)
    solver = Direct(symmetric=False)
    assert solver.failure(ksp) is failure
    assert solver.larger_workspace(ksp) == ({"mat_mumps_icntl_14": 120} if code in (-9, -17) else {})
    monkeypatch.setattr("hpcinv.solver.linear.factorization.available", lambda comm: 1e6)
    assert not solver.larger_workspace(ksp)
