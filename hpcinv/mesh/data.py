"""Data arrays of a mesh file on a distributed body: their local values, and functions of these."""

import dataclasses

import basix.ufl
import numpy as np
import numpy.typing as npt
from dolfinx import fem

from hpcinv.base.quantity.suggestions import did_you_mean
from hpcinv.errors import MeshError
from hpcinv.mesh.body import Body, local_node_values
from hpcinv.mesh.distributed.rows import Rows
from hpcinv.mesh.source import DataArray, Floats

SHAPES: dict[int, tuple[int, ...]] = {1: (), 3: (3,), 9: (3, 3)}  # by the number of components


def distribute(body: Body, name: str) -> DataArray:
    """The data array ``name`` at the local geometry nodes or in the local cells, with ghosts; collective.

    Raises:
        MeshError: on all ranks, if the mesh has no such array, or if values of it are missing or not finite.
    """
    array, mesh = _find(body, name), body.mesh
    rows = Rows.distributed(mesh.comm, len(array.values))
    _check(body, array, rows)
    if array.place == "nodes":
        return dataclasses.replace(array, values=local_node_values(body, array.values))
    return dataclasses.replace(array, values=rows.fetch(array.values, np.asarray(mesh.topology.original_cell_index)))


def as_function(body: Body, array: DataArray) -> fem.Function:
    """Function with the local values that ``distribute`` returns, and with their name; collective.

    Piecewise constant for cells, Lagrange of the geometry degree for nodes; of shape (), (3,) or (3, 3).
    """
    mesh, geometry = body.mesh, body.mesh.geometry
    components = array.values.shape[1]
    shape = SHAPES[components]
    if array.place == "nodes":
        element = basix.ufl.element("Lagrange", mesh.basix_cell(), body.degree, shape=shape)
    else:
        element = basix.ufl.element("DG", mesh.basix_cell(), 0, shape=shape)
    function = fem.Function(fem.functionspace(mesh, element), name=array.name)
    cell_values = array.values[geometry.dofmaps[0]] if array.place == "nodes" else array.values[:, None]
    function.x.array.reshape(-1, components)[function.function_space.dofmap.list] = cell_values
    return function


def geometry_node_values(body: Body, function: fem.Function) -> Floats:
    """Values (local nodes, 1) of a continuous scalar function at the geometry nodes of its mesh; collective."""
    mesh, degree = body.mesh, body.degree
    element = basix.ufl.element("Lagrange", mesh.basix_cell(), degree)
    nodal = fem.Function(fem.functionspace(mesh, element))
    nodal.interpolate(function)
    nodal.x.scatter_forward()
    values = np.empty((mesh.geometry.x.shape[0], 1))
    values[mesh.geometry.dofmaps[0], 0] = nodal.x.array[nodal.function_space.dofmap.list]
    return values


def _find(body: Body, name: str) -> DataArray:
    data = body.source.data
    if name in data:
        return data[name]
    there = ", ".join(f"{a.name} ({a.place}, {a.values.shape[1]})" for a in data.values())
    raise MeshError(
        f"{body.source.path}: no data array '{name}'.{did_you_mean(name, data, list_all=False)}",
        f"The mesh has, with place and number of components: {there}."
        if data
        else "The mesh has none; arrays have 1, 3 or 9 numbers for each node or each solid cell.",
    )


def _check(body: Body, array: DataArray, rows: Rows) -> None:
    wrong = np.flatnonzero(~np.isfinite(array.values).all(axis=1))
    tags = body.source.node_tags if array.place == "nodes" else body.source.cell_tags
    faults = rows.comm.allgather((tags[wrong[:1]].tolist(), len(wrong)))
    if count := sum(number for _, number in faults):
        first = next(tag for some, _ in faults for tag in some)
        raise MeshError(
            f"{body.source.path}: data '{array.name}' is missing or not finite on {count} of {rows.total}"
            f" {array.place} (first: {array.place.removesuffix('s')} {first})",
            f"Give the array a finite value on all {array.place} of the body.",
        )


def cell_vectors(function: fem.Function) -> Floats:
    """Return the vectors at the points of each local cell, ghosts included, (cells, points, 3)."""
    return np.asarray(function.x.array.reshape(-1, 3)[function.function_space.dofmap.list])


def middle_vectors(function: fem.Function, cells: npt.NDArray[np.integer]) -> Floats:
    """Return the vectors in the middle of local cells, (cells, 3)."""
    element = function.function_space.element.basix_element
    shapes = element.tabulate(0, element.points.mean(axis=0)[None])[0, 0, :, 0]
    return np.asarray(np.einsum("n,cni->ci", shapes, cell_vectors(function)[cells]))
