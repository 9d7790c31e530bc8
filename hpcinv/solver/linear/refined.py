"""Factorization in single precision, refined by FGMRES in double precision; factors may serve for several tangents.

Rounding the factors to single precision halves their memory, and nearly the time of a factorization; block low-rank
factors of large bodies take less of both (Amestoy et al., ACM Trans. Math. Softw. 45, 2, 2019, doi:10.1145/3242094).
FGMRES restores what that loses (Carson & Higham, SIAM J. Sci. Comput. 40, A817–A847, 2018, doi:10.1137/17M1140819).

It also restores what the lower triangle of a tangent adds to the upper one, which L D Lᵀ is made from, if that is
little: inverse tangents are nearly symmetric as long as displacements are small, and forward ones under pressure. These
factors take half of the memory of L U, and the certificate can take them.

The factors of an earlier tangent are a good preconditioner as well, as long as that takes fewer iterations than new
factors are worth. The operator is then ``K M⁻¹``, with the factors M. Its determinant is negative where the signs of
the determinants differ; factors are renewed if the Krylov space shows a negative eigenvalue.
"""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from petsc4py import PETSc

from hpcinv.model.spaces import Unknowns
from hpcinv.solver.linear.convergence_test import Refinement
from hpcinv.solver.linear.factorization import Direct, is_mumps
from hpcinv.solver.petsc_options import OptionValue

_LOW_RANK: Mapping[str, OptionValue] = {
    "mat_mumps_icntl_35": 2,  # for factorization and solution
    "mat_mumps_cntl_7": 1e-5,  # relative error of a block
}
_NEARLY = 1e-3  # asymmetry of a nearly symmetric tangent
_MOST = 50  # iterations with factors of the tangent itself; more of them show that it is too badly conditioned

# Seconds for an operation and an entry in a factorization, and for an entry and a row in an iteration.
_OPERATION, _ENTRY, _ITERATION, _ROW = 1e-11, 7e-9, 6e-10, 2e-7


class Refined(Direct):
    """Configuration of the direct solver with factors in single precision, or factors for several tangents.

    Args:
        precision: of the factors, "single" or "double".
        low_rank: whether to compress blocks of the factors.
        unknowns, symmetric, minimum_fill: as for `Direct`.
        nearly_symmetric: whether nearly symmetric tangents are factorized by L D Lᵀ too.
    """

    exact: ClassVar[bool] = False
    error = Refinement.error

    def __init__(
        self,
        unknowns: Unknowns | None = None,
        *,
        low_rank: bool,
        precision: str = "single",
        symmetric: bool = True,
        minimum_fill: bool = False,
        nearly_symmetric: bool = False,
    ) -> None:
        super().__init__(unknowns, symmetric=symmetric, minimum_fill=minimum_fill)
        if nearly_symmetric:
            self.asymmetry = _NEARLY
        self._low_rank, self._precision, self._has_own_tolerance = low_rank, precision, False

    @property
    def options(self) -> Mapping[str, OptionValue]:
        return {
            **super().options,
            "ksp_type": "fgmres",
            "ksp_gmres_restart": _MOST,
            "ksp_max_it": _MOST,
            **({"pc_precision": "single"} if self._precision == "single" else {}),
            **(_LOW_RANK if self._low_rank else {}),
        }

    @property
    def note(self) -> str:
        compressed = ", with blocks of low rank" if self._low_rank else ""
        return f"factors in {self._precision} precision{compressed}, refined by FGMRES"

    def prepare(self, ksp: PETSc.KSP, matrix: PETSc.Mat) -> None:
        super().prepare(ksp, matrix)
        ksp.setComputeEigenvalues(True)
        self._has_own_tolerance = PETSc.Options(ksp.getOptionsPrefix()).hasName("ksp_rtol")
        if not self._has_own_tolerance:  # the job's has priority
            ksp.setConvergenceTest(self.test)
        self.test.is_kept = False

    def keep(self, ksp: PETSc.KSP) -> bool:
        # Without the test, nothing shows when kept factors take too many iterations.
        if not is_mumps(ksp.pc) or self._has_own_tolerance:
            return False
        if not self.test.is_kept:
            self.test.patience = _patience(ksp)
        self.test.is_kept = True
        return True

    def must_renew(self, ksp: PETSc.KSP) -> bool:
        return self.test.is_kept and (self.test.gave_up or _negative_eigenvalues(ksp) > 0)

    def sign_of_determinant(self, ksp: PETSc.KSP) -> int:
        sign = super().sign_of_determinant(ksp)
        return -sign if _negative_eigenvalues(ksp) % 2 else sign


def _patience(ksp: PETSc.KSP) -> float:
    """Return the number of iterations that take the time of a factorization, by MUMPS's own counts."""
    factors = ksp.pc.getFactorMatrix()
    entries = float(factors.getMumpsInfog(29))
    entries = -1e6 * entries if entries < 0 else entries  # MUMPS users' guide, ch. 8
    factorization = _OPERATION * factors.getMumpsRinfog(3) + _ENTRY * entries
    return factorization / (_ITERATION * entries + _ROW * ksp.getOperators()[0].getSize()[0])


def _negative_eigenvalues(ksp: PETSc.KSP) -> int:
    """Return the number of negative eigenvalues that the Krylov space of the last solution shows."""
    values = np.asarray(ksp.computeEigenvalues())
    return int(np.count_nonzero((values.real < 0) & (np.abs(values.imag) <= 1e-12 * np.abs(values.real))))
