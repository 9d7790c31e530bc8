"""Multigrid for displacements of a degree above 1, whose coarse space are displacements of degree 1.

Aggregation of the nodes of degree 2 makes coarse levels that are expensive and converge slowly. Galerkin's product with
the interpolation from degree 1 on the same cells, an eighth of the nodes, is the tangent of degree 1. It is factorized
for slender bodies, and suits algebraic multigrid for others.

Vectors have all unknowns; pressures are zero in them. So the tangent need not be copied without its pressures, which
would take as much memory as the tangent itself.

Source: Sundar, Stadler & Biros, Numer. Linear Algebra Appl. 22, 664-680, 2015, doi:10.1002/nla.1979.
"""

from collections.abc import Mapping
from typing import Any, cast

import basix
import basix.ufl
import numpy as np
import numpy.typing as npt
from dolfinx import fem, la
from petsc4py import PETSc

from hpcinv.base.parallel.petsc_calls import set_up
from hpcinv.base.quantity.arrays import Booleans
from hpcinv.mesh.interpolation import interpolate
from hpcinv.mesh.source import Floats
from hpcinv.model.weak_form import WeakForm
from hpcinv.solver.linear.cost_model import Forecast, shape_of
from hpcinv.solver.linear.near_null_space import near_null_space
from hpcinv.solver.petsc_options import OptionValue

_ROWS = 10_000  # rows whose entries are searched at once; more take more memory
_CURVED = 1e-8  # offset of a node of a curved cell, by reference coordinates; below are rounding errors

# Least aspect ratio of bodies whose tangent of degree 1 is factorized, if that takes so many operations at most. On the
# silicone beam after large rotations, aggregation does not converge. Compact incompressible bodies need a third fewer
# iterations with aggregation, so that a lower ratio takes more of them. More operations take more memory.
_SLENDER, _OPERATIONS = 10.0, 2e11
# Operations up to which it is factorized for all bodies without pressures, which need a third fewer iterations with it:
# blocks of 28,600 and 73,000 unknowns took 23 and 21 % less time. More take as much time as they save.
_FEW_OPERATIONS = 2e10

# Added share of the diagonal of degree 1. An incompressible body may be free to swell but for its pressure, so that
# its displacements alone have a singular tangent. More damps the bending of slender bodies.
_SHIFT = 1e-6

COARSE: Mapping[str, OptionValue] = {
    "pc_type": "gamg",
    "pc_gamg_threshold": 0.01,
    "mg_levels_ksp_type": "chebyshev",
    "mg_levels_ksp_max_it": 2,
    "mg_levels_pc_type": "pbjacobi",  # the 3 × 3 blocks of the nodes
}
"""Options of algebraic multigrid, without prefix."""

_FACTORS: Mapping[str, OptionValue] = {"pc_type": "lu", "pc_factor_mat_solver_type": "mumps"}


