"""Diagonal of the stiffness ``∫ 2μ ∇u : ∇v``, without its matrix."""

import basix
import numpy as np
from dolfinx import fem, la

from hpcinv.mesh.cells import jacobians
from hpcinv.model.quadrature_values import CellMeans
from hpcinv.model.scene import Scene

_CHUNK = 5_000  # cells at a time, so that values at quadrature points take little memory


def stiffness_diagonal(scene: Scene) -> fem.Function:
    """Return ``∫ 2μ |∇φ_i|² dx`` of each displacement of a scene, in scaled units; collective."""
    unknowns, mesh = scene.unknowns, scene.unknowns.mesh
    geometry, owned = mesh.geometry, mesh.topology.index_map(3).size_local
    kind, degree = mesh.basix_cell().name, mesh.ufl_domain().ufl_coordinate_element().degree
    points, weights = basix.make_quadrature(mesh.basix_cell(), scene.quadrature_degree)
    slopes = unknowns.scalar_elements[0].tabulate(1, points)[1:]
    moduli = CellMeans([(2 * part.shear_modulus, part.cells) for part in scene.parts], mesh, 0)()
    total = fem.Function(unknowns.displacement_space)
    values, dofs = total.x.array.reshape(-1, 3), total.function_space.dofmap.list
    for start in range(0, owned, _CHUNK):
        cells = slice(start, min(start + _CHUNK, owned))
        jacobian = jacobians(kind, degree, geometry.x[geometry.dofmaps[0][cells]], points)
        gradients = np.einsum("cqak,aqi->cqki", np.linalg.inv(jacobian), slopes, optimize=True)
        volumes = weights * np.abs(np.linalg.det(jacobian))
        integrals = np.einsum("cq,cqki->ci", volumes, gradients**2, optimize=True)
        of_cells = moduli.x.array[moduli.function_space.dofmap.list[cells, 0]]
        np.add.at(values, dofs[cells], (of_cells[:, None] * integrals)[..., None])
    total.x.scatter_reverse(la.InsertMode.add)
    total.x.scatter_forward()
    return total
