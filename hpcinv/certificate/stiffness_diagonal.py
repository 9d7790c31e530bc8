"""Diagonal of the stiffness ``∫ 2μ ∇u : ∇v``, without its matrix."""

import basix
import numpy as np
from dolfinx import fem, la

from hpcinv.mesh.cells import jacobians
from hpcinv.model.quadrature_values import CellMeans
from hpcinv.model.scene import Scene


def stiffness_diagonal(scene: Scene) -> fem.Function:
    """Return ``∫ 2μ |∇φ_i|² dx`` of each displacement of a scene, in scaled units; collective.

    The cells count as affine, with the Jacobian matrix at their midpoints: a preconditioner needs no more.
    """
    unknowns, mesh = scene.unknowns, scene.unknowns.mesh
    geometry, owned = mesh.geometry, mesh.topology.index_map(3).size_local
    kind, degree = mesh.basix_cell().name, mesh.ufl_domain().ufl_coordinate_element().degree
    points, weights = basix.make_quadrature(mesh.basix_cell(), scene.quadrature_degree)
    slopes = unknowns.scalar_elements[0].tabulate(1, points)[1:]
    on_reference = np.einsum("q,aqi,bqi->abi", weights, slopes, slopes).reshape(9, -1)
    midpoint = basix.geometry(mesh.basix_cell()).mean(axis=0, keepdims=True)
    jacobian = jacobians(kind, degree, geometry.x[geometry.dofmaps[0][:owned]], midpoint)[:, 0]
    inverse, volumes = np.linalg.inv(jacobian), np.abs(np.linalg.det(jacobian))
    moduli = CellMeans([(2 * part.shear_modulus, part.cells) for part in scene.parts], mesh, 0)()
    volumes *= moduli.x.array[moduli.function_space.dofmap.list[:owned, 0]]
    metric = volumes[:, None, None] * (inverse @ inverse.transpose(0, 2, 1))
    total = fem.Function(unknowns.displacement_space)
    values, dofs = total.x.array.reshape(-1, 3), total.function_space.dofmap.list[:owned]
    np.add.at(values, dofs, (metric.reshape(-1, 9) @ on_reference)[..., None])
    total.x.scatter_reverse(la.InsertMode.add)
    total.x.scatter_forward()
    return total
