"""Numbers of nodes and cells in the mesh file of a distributed body."""

import numpy as np
from dolfinx import fem

from hpcinv.mesh.body import Body
from hpcinv.mesh.cells import scalar_element
from hpcinv.mesh.distributed.rows import Rows
from hpcinv.mesh.source import Ints


def cell_numbers(body: Body) -> Ints:
    """Return the numbers of the local cells in the file, in the surface of a shell, (cells,); collective."""
    source = body.source
    rows = Rows.distributed(body.mesh.comm, len(source.cells))
    numbers = np.resize(source.in_file.cell_tags, len(source.cells))
    return rows.fetch(numbers[:, None], np.asarray(body.mesh.topology.original_cell_index))[:, 0]


def node_numbers(body: Body, space: fem.FunctionSpace) -> Ints:
    """Return the numbers in the file of the local nodes of a scalar Lagrange space; collective.

    Nodes that the file does not have are 0. The nodes of a shell have the number of their node of the surface.
    """
    source, geometry = body.source, body.source_geometry
    numbers = np.resize(source.in_file.node_tags, len(source.points))
    rows = Rows.distributed(body.mesh.comm, len(source.points))
    source_numbers = rows.fetch(numbers[:, None], geometry.input_global_indices)[:, 0]
    places, own = space.element.basix_element.points, scalar_element(source.kind, source.degree).points
    distances = np.abs(places[:, None] - own).max(axis=2)
    node, point = np.nonzero(distances < 1e-9)
    dofs = space.dofmap.list
    result: Ints = np.zeros(space.dofmap.index_map.size_local + space.dofmap.index_map.num_ghosts, dtype=np.int64)
    result[dofs[:, node]] = source_numbers[geometry.dofmaps[0][:, point]]
    return result
