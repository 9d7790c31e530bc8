"""FGMRES with multigrid, for bodies whose factorization would take too much time or memory.

The tangent of the mixed form and its block factorization are

    K = [[A, Bᵀ], [C, -D]] ≈ [[I, 0], [C A⁻¹, I]] [[A, Bᵀ], [0, S]],      S = -(D + C A⁻¹ Bᵀ).

The right factor is the preconditioner, with one cycle of algebraic multigrid for A⁻¹ and ``S ≈ -∫ (1/μ + 1/Λ) p q``,
which is spectrally equivalent for every ratio of the moduli, the incompressible one included.

Smoothed aggregation needs the near-null space of A; without it, the solver does not converge after large rotations.
However large the deformation is, isotropic stress does not change under rotations of the unknown body, so the
near-null space are the rigid motions of that body, not of the mesh. In the inverse problem A is not symmetric, and its
transpose has the rigid motions of the mesh; aggregation uses one basis for both, which spans both.

Sources: Elman, Silvester & Wathen, *Finite Elements and Fast Iterative Solvers* (2014), ch. 4 and 8,
doi:10.1093/acprof:oso/9780199678792.001.0001; Wathen & Silvester, SIAM J. Numer. Anal. 30, 630–649, 1993,
doi:10.1137/0730031; Vaněk, Mandel & Brezina, Computing 56, 179–196, 1996, doi:10.1007/BF02238511.
"""

from collections.abc import Mapping
from typing import Any, cast

import dolfinx.fem.petsc as fem_petsc
import numpy as np
import numpy.typing as npt
from dolfinx import fem
from petsc4py import PETSc

from hpcinv.base.parallel.petsc_calls import set_up
from hpcinv.model.weak_form import WeakForm
from hpcinv.solver.linear.block_triangular import BlockTriangular
from hpcinv.solver.linear.configuration import LinearConfiguration
from hpcinv.solver.linear.convergence_test import Settling
from hpcinv.solver.linear.degree_levels import COARSE, DegreeLevels
from hpcinv.solver.linear.near_null_space import near_null_space
from hpcinv.solver.petsc_options import OptionValue

_KRYLOV: Mapping[str, OptionValue] = {
    "ksp_type": "fgmres",
    "ksp_gmres_restart": 200,  # slender bodies stagnate with less; chunky ones need fewer iterations
    "ksp_max_it": 400,
}
_PRESSURES: Mapping[str, OptionValue] = {"pc_type": "python"}
_DISPLACEMENTS = "fieldsplit_u_"  # prefix of their options where there are pressures, as PETSc names such blocks

_RESIDUAL = 1e-5  # relative residual at which any correction has converged


class Iterative(LinearConfiguration):
    """FGMRES, preconditioned by multigrid for the displacements and a scaled mass matrix for the pressures.

    Args:
        weak_form: provides the unknowns of both blocks, the kinematics, and the moduli of the mass matrix.
    """

    name = "iterative"
    exact = False
    has_analysis = False
    error = Settling.change

    def __init__(self, weak_form: WeakForm) -> None:
        super().__init__(Settling())
        self._weak_form, self._unknowns = weak_form, weak_form.unknowns
        self._mass: PETSc.Mat | None = None
        self._copy: PETSc.Mat | None = None
        self._levels = DegreeLevels(weak_form) if self._unknowns.scalar_elements[0].degree > 1 else None

    @property
    def options(self) -> Mapping[str, OptionValue]:
        multigrid = COARSE if self._levels is None else self._levels.options
        if self._unknowns.p is None:
            return {**_KRYLOV, **multigrid}
        return {**_KRYLOV, **_PRESSURES, **{_DISPLACEMENTS + name: value for name, value in multigrid.items()}}

    def prepare(self, ksp: PETSc.KSP, matrix: PETSc.Mat) -> None:
        pc = ksp.pc
        # Aggregates by the motions of an earlier state are poor after rotations, so they are computed again.
        pc.reset()
        pc.setType(PETSc.PC.Type.NONE)
        no_error: Any = PETSc.PC.FailedReason.NOERROR  # an int, whatever its stub says
        pc.setFailedReason(no_error)  # a failure of the direct solver stays otherwise
        ksp.setOperators(matrix)
        ksp.setTolerances(rtol=_RESIDUAL)
        ksp.setFromOptions()
        if not PETSc.Options(ksp.getOptionsPrefix()).hasName("ksp_rtol"):  # set by the job, which has priority
            ksp.setConvergenceTest(self.test)
        if pc.getType() == PETSc.PC.Type.PYTHON:
            pc.setPythonContext(
                BlockTriangular(
                    matrix,
                    self._unknowns.owned_pressure_dofs,
                    self._pressure_mass(),
                    cast(DegreeLevels, self._levels).set_up,
                    f"{ksp.getOptionsPrefix()}{_DISPLACEMENTS}",
                )
            )
        elif pc.getType() == PETSc.PC.Type.MG and self._levels is not None:
            self._levels.set_up(pc, matrix, matrix)
        elif pc.getType() == PETSc.PC.Type.GAMG:
            matrix.setNearNullSpace(self._rigid_motions())
            set_up(ksp)
            self._update_smoother_blocks(pc, matrix)

    def _update_smoother_blocks(self, pc: PETSc.PC, matrix: PETSc.Mat) -> None:
        """Set the finest smoother to a copy of the matrix, so that it inverts the present blocks of the nodes.

        PETSc keeps inverted blocks with a matrix, also when that is assembled again in the same pattern
        (MatInvertBlockDiagonal of AIJ matrices, 3.25). With blocks of the first tangent, later ones took up to 20 times
        as many iterations, or did not converge.
        """
        if self._copy is not None:
            self._copy.destroy()
        self._copy = matrix.duplicate(copy=True)
        smoother = pc.getMGSmoother(pc.getMGLevels() - 1)
        smoother.reset()
        smoother.setOperators(self._copy)

    def _rigid_motions(self) -> PETSc.NullSpace:
        u = self._unknowns.state.x.array[self._unknowns.owned_displacement_dofs].reshape(-1, 3)
        return near_null_space(self._weak_form, self._unknowns.owned_displacement_points(), u)

    def pressure_scale(self) -> npt.NDArray[np.float64]:
        """Return the diagonal of the scaled mass matrix at the owned pressures; collective."""
        return np.zeros(0) if self._unknowns.p is None else np.array(self._pressure_mass().getDiagonal().array)

    def _pressure_mass(self) -> PETSc.Mat:
        """Return the scaled mass matrix at the present state; collective."""
        if self._mass is None:
            self._form = fem.form(self._weak_form.pressure_mass(self._unknowns.pressure_space))
            self._mass = fem_petsc.create_matrix(self._form)
        self._mass.zeroEntries()
        fem_petsc.assemble_matrix(self._mass, self._form)
        self._mass.assemble()
        return self._mass

    def destroy(self) -> None:
        super().destroy()
        for part in (self._mass, self._copy):
            if part is not None:
                part.destroy()
