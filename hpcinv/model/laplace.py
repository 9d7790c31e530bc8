"""Laplace's equation on a body with fixed values on parts of it."""

from collections.abc import Sequence

import dolfinx.fem.petsc as fem_petsc
import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc

from hpcinv.base.quantity.arrays import LocalIndices
from hpcinv.errors import MeshError
from hpcinv.mesh import Body

_ACCURACY, _ITERATIONS = 1e-11, 500
_QUADRATURE = 4


class Laplace:
    """Laplace's equation with Lagrange elements of degree 2; made and freed collectively.

    The other boundary is without flux.
    """

    def __init__(self, body: Body) -> None:
        self._body = body
        self.space = fem.functionspace(body.mesh, ("Lagrange", 2))
        u, v = ufl.TrialFunction(self.space), ufl.TestFunction(self.space)
        dx = ufl.dx(body.mesh, degree=_QUADRATURE)
        form = fem.form(ufl.inner(ufl.grad(u), ufl.grad(v)) * dx)
        self._matrix = fem_petsc.assemble_matrix(form)
        self._matrix.assemble()

    def dofs(self, region: str) -> LocalIndices:
        """Return the local unknowns on a region of the boundary, ghosts included; collective.

        Raises:
            MeshError: on all ranks, if there is no such region.
        """
        return np.asarray(fem.locate_dofs_topological(self.space, 2, self._body.facets(region)))

    def solve(self, fixed: Sequence[tuple[LocalIndices, float]]) -> fem.Function:
        """Return the solution with these values at these unknowns; collective.

        Raises:
            MeshError: on all ranks, if the iterative solver does not converge.
        """
        known, solution = fem.Function(self.space), fem.Function(self.space)
        index_map = self.space.dofmap.index_map
        owned = index_map.size_local
        for dofs, value in fixed:
            known.x.array[dofs] = value
        rows = np.unique(np.concatenate([dofs[dofs < owned] for dofs, _ in fixed]))
        known.x.scatter_forward()
        matrix, b = self._matrix.copy(), known.x.petsc_vec.duplicate()
        b.set(0.0)
        matrix.zeroRowsColumns(index_map.local_to_global(rows).astype(PETSc.IntType), 1.0, known.x.petsc_vec, b)
        matrix.setOption(PETSc.Mat.Option.SPD, True)
        ksp = PETSc.KSP().create(matrix.comm)
        ksp.setOperators(matrix)
        ksp.setType(PETSc.KSP.Type.CG)
        ksp.pc.setType(PETSc.PC.Type.GAMG)
        ksp.setTolerances(rtol=_ACCURACY, max_it=_ITERATIONS)
        ksp.solve(b, solution.x.petsc_vec)
        converged = ksp.is_converged
        for petsc_object in (ksp, matrix, b):
            petsc_object.destroy()
        if not converged:
            raise MeshError(
                f"{self._body.source.path}: Laplace's equation was not solved in {_ITERATIONS} iterations",
                "Improve the worst cells of the mesh.",
            )
        solution.x.scatter_forward()
        return solution

    def destroy(self) -> None:
        """Free the matrix."""
        self._matrix.destroy()
