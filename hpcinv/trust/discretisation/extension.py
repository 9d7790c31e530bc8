"""Extension of a finite-element function to a finer geometry of its cells, beyond their sides."""

import numpy as np
from dolfinx import fem, la

from hpcinv.mesh.cells import jacobians, kind_and_degree, scalar_element
from hpcinv.mesh.checks import CHUNK
from hpcinv.mesh.interpolation import interpolate
from hpcinv.mesh.regions import Mesh
from hpcinv.mesh.source import Floats, Ints

_ROUNDING = 1e-12  # offset of a node, relative to the size of its cell, up to which it counts as in place


def extend(coarse: fem.Function, finer: fem.Function) -> None:
    """Interpolate a function in a space on the same cells, perhaps with a finer geometry; collective.

    A node that lies ``s`` away from its place in the coarse mesh gets ``u + ∇u s``, with the mean of ∇u over its cells.
    By reference coordinates alone it would get ``u``, and a rotation R would strain the cells there by ``(R - I) ∇s``.

    Args:
        coarse: scalar or vector in a Lagrange space; its mesh must lie where it was computed.
        finer: function in a Lagrange space, whose values are replaced.
    """
    space, target = coarse.function_space, finer.function_space
    interpolate(coarse, finer)
    if target.mesh is space.mesh:
        return
    size, points = target.dofmap.bs, target.element.basix_element.points
    slopes = space.element.basix_element.tabulate(1, points)[1:, :, :, 0]
    values = coarse.x.array.reshape(-1, size)
    added, counts = (la.vector(target.dofmap.index_map, n) for n in (size, 1))
    owned = np.arange(target.mesh.topology.index_map(3).size_local, dtype=np.int64)
    for cells in np.array_split(owned, 1 + len(owned) // CHUNK):
        nodes = _nodes(space.mesh, cells)
        offset = _positions(points, target.mesh, _nodes(target.mesh, cells)) - _positions(points, space.mesh, nodes)
        moved = np.abs(offset).max(axis=(1, 2)) > _ROUNDING * np.ptp(nodes, axis=1).max(axis=1)
        jacobian = jacobians(*kind_and_degree(space.mesh), nodes[moved], points)
        shift = np.linalg.solve(jacobian, offset[moved, :, :, None])[..., 0]  # in reference coordinates
        u, dofs = values[space.dofmap.list[cells[moved]]], target.dofmap.list[cells[moved]]
        change = sum((slope @ u) * shift[..., a, None] for a, slope in enumerate(slopes))
        np.add.at(added.array.reshape(-1, size), dofs, change)
        np.add.at(counts.array, dofs, 1.0)
    for vector in (added, counts):
        vector.scatter_reverse(la.InsertMode.add)
        vector.scatter_forward()
    finer.x.array.reshape(-1, size)[:] += added.array.reshape(-1, size) / np.maximum(counts.array, 1.0)[:, None]


def _nodes(mesh: Mesh, cells: Ints) -> Floats:
    """Geometry nodes of cells, (cells, nodes, 3)."""
    return np.asarray(mesh.geometry.x[mesh.geometry.dofmaps[0][cells]])


def _positions(points: Floats, mesh: Mesh, nodes: Floats) -> Floats:
    """Positions (cells, points, 3) of points of the reference cell."""
    return np.asarray(scalar_element(*kind_and_degree(mesh)).tabulate(0, points)[0, :, :, 0] @ nodes)
