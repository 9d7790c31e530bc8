"""Cells that a file numbers inside out, as legacy DOLFIN does, which sorts the nodes of each cell."""

import dataclasses

import numpy as np
import numpy.typing as npt

from hpcinv.mesh.cells import jacobians, mirrored, vertex_count
from hpcinv.mesh.checks import det
from hpcinv.mesh.source import Ints, MeshSource
from hpcinv.mesh.topology import FacetTable, neighbour_signs

_MIDDLE = np.full((1, 3), 0.25)  # a point of reference tetrahedra and hexahedra


def consistently_oriented(source: MeshSource) -> MeshSource:
    """Return a mesh of solids in which only inverted cells have a negative determinant, if others have a positive one.

    Cells on both sides of a facet are both inverted or both not; of cells on one side of it, one is inverted. Inverted
    are the fewer ones of each connected part. A note gives the number of cells that are renumbered.
    """
    vertices = source.cells[:, : vertex_count(source.kind)]
    with np.errstate(all="ignore"):  # coordinates are checked later
        is_negative = det(jacobians(source.kind, 1, source.points[vertices], _MIDDLE)[:, 0]) < 0
    if is_negative.all() or not is_negative.any():
        return source
    changed = is_negative != _inverted(source, vertices)
    if not changed.any():
        return source
    cells = source.cells.copy()
    cells[changed] = mirrored(source.kind, source.degree, cells[changed])
    note = f"{np.count_nonzero(changed):,} cells were numbered inside out (det J < 0) and have been renumbered"
    return dataclasses.replace(source, cells=cells, notes=(*source.notes, note))


def _inverted(source: MeshSource, vertices: Ints) -> npt.NDArray[np.bool_]:
    """Mask of the inverted cells, by the sides of facets on which cells are, whatever the order of their nodes."""
    table = FacetTable.build(source.kind, vertices)
    first, second, third = (source.points[table.vertices[:, i]] for i in range(3))
    normals = np.cross(second - first, third - first)
    offsets = source.points[vertices].mean(axis=1)[:, None] - first[table.cell_facets]
    is_above = (offsets * normals[table.cell_facets]).sum(axis=2).ravel() > 0
    order = np.argsort(table.cell_facets.ravel(), kind="stable")
    inner = order[table.sharing[table.cell_facets.ravel()[order]] == 2].reshape(-1, 2)
    one, other = (inner // table.cell_facets.shape[1]).T
    agree = np.where(is_above[inner[:, 0]] != is_above[inner[:, 1]], 1, -1)
    sign, part = neighbour_signs(one, other, agree, len(vertices))
    is_unlike = sign < 0
    shares = np.bincount(part, is_unlike) / np.maximum(np.bincount(part), 1)
    return np.asarray(is_unlike != (shares[part] > 0.5))
