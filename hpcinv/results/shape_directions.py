"""Directions of fibres on the body that a solve has computed, for its shape files."""

from collections.abc import Mapping

import numpy as np

from hpcinv.base.quantity.spatial_fields import ByData
from hpcinv.job.fibres import FibreFamily
from hpcinv.mesh import Body
from hpcinv.mesh.cells import scalar_element
from hpcinv.mesh.data import distribute
from hpcinv.mesh.source import DataArray, Floats
from hpcinv.results.cell_fields import nodal_means
from hpcinv.results.cell_middles import Cells, given_gradients, given_in_middles, gradients_at, unit_vectors
from hpcinv.results.solution import Solution


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
