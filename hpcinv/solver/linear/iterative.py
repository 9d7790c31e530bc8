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

from hpcinv.model.rigid_motions import Frame
from hpcinv.model.scene import Scene
from hpcinv.parallel.jit import JIT_OPTIONS
from hpcinv.parallel.petsc_vectors import dot, norm
from hpcinv.parallel.runtime import MPI
from hpcinv.solver.linear.configuration import LinearConfiguration
from hpcinv.solver.linear.convergence_test import Settling
from hpcinv.solver.petsc_options import OptionValue

_KRYLOV: Mapping[str, OptionValue] = {
    "ksp_type": "fgmres",
    "ksp_gmres_restart": 200,  # slender bodies stagnate with less; chunky ones need fewer iterations
    "ksp_max_it": 400,
}
_MULTIGRID: Mapping[str, OptionValue] = {
    "pc_type": "gamg",
    "pc_gamg_threshold": 0.01,
    "mg_levels_ksp_type": "chebyshev",
    "mg_levels_ksp_max_it": 2,
    "mg_levels_pc_type": "pbjacobi",  # the 3 × 3 blocks of the nodes
}
_SCHUR: Mapping[str, OptionValue] = {
    "pc_type": "fieldsplit",
    "pc_fieldsplit_type": "schur",
    "pc_fieldsplit_schur_fact_type": "upper",
    "pc_fieldsplit_schur_precondition": "user",
    "fieldsplit_u_ksp_type": "preonly",
    "fieldsplit_p_ksp_type": "preonly",
    "fieldsplit_p_pc_type": "jacobi",
}

_RESIDUAL = 1e-5  # relative residual at which any correction has converged

# Smallest share of a motion that is orthogonal to the others: motions that are nearly the same in each aggregate make
# blocks of coarse levels singular.
_INDEPENDENT = 0.05


