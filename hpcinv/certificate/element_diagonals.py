"""Diagonals that scale the unknowns of a finer problem: of the stiffness ``∫ 2μ |∇u|²`` and of the pressure mass."""

from collections.abc import Callable, Iterator
from typing import Any

import basix
import numpy as np
from dolfinx import fem, la

from hpcinv.mesh.cells import jacobians
from hpcinv.mesh.source import Floats
from hpcinv.model.quadrature_values import CellMeans
from hpcinv.model.scene import Scene

_CHUNK = 5_000  # cells at a time, so that values at quadrature points take little memory


def displacement_diagonal(scene: Scene) -> fem.Function:
    """Return ``∫ 2μ |∇φ_i|² dx`` of each displacement; collective."""
    unknowns = scene.unknowns

    def integrals(jacobian: Floats, weights: Floats, points: Floats) -> Floats:
        slopes = unknowns.scalar_elements[0].tabulate(1, points)[1:]
        gradients = np.einsum("cqak,aqi->cqki", np.linalg.inv(jacobian), slopes, optimize=True)
        return np.asarray(np.einsum("cq,cqki->ci", weights, gradients**2, optimize=True))

    moduli = CellMeans([(2 * part.shear_modulus, part.cells) for part in scene.parts], unknowns.mesh, 0)
    return _summed(scene, unknowns.displacement_space, moduli(), integrals)


def pressure_diagonal(scene: Scene) -> fem.Function:
    """Return ``-∫ (1/μ + 1/Λ) ψ_i² dx`` of each pressure; collective."""
    unknowns = scene.unknowns

    def integrals(_jacobian: Floats, weights: Floats, points: Floats) -> Floats:
        values: Floats = unknowns.scalar_elements[1].tabulate(0, points)[0]
        return -weights @ values**2

    compliances = CellMeans([(part.compliance, part.cells) for part in scene.parts], unknowns.mesh, 0)
    return _summed(scene, unknowns.pressure_space, compliances(), integrals)


def _summed(
    scene: Scene, space: fem.FunctionSpace, factor: fem.Function, integrals: Callable[[Floats, Floats, Floats], Any]
) -> fem.Function:
    """Return sums over cells of integrals (cells, nodes) times the factor of each cell, at each component."""
    total, points = fem.Function(space), _points(scene)
    values = total.x.array.reshape(-1, space.dofmap.bs)
    for cells, jacobian, weights in _cells(scene):
        factors = factor.x.array[factor.function_space.dofmap.list[cells, 0]]
        of_cells = factors[:, None] * integrals(jacobian, weights, points)
        np.add.at(values, space.dofmap.list[cells], of_cells[..., None])
    total.x.scatter_reverse(la.InsertMode.add)
    total.x.scatter_forward()
    return total


def _points(scene: Scene) -> Floats:
    points: Floats = basix.make_quadrature(scene.unknowns.mesh.basix_cell(), scene.quadrature_degree)[0]
    return points


def _cells(scene: Scene) -> Iterator[tuple[slice, Floats, Floats]]:
    """Yield owned cells with ``∂x/∂ξ`` and the weights at their quadrature points."""
    mesh = scene.unknowns.mesh
    geometry, owned = mesh.geometry, mesh.topology.index_map(3).size_local
    kind, degree = mesh.basix_cell().name, mesh.ufl_domain().ufl_coordinate_element().degree
    points, weights = basix.make_quadrature(mesh.basix_cell(), scene.quadrature_degree)
    for start in range(0, owned, _CHUNK):
        cells = slice(start, min(start + _CHUNK, owned))
        jacobian = jacobians(kind, degree, geometry.x[geometry.dofmaps[0][cells]], points)
        yield cells, jacobian, weights * np.abs(np.linalg.det(jacobian))
