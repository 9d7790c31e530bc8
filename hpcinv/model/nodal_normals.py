"""Unit normals of regions of the boundary at the nodes of a vector space."""

import basix
import numpy as np
from dolfinx import fem, la

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.arrays import LocalIndices
from hpcinv.mesh.boundary_shells import cells_and_sides
from hpcinv.mesh.cells import kind_and_degree, scalar_element
from hpcinv.mesh.source import Floats

_SMOOTH = 0.7
"""Least cosine of the angle between a facet and the normal of its node (46°); raised, coarse curved surfaces are
refused; lowered, a sharp edge of 90° would count as smooth."""


def nodal_normals(space: fem.FunctionSpace, facets: LocalIndices) -> tuple[LocalIndices, Floats, Floats | None]:
    """Return local nodes of facets, their outward unit normals (n, 3), and the place of a sharp edge; collective.

    The normal of a node is the mean of its facets, weighted by their areas. It is exact on planes.

    Args:
        space: of vectors, on the present mesh.
        facets: of the boundary.

    Returns:
        The place is the same on all ranks; ``None`` if the facets make a smooth surface.
    """
    mesh, dofmap = space.mesh, space.dofmap
    element, cell_type = space.element.basix_element, mesh.basix_cell()
    kind, degree = kind_and_degree(mesh)
    closures = [np.asarray(closure) for closure in element.entity_closure_dofs[2]]
    shapes = scalar_element(kind, degree).tabulate(1, element.points)[..., 0]
    corners = basix.geometry(cell_type)[np.array(basix.topology(cell_type)[2])]
    sizes = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    outward = basix.cell.facet_outward_normals(cell_type) * sizes[:, None]
    positions = space.tabulate_dof_coordinates()
    facets = facets[facets < mesh.topology.index_map(2).size_local]
    sums = la.vector(dofmap.index_map, 3)
    totals = sums.array.reshape(-1, 3)
    parts = []
    for cell, local in zip(*cells_and_sides(mesh, facets), strict=True):
        closure = closures[local]
        nodes = mesh.geometry.x[mesh.geometry.dofmaps[0][cell]]
        points = shapes[0, closure] @ nodes
        J = np.stack([shapes[i, closure] @ nodes for i in (1, 2, 3)], axis=2)  # dx/dξ
        areas = np.abs(np.linalg.det(J))[:, None] * (outward[local] @ np.linalg.inv(J))
        dofs = dofmap.list[cell, closure]
        # From degree 3 on the points of an edge may be in another order than its degrees of freedom.
        order = np.argmin(np.linalg.norm(positions[dofs][:, None] - points, axis=2), axis=1)
        np.add.at(totals, dofs, areas[order])
        parts.append((dofs, areas[order]))
    sums.scatter_reverse(la.InsertMode.add)
    sums.scatter_forward()
    lengths = np.linalg.norm(totals, axis=1)
    used = np.flatnonzero(lengths > 0.0).astype(np.int32)
    normals = totals / np.where(lengths > 0.0, lengths, 1.0)[:, None]
    worst, place = 1.0, np.zeros(3)
    for dofs, areas in parts:
        cosines = np.einsum("ni,ni->n", areas, normals[dofs]) / np.linalg.norm(areas, axis=1)
        if cosines.min() < worst:
            worst, place = float(cosines.min()), positions[dofs[cosines.argmin()]]
    sharpest = mesh.comm.allreduce((worst, mesh.comm.rank), op=MPI.MINLOC)
    place = mesh.comm.bcast(place, root=sharpest[1])
    return used, normals[used], place if sharpest[0] < _SMOOTH else None