class Iterative(LinearConfiguration):
    """FGMRES, preconditioned by multigrid for the displacements and a scaled mass matrix for the pressures.

    Args:
        scene: provides the unknowns of both blocks, the kinematics, and the moduli of the mass matrix.
    """

    name = "iterative"
    exact = False
    has_analysis = False
    error = Settling.change

    def __init__(self, scene: Scene) -> None:
        super().__init__(Settling())
        self._scene, self._unknowns = scene, scene.unknowns
        self._mass: PETSc.Mat | None = None
        self._copy: PETSc.Mat | None = None
        self._blocks: tuple[PETSc.IS, PETSc.IS] | None = None

    @property
    def options(self) -> Mapping[str, OptionValue]:
        if self._unknowns.p is None:
            return {**_KRYLOV, **_MULTIGRID}
        return {**_KRYLOV, **_SCHUR, **{f"fieldsplit_u_{name}": value for name, value in _MULTIGRID.items()}}

    def prepare(self, ksp: PETSc.KSP, matrix: PETSc.Mat) -> None:
        pc = ksp.pc
        # Aggregates by the motions of an earlier state are poor after rotations, so they are computed again.
        pc.reset()
        pc.setType(PETSc.PC.Type.NONE)
        ksp.setOperators(matrix)
        ksp.setTolerances(rtol=_RESIDUAL)
        ksp.setFromOptions()
        if not PETSc.Options(ksp.getOptionsPrefix()).hasName("ksp_rtol"):  # set by the job, which has priority
            ksp.setConvergenceTest(self.test)
        if pc.getType() == PETSc.PC.Type.GAMG:
            matrix.setNearNullSpace(self._rigid_motions())
            ksp.setUp()
            self._update_smoother_blocks(pc, matrix)
        elif pc.getType() == PETSc.PC.Type.FIELDSPLIT:
            self._blocks = self._blocks or self._index_sets(matrix)
            # PETSc passes it on to the block that it extracts from the matrix.
            self._blocks[0].compose("nearnullspace", self._rigid_motions())
            pc.setFieldSplitIS(*zip(("u", "p"), self._blocks, strict=True))
            user: Any = PETSc.PC.FieldSplitSchurPreType.USER  # whatever its stub says
            pc.setFieldSplitSchurPreType(user, self._scaled_mass())

    def _update_smoother_blocks(self, pc: PETSc.PC, matrix: PETSc.Mat) -> None:
        """Set the finest smoother to a copy of the matrix, so that it inverts the present blocks of the nodes.

        PETSc keeps inverted blocks with a matrix, also when that is assembled again in the same pattern
        (MatInvertBlockDiagonal of AIJ matrices, 3.25). With blocks of the first tangent, later ones took up to 20 times
        as many iterations, or did not converge. The displacement block of the mixed form is extracted from each
        tangent, and coarse levels are computed again.
        """
        if self._copy is not None:
            self._copy.destroy()
        self._copy = matrix.duplicate(copy=True)
        smoother = pc.getMGSmoother(pc.getMGLevels() - 1)
        smoother.reset()
        smoother.setOperators(self._copy)

    def _index_sets(self, matrix: PETSc.Mat) -> tuple[PETSc.IS, PETSc.IS]:
        begin = matrix.getOwnershipRange()[0]
        parts: list[Any] = [self._unknowns.owned_displacement_dofs + begin, self._unknowns.owned_pressure_dofs + begin]
        u, p = (PETSc.IS().createGeneral(dofs, comm=matrix.comm) for dofs in parts)
        u.setBlockSize(3)
        return u, p

    def _rigid_motions(self) -> PETSc.NullSpace:
        """Return translations, and small rotations of the unknown body and, where they differ, of the mesh."""
        mesh = self._unknowns.owned_displacement_points()
        u = self._unknowns.state.x.array[self._unknowns.owned_displacement_dofs].reshape(-1, 3)
        kinematics, frame, comm = self._scene.kinematics, Frame(np.zeros(3), 1.0), self._unknowns.mesh.comm
        motions = frame.motions(mesh + kinematics.sign * u)
        if kinematics.direction == "inverse" and comm.allreduce(bool(u.any()), op=MPI.LOR):
            motions = np.concatenate([motions, frame.motions(mesh)[:, :, 3:]], axis=2)
        return PETSc.NullSpace().create(vectors=_orthonormal(motions.reshape(-1, motions.shape[2]), comm), comm=comm)

    def _scaled_mass(self) -> PETSc.Mat:
        if self._mass is None:
            self._form = fem.form(
                -1 * self._scene.pressure_mass(self._unknowns.pressure_space), jit_options=JIT_OPTIONS
            )
            self._mass = fem_petsc.create_matrix(self._form)
        self._mass.zeroEntries()
        fem_petsc.assemble_matrix(self._mass, self._form)
        self._mass.assemble()
        return self._mass

    def pressure_scale(self) -> npt.NDArray[np.float64]:
        """Return the diagonal of the scaled mass matrix at the owned pressures; collective."""
        if self._unknowns.p is None:
            return np.zeros(0)
        return -np.array(self._scaled_mass().getDiagonal().array)

    def destroy(self) -> None:
        super().destroy()
        for part in (self._mass, self._copy, *(self._blocks or ())):
            if part is not None:
                part.destroy()


def _orthonormal(columns: npt.NDArray[np.float64], comm: MPI.Intracomm) -> list[PETSc.Vec]:
    """Return orthonormal vectors with the span of the columns, without nearly dependent ones."""
    basis: list[PETSc.Vec] = []
    for column in columns.T:
        vector = PETSc.Vec().createMPI((len(column), None), bsize=3, comm=cast(PETSc.Comm, comm))
        vector.array[:] = column
        length = norm(vector)
        for _ in range(2):  # the second pass removes rounding errors of the first
            for other in basis:
                vector.axpy(-dot(vector, other), other)
        if norm(vector) > _INDEPENDENT * length:
            vector.normalize()
            basis.append(vector)
    return basis
