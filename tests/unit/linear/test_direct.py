"""The direct solver tells why a factorization failed."""

import numpy as np
from petsc4py import PETSc

from hpcinv.solver.linear.direct import Direct


def test_entries_that_are_not_numbers_are_no_lack_of_memory() -> None:
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
    assert not Direct(symmetric=False).lacked_memory(ksp)