class DegreeLevels:
    """Levels of multigrid for the tangents of a weak form; all methods are collective.

    Attributes:
        options: PETSc options of the preconditioner, without prefix.
    """

    def __init__(self, weak_form: WeakForm) -> None:
        self._weak_form, self._unknowns = weak_form, weak_form.unknowns
        mesh, dofmap = self._unknowns.mesh, self._unknowns.space.dofmap
        self._owned = dofmap.index_map.size_local * dofmap.index_map_bs
        cell = mesh.basix_cell()
        self._space = fem.functionspace(mesh, basix.ufl.element("Lagrange", cell, 1, shape=(3,)))
        forecast = Forecast(self._unknowns.size, self._unknowns.scalar_elements[0].degree, shape_of(self._unknowns))
        operations, has_pressures = forecast.degree_forecast(1).operations, self._unknowns.p is not None
        is_factorized = forecast.shape.aspect >= _SLENDER and operations <= _OPERATIONS
        coarse = _FACTORS if is_factorized or (operations <= _FEW_OPERATIONS and not has_pressures) else COARSE
        self.options: Mapping[str, OptionValue] = {
            "pc_type": "mg",
            "mg_levels_ksp_type": "chebyshev",
            "mg_levels_ksp_max_it": 2,
            "mg_levels_pc_type": "mat",  # inverted blocks of the nodes
            "mg_coarse_ksp_type": "preonly",
            **{f"mg_coarse_{name}": value for name, value in coarse.items()},
        }
        linear = basix.ufl.element("Lagrange", cell, 1).basix_element
        table = basix.compute_interpolation_operator(linear, self._unknowns.scalar_elements[0].basix_element)
        for weight in (0.0, 1.0):  # without rounding errors
            table[np.abs(table - weight) < 1e-12] = weight
        dofs = self._unknowns.dofs_of_cells()[0]
        first, places = np.unique(dofs[:, :, 0].ravel(), return_index=True)
        cells, node = np.divmod(places[first < self._owned], dofs.shape[1])  # a cell of each owned node
        self._nodes = dofs[cells, node]  # (nodes, 3)
        self._weights: Floats = table[node]  # of the vertices of that cell, (nodes, vertices)
        points = self._unknowns.scalar_elements[0].basix_element.points
        self._slopes: Floats = np.moveaxis(linear.tabulate(1, points)[1:, :, :, 0], 0, 2)[node]  # (nodes, vertices, 3)
        self._places = self._unknowns.displacement_space.dofmap.list[cells, node]
        self._vertices = self._space.dofmap.list[cells]
        self._order = np.argsort(self._nodes.ravel())

    def set_up(self, pc: PETSc.PC, operator: PETSc.Mat, matrix: PETSc.Mat) -> None:
        """Set up a preconditioner of type ``mg`` for a tangent.

        Args:
            operator: product of the tangent with vectors without pressures, without its pressure rows.
            matrix: the tangent with all rows.
        """
        blocks = self._inverted_blocks(matrix)
        interpolation = self.interpolation(matrix)
        product = matrix.ptap(interpolation)
        coarse = product.duplicate(copy=True)
        product.destroy()  # it keeps the product of `matrix` and `interpolation`
        diagonal = coarse.getDiagonal()
        diagonal.scale(1.0 + _SHIFT)
        coarse.setDiagonal(diagonal)
        diagonal.destroy()
        coarse.setNearNullSpace(self._near_null_space())
        pc.setMGLevels(2)
        pc.setOperators(operator, blocks)
        pc.setMGInterpolation(1, interpolation)
        pc.setFromOptions()
        pc.getMGCoarseSolve().setOperators(coarse)
        pc.getMGSmoother(1).setOperators(operator, blocks)
        set_up(pc)

    def interpolation(self, matrix: PETSc.Mat) -> PETSc.Mat:
        """Return the interpolation of displacements of degree 1 in the rows of a tangent.

        Prescribed unknowns get zero. The coarse unknowns of prescribed vertices have no effect but there, so that
        Galerkin's product has ones on their diagonal.
        """
        index_map = self._space.dofmap.index_map
        fixed = _identity_rows(matrix)[self._nodes]
        at_vertex = self._weights == 1.0
        coarse_fixed = self._prescribed_vertices(fixed, at_vertex)[self._vertices]  # (nodes, vertices, 3)
        keeps = np.where(at_vertex[:, :, None], coarse_fixed == fixed[:, None], ~(coarse_fixed | fixed[:, None]))
        weights = self._straight_weights()[:, :, None] * keeps
        numbers = np.arange(index_map.size_local + index_map.num_ghosts, dtype=np.int32)
        columns = 3 * index_map.local_to_global(numbers)[self._vertices][:, :, None] + np.arange(3)
        rows = [
            part.transpose(0, 2, 1).reshape(self._nodes.size, part.shape[1])[self._order] for part in (columns, weights)
        ]
        order = np.argsort(rows[0], axis=1)
        columns, weights = (np.take_along_axis(part, order, axis=1) for part in rows)
        kept = weights != 0.0
        return self._matrix(3 * index_map.size_local, kept.sum(axis=1), columns[kept], weights[kept])

    def _straight_weights(self) -> Floats:
        """Return weights of the vertices that give the present position of each node, (nodes, vertices).

        Nodes of curved cells are off the straight cells by an offset; displacements of degree 1 are extended by it
        with their gradient. So the coarse space contains rotations; without them, bodies that bend do not converge.
        """
        nodes = self._unknowns.displacement_space.tabulate_dof_coordinates()[self._places]
        vertices = self._space.tabulate_dof_coordinates()[self._vertices]
        offsets = nodes - np.einsum("nv,nvi->ni", self._weights, vertices)
        jacobians = np.einsum("nvi,nvj->nij", vertices, self._slopes)
        shifts = np.einsum("nij,nj->ni", _inverted(jacobians), offsets)
        sizes = np.abs(shifts).max(axis=1, keepdims=True)
        shifts *= (sizes > _CURVED) & (sizes < 1.0)  # straight cells may be nearly flat
        weights: Floats = self._weights + np.einsum("nvj,nj->nv", self._slopes, shifts)
        return weights

    def _matrix(
        self, owned_columns: int, lengths: npt.NDArray[np.integer[Any]], columns: Any, values: Floats
    ) -> PETSc.Mat:
        """Return a matrix with rows of these lengths at the unknowns of the nodes, and no entries in other rows."""
        starts = np.zeros(self._owned + 1, dtype=PETSc.IntType)
        starts[1 + self._nodes.ravel()[self._order]] = lengths
        csr = np.cumsum(starts, dtype=PETSc.IntType), columns.astype(PETSc.IntType), values
        size: Any = (self._owned, None), (owned_columns, None)
        matrix = PETSc.Mat().create(cast(PETSc.Comm, self._unknowns.mesh.comm))
        matrix.setSizes(size)
        matrix.setType(PETSc.Mat.Type.AIJ)
        matrix.setPreallocationCSR(csr)
        return matrix

    def _prescribed_vertices(self, fixed: Booleans, at_vertex: Booleans) -> Booleans:
        """Return which components of the coarse unknowns are prescribed at their vertices, (local vertices, 3)."""
        marks = fem.Function(self._space)
        values = marks.x.array.reshape(-1, 3)
        nodes, vertex = np.nonzero(at_vertex)
        values[self._vertices[nodes, vertex]] = fixed[nodes]
        marks.x.scatter_reverse(la.InsertMode.add)  # the node of a vertex may belong to another rank
        marks.x.scatter_forward()
        is_prescribed: Booleans = values > 0.0
        return is_prescribed

    def _near_null_space(self) -> PETSc.NullSpace:
        owned = self._space.dofmap.index_map.size_local
        displacement = fem.Function(self._space)
        interpolate(self._unknowns.displacement(), displacement)
        moved = displacement.x.array.reshape(-1, 3)[:owned]
        return near_null_space(self._weak_form, self._space.tabulate_dof_coordinates()[:owned], moved)

    def _inverted_blocks(self, matrix: PETSc.Mat) -> PETSc.Mat:
        """Return the inverted blocks of the nodes, and zero for pressures."""
        block = matrix.getDiagonalBlock()
        arrays = cast(Any, matrix.getAttr("arrays"))  # of a `FilledTangent`, which PETSc would copy
        starts, columns, values = (arrays if matrix.comm.size == 1 else arrays[0]) if arrays else block.getValuesCSR()
        node = np.full(self._owned, -1, dtype=np.int32)
        node[self._nodes] = np.arange(len(self._nodes), dtype=np.int32)[:, None]
        parts = [np.zeros(0)]
        for begin in range(0, self._owned, _ROWS):
            end = min(begin + _ROWS, self._owned)
            row = np.repeat(node[begin:end], np.diff(starts[begin : end + 1]))
            entries = slice(starts[begin], starts[end])
            parts.append(values[entries][(row >= 0) & (node[columns[entries]] == row)])
        blocks = np.empty((self._nodes.size, 3))
        blocks[self._order] = np.concatenate(parts).reshape(-1, 3)
        inverted = _inverted(blocks.reshape(-1, 3, 3))
        rows = matrix.getOwnershipRange()[0] + np.repeat(self._nodes, 3, axis=0)[self._order]
        lengths = np.full(self._nodes.size, 3, dtype=np.int32)
        return self._matrix(self._owned, lengths, rows.ravel(), inverted.reshape(-1, 3)[self._order].ravel())


def _inverted(blocks: Floats) -> Floats:
    """Return inverted 3 × 3 blocks; the unit matrix for those that are singular."""
    a, b, c = blocks[:, 0], blocks[:, 1], blocks[:, 2]
    adjugate = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=2)
    determinants = np.einsum("ni,ni->n", a, adjugate[:, :, 0])
    is_singular = determinants == 0.0
    adjugate[is_singular], determinants[is_singular] = np.eye(3), 1.0
    inverted: Floats = adjugate / determinants[:, None, None]
    return inverted


def _identity_rows(matrix: PETSc.Mat) -> Booleans:
    """Return which owned rows have a one on the diagonal and nothing else, as prescribed unknowns have."""
    x, y = matrix.createVecRight(), matrix.createVecLeft()
    x.array[:] = np.random.default_rng(0).uniform(1.0, 2.0, len(x.array))  # no other row gives the same number
    matrix.mult(x, y)
    is_identity: Booleans = np.array(cast(Floats, y.array) == x.array)
    x.destroy()
    y.destroy()
    return is_identity
