"""Scale of the unknowns by the diagonals of stiffness and of the pressures' mass, without their matrices."""

from collections.abc import Sequence

import basix
import numpy as np
import ufl
from dolfinx import la

from hpcinv.mesh.cells import jacobians, kind_and_degree, quadrature
from hpcinv.mesh.checks import CHUNK
from hpcinv.mesh.source import Floats
from hpcinv.model.quadrature_values import CellMeans
from hpcinv.model.spaces import Unknowns
from hpcinv.model.weak_form import WeakForm

_PRESSURES = 2.0
"""Factor of the pressures' mass that needs the fewest iterations; half of it, or twice as much, needs a few more."""


def diagonals_of_cells(weak_form: WeakForm) -> list[Floats]:
    """Return diagonals ``d`` (owned cells, nodes) for displacements and pressures, in scaled units; collective.

    ``d`` is ``∫ 2μ |∇φ_i|² dx`` for a displacement, and twice the diagonal of `WeakForm.pressure_mass` for a pressure.
    The cells count as affine, with the Jacobian matrix at their midpoints: a preconditioner needs no more.
    """
    unknowns, mesh = weak_form.unknowns, weak_form.unknowns.mesh
    geometry, owned = mesh.geometry, mesh.topology.index_map(3).size_local
    kind, degree = kind_and_degree(mesh)
    points, weights = quadrature(mesh.basix_cell().name, weak_form.quadrature_degree)
    midpoint = basix.geometry(mesh.basix_cell()).mean(axis=0, keepdims=True)
    parts = np.array_split(geometry.dofmaps[0][:owned], 1 + owned // CHUNK)
    jacobian = np.concatenate([jacobians(kind, degree, geometry.x[part], midpoint)[:, 0] for part in parts])
    inverse, volumes = np.linalg.inv(jacobian), np.abs(np.linalg.det(jacobian))
    mixed = unknowns.p is not None
    moduli = [
        (ufl.as_vector([2 * part.shear_modulus, part.compliance if mixed else 0.0]), part.cells)
        for part in weak_form.parts
    ]
    means = CellMeans(moduli, mesh, 0)()
    cell_moduli = volumes[:, None] * means.x.array.reshape(-1, 2)[means.function_space.dofmap.list[:owned, 0]]
    slopes = unknowns.scalar_elements[0].tabulate(1, points)[1:]
    metric = cell_moduli[:, :1, None] * (inverse @ inverse.transpose(0, 2, 1))
    reference_metric = np.einsum("q,aqi,bqi->abi", weights, slopes, slopes).reshape(9, -1)
    diagonals = [metric.reshape(-1, 9) @ reference_metric]
    if mixed:
        values = unknowns.scalar_elements[1].tabulate(0, points)[0]
        diagonals.append(_PRESSURES * cell_moduli[:, 1:] * (weights @ values**2))
    return diagonals


def tangent_scale(unknowns: Unknowns, diagonals: Sequence[Floats]) -> Floats:
    """Return ``1/√d`` of the owned unknowns, with the sums d of `diagonals_of_cells`; collective."""
    dofmap, owned = unknowns.space.dofmap, len(diagonals[0])
    total = la.vector(dofmap.index_map, dofmap.index_map_bs)
    for diagonal, dofs in zip(diagonals, unknowns.dofs_of_cells(), strict=True):
        np.add.at(total.array, dofs[:owned], diagonal[..., None])
    total.scatter_reverse(la.InsertMode.add)
    return np.asarray(total.array[: dofmap.index_map.size_local * dofmap.index_map_bs] ** -0.5)
