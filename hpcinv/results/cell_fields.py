"""Stress, volume ratio, stretches and fibres in cells and at nodes, for files and pictures.

Of a solid they are means of cells, and stretches in the middle. Of a shell they are values at places, such as on its
faces: the polynomial through the points of a layer, as of quantities (`layer_interpolation`).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from dolfinx import fem, la

from hpcinv.base.quantity.spatial_fields import ByData
from hpcinv.base.quantity.stress_measures import COMPONENTS, MEASURES, components_of
from hpcinv.job.fibres import FibreFamily
from hpcinv.mesh import Body
from hpcinv.mesh.cells import jacobians, layer_interpolation, scalar_element
from hpcinv.mesh.data import distribute
from hpcinv.mesh.source import DataArray, Floats, Ints
from hpcinv.model.cell_means import LayerValues
from hpcinv.results.cell_middles import (
    Cells,
    constants_in,
    deformation_gradients,
    given_gradients,
    given_in_middles,
    gradients_at,
    unit_vectors,
)
from hpcinv.results.solution import Solution


@dataclass(frozen=True)
class CellFields:
    """Cauchy stress row by row (n, 9) in Pa, volume ratio (n,), and principal stretches (n, 3), largest first."""

    stress: Floats
    J: Floats
    stretches: Floats


def cell_fields(body: Body, solution: Solution, cells: Cells, places: Floats) -> CellFields:
    """Return the fields of local cells, of a shell at places (n, 3) of the reference cell."""
    if solution.layer is None:
        stretches = np.linalg.svd(deformation_gradients(body, solution, cells), compute_uv=False)
        stress, J = (constants_in(function, cells) for function in (solution.cauchy_stress, solution.J))
        return CellFields(stress, J[:, 0], np.asarray(stretches, dtype=np.float64))
    return _fields(_in_layers(body, solution, solution.layer, cells, places[:, None])[:, 0])


def nodal_layer_fields(
    body: Body, solution: Solution, layer: LayerValues, points: Floats, dofmap: Ints, index_map: Any
) -> CellFields:
    """Return the fields of a shell at all local nodes, means over the cells around each; collective.

    Args:
        points: nodes of the reference cell, (n, 3).
        dofmap: numbers of these nodes in each local cell.
        index_map: distribution of these nodes over the ranks.
    """
    owned = np.arange(body.mesh.topology.index_map(3).size_local)
    values = _in_layers(body, solution, layer, owned, points[None])
    return _fields(nodal_means(index_map, dofmap[owned], values))


def face_arrays(body: Body, solution: Solution) -> dict[str, Floats]:
    """Return data arrays (local geometry nodes, k) of a shell for its shape files; none of other bodies; collective."""
    if solution.layer is None:
        return {}
    geometry, points = body.mesh.geometry, scalar_element(body.source.kind, body.degree).points
    fields = nodal_layer_fields(body, solution, solution.layer, points, geometry.dofmaps[0], geometry.index_map())
    tensors = fields.stress.reshape(-1, 3, 3)
    components = (tensors[:, *COMPONENTS[name]] for name in components_of("von_mises"))
    von_mises = np.asarray(MEASURES["von_mises"](*components))[:, None]
    return {"cauchy_stress": fields.stress, "von_mises": von_mises, "principal_stretches": fields.stretches}


def nodal_means(index_map: Any, nodes: Ints, values: Floats) -> Floats:
    """Return means (local nodes, k) of values (cells, n, k) at the nodes (cells, n) of owned cells; collective."""
    count = values.shape[2] + 1
    sums = la.vector(index_map, count)
    np.add.at(sums.array.reshape(-1, count), nodes, np.concatenate([values, np.ones_like(values[..., :1])], axis=2))
    sums.scatter_reverse(la.InsertMode.add)
    sums.scatter_forward()
    total = sums.array.reshape(-1, count)
    return np.asarray(total[:, :-1] / total[:, -1:])


def _in_layers(body: Body, solution: Solution, layer: LayerValues, cells: Cells, places: Floats) -> Floats:
    """Return ``Rᵀ σ R``, J, ``Fᵀ F`` and F = R U at places (cells or 1, n, 3) of cells, (cells, n, 28).

    Stress and strain do not turn with the shell then, so that their polynomials have the right principal values.
    """
    points, _ = layer_interpolation(layer.degree, places[:1, 0])
    F, values = gradients_at(body, solution, cells, points), layer.at_points(cells)
    R, F_transposed = _rotations(F), F.swapaxes(2, 3)
    stress = R.swapaxes(2, 3) @ values[:, :, :9].reshape(F.shape) @ R
    parts = (tensor.reshape(*F.shape[:2], 9) for tensor in (stress, F_transposed @ F, F))
    stress, squares, gradients = parts
    return np.asarray(layer.weights(places) @ np.concatenate([stress, values[:, :, 9:], squares, gradients], axis=2))


def _rotations(F: Floats) -> Floats:
    left, _, right = np.linalg.svd(F)
    return np.asarray(left @ right)


def _fields(values: Floats) -> CellFields:
    """Return the fields of values as of `_in_layers`, (n, 28)."""
    stress, squares, F = (values[:, i : i + 9].reshape(-1, 3, 3) for i in (0, 10, 19))
    R, stretches = _rotations(F), np.sqrt(np.maximum(np.linalg.eigvalsh(squares)[:, ::-1], 0.0))
    return CellFields((R @ stress @ R.swapaxes(1, 2)).reshape(-1, 9), values[:, 9], stretches)


def projected(body: Body, values: Floats, space: fem.FunctionSpace) -> Floats:
    """Project values (owned cells, components) to linear functions; return them at the owned nodes of ``space``.

    It is the L2 projection with a lumped mass matrix: at each vertex the mean of the cells around it, weighted by their
    volumes in the mesh as it lies. Collective.

    Args:
        space: of scalar Lagrange elements on the mesh of the body.
    """
    mesh = body.mesh
    linear = fem.functionspace(mesh, ("Lagrange", 1))
    owned = mesh.topology.index_map(3).size_local
    corners = linear.dofmap.list[:owned]
    kind, degree = body.source.kind, body.degree
    middle = scalar_element(kind, 1).points.mean(axis=0)[None]
    volumes = np.abs(np.linalg.det(jacobians(kind, degree, mesh.geometry.x[mesh.geometry.dofmaps[0][:owned]], middle)))

    def gathered(cell_values: Floats) -> Floats:
        total = fem.Function(linear)
        np.add.at(total.x.array, corners, np.broadcast_to(cell_values, corners.T.shape).T)
        total.x.scatter_reverse(la.InsertMode.add)
        total.x.scatter_forward()
        return np.asarray(total.x.array)

    weights = gathered(volumes[:, 0])
    size = space.dofmap.index_map.size_local
    nodal_values = np.empty((size, values.shape[1]))
    smooth, nodal = fem.Function(linear), fem.Function(space)
    for column in range(values.shape[1]):
        smooth.x.array[:] = gathered(values[:, column] * volumes[:, 0]) / weights
        nodal.interpolate(smooth)
        nodal_values[:, column] = nodal.x.array[:size]
    return nodal_values


def shape_directions(body: Body, families: Mapping[str, FibreFamily], solution: Solution) -> dict[str, DataArray]:
    """Return unit vectors of the families on the computed body; collective.

    A family given by an array of the mesh file replaces this array, at the local geometry nodes or in the local cells
    as in the file. Other families are arrays in the cells: ``NAME``, or ``fibres.NAME`` where the file has an array of
    that name. Values of ghost cells are zero.
    """
    owned = np.arange(body.mesh.topology.index_map(3).size_local)
    count = owned.size + body.mesh.topology.index_map(3).num_ghosts
    corners = scalar_element(body.source.kind, body.degree).points
    arrays = dict[str, DataArray]()
    for name, family in families.items():
        (value, _) = family.quantities()["direction"]
        array = distribute(body, value.array) if isinstance(value, ByData) else None
        if array is not None and array.place == "nodes":
            nodes = body.mesh.geometry.dofmaps[0][owned]
            moved = _on_shape(body, family, solution, array.values[nodes], owned, corners)
            values = nodal_means(body.mesh.geometry.index_map(), nodes, moved)
            arrays[array.name] = DataArray(array.name, "nodes", unit_vectors(values))
        else:
            given = given_in_middles(body, name, family, solution, owned)[:, None]
            cell_values: Floats = np.zeros((count, 3))
            middle = corners.mean(axis=0)[None]
            cell_values[owned] = unit_vectors(_on_shape(body, family, solution, given, owned, middle)[:, 0])
            own_name = f"fibres.{name}" if name in body.source.data else name
            key = own_name if array is None else array.name
            arrays[key] = DataArray(key, "cells", cell_values)
    return arrays


def _on_shape(
    body: Body, family: FibreFamily, solution: Solution, directions: Floats, cells: Cells, points: Floats
) -> Floats:
    """Return given directions (cells, n, 3) at points (n, 3) of the reference cell on the computed body."""
    computed_is_current = solution.direction == "forward"
    if computed_is_current and family.given_on == "current" and solution.given_displacement is None:
        return directions
    vectors: Floats = directions[..., None]
    if family.given_on == "current":
        vectors = np.asarray(np.linalg.solve(given_gradients(body, solution, cells, points), vectors), dtype=float)
    if computed_is_current:
        vectors = gradients_at(body, solution, cells, points) @ vectors
    return vectors[..., 0]
