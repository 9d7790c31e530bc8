"""Deformation gradients at points of cells, and fields in the middle of each cell, without forms."""

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
from dolfinx.fem import Function

from hpcinv.base.quantity.spatial_fields import ByData, ByRule
from hpcinv.job.fibres import FibreFamily
from hpcinv.mesh import Body
from hpcinv.mesh.cells import jacobians, scalar_element
from hpcinv.mesh.data import distribute, middle_vectors
from hpcinv.mesh.source import Floats
from hpcinv.on_demand import on_demand
from hpcinv.results.solution import Solution

type Cells = npt.NDArray[np.integer]


def deformation_gradients(body: Body, solution: Solution, cells: Cells) -> Floats:
    """Return ``F`` in the middle of local cells, (cells, 3, 3), of the loaded body against the undeformed one."""
    return np.asarray(gradients_at(body, solution, cells, _middle(body.source.kind))[:, 0])


def gradients_at(body: Body, solution: Solution, cells: Cells, points: Floats) -> Floats:
    """Return the same at points (n, 3) of the reference cell, (cells, n, 3, 3)."""
    h = _mesh_gradients(body, solution.mesh_nodes, solution.displacement, cells, points)
    if solution.direction == "forward":
        return np.asarray(np.eye(3) + h)
    return np.asarray(np.linalg.inv(np.eye(3) - h))


def given_gradients(body: Body, solution: Solution, cells: Cells, points: Floats) -> Floats:
    """Return the same of the state that is given: of the solution itself, or of the one that it started from."""
    if solution.given_displacement is None:
        return gradients_at(body, solution, cells, points)
    return np.asarray(
        np.eye(3) + _mesh_gradients(body, solution.mesh_nodes, solution.given_displacement, cells, points)
    )


def _mesh_gradients(body: Body, mesh_nodes: Floats, displacement: Function, cells: Cells, points: Floats) -> Floats:
    """Return the gradients of a displacement by the position in the mesh at these nodes, (cells, n, 3, 3)."""
    nodes = mesh_nodes[body.mesh.geometry.dofmaps[0][cells]]
    space = displacement.function_space
    values = displacement.x.array.reshape(-1, 3)[space.dofmap.list[cells]]
    slopes = space.element.basix_element.tabulate(1, points)[1:, :, :, 0]  # (3, points, shape functions)
    reference_gradients = np.einsum("cni,kpn->cpik", values, slopes)
    return np.asarray(reference_gradients @ np.linalg.inv(jacobians(body.source.kind, body.degree, nodes, points)))


def fibres(
    body: Body, families: Mapping[str, FibreFamily], given: Solution, gradients: Floats, cells: Cells
) -> dict[str, Floats]:
    """Return the unit directions of fibres on the undeformed body in the middle of local cells, (cells, 3); collective.

    Args:
        given: the solution whose bodies the directions are given on.
        gradients: its deformation gradients in these cells, (cells, 3, 3).
    """
    directions = dict[str, Floats]()
    for name, family in families.items():
        direction: Floats = given_in_middles(body, name, family, given, cells)
        if family.given_on == "current":
            direction = np.asarray(np.linalg.solve(gradients, direction[:, :, None])[:, :, 0], dtype=float)
        directions[name] = unit_vectors(direction)
    return directions


def unit_vectors(vectors: Floats) -> Floats:
    """Return vectors (n, 3) with length 1, those without length as they are."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0))


def constants_in(function: Function, cells: Cells) -> Floats:
    """Return the values of a piecewise constant function in local cells, (cells, components)."""
    space = function.function_space
    values = function.x.array.reshape(-1, space.dofmap.index_map_bs)
    return np.asarray(values[space.dofmap.list[cells, 0]])


def given_in_middles(body: Body, name: str, family: FibreFamily, solution: Solution, cells: Cells) -> Floats:
    """Return the directions of a family as they are given, of any length, in the middle of local cells; collective."""
    (value, _) = family.quantities()["direction"]
    if isinstance(value, ByRule):
        return middle_vectors(on_demand("directions of a rule")(body, value.rule, f"fibres.{name}").function, cells)
    dofs = body.mesh.geometry.dofmaps[0]
    shapes = scalar_element(body.source.kind, body.degree).tabulate(0, _middle(body.source.kind))[0, 0, :, 0]
    if isinstance(value, ByData):
        array = distribute(body, value.array)
        if array.place == "cells":
            return array.values[cells]
        return np.asarray(np.einsum("n,cni->ci", shapes, array.values[dofs[cells]]))
    reference, current = (
        np.einsum("n,cni->ci", shapes, nodes[dofs[cells]])
        for nodes in (solution.reference_nodes, solution.current_nodes)
    )
    if (displacement := solution.given_displacement) is not None:
        current = reference + middle_vectors(displacement, cells)
    positions = dict(zip("XYZxyz", (*reference.T, *current.T), strict=True))
    components = [np.broadcast_to(component.values_at(positions), len(cells)) for component in value]
    return np.stack(components, axis=1).astype(float)


def _middle(kind: str) -> Floats:
    middle: Floats = scalar_element(kind, 1).points.mean(axis=0)[None]
    return middle
