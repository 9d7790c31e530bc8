"""The cells of a shape, or of the thick body of a shell, as a mesh file for other programs."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from hpcinv.errors import OutputError
from hpcinv.mesh.cells import FACET_KIND, vertex_count
from hpcinv.mesh.mesh_files import UnstorableMesh, has_20_nodes, save
from hpcinv.mesh.refine.degree import serendipity
from hpcinv.mesh.source import Ints, MeshSource
from hpcinv.mesh.topology import FacetTable


def write_cells(path: Path, source: MeshSource, cells: Ints | None, scale: float, unit: float) -> MeshSource:
    """Write cells with their regions and data, completely or not at all; return the mesh as the file holds it, in m.

    Names of regions have ``_`` instead of ``|``, which other programs refuse. Formats without hexahedra of 27 nodes get
    20, and the returned mesh has the geometry of these.

    Args:
        source: shape in m; of a shell its thick body.
        cells: rows of the cells to write, ``None`` for all.
        scale: factor of all lengths about the origin.
        unit: of the coordinates in the file, m.

    Raises:
        OutputError: it cannot be written, or the format cannot hold the mesh.
    """
    groups = tuple(dataclasses.replace(group, name=group.name.replace("|", "_")) for group in source.groups)
    mesh = dataclasses.replace(source, points=source.points * scale, groups=groups, unit=unit)
    mesh = mesh if cells is None else _part(mesh, np.sort(cells))
    if has_20_nodes(path, mesh):
        mesh = dataclasses.replace(mesh, nodes_per_cell=20, points=serendipity(mesh.kind, mesh.cells, mesh.points))
    else:
        mesh = dataclasses.replace(mesh, nodes_per_cell=mesh.cells.shape[1])
    try:
        save(path, mesh, mesh.points)
    except UnstorableMesh as error:
        raise OutputError(error.message) from None
    return mesh


def _part(source: MeshSource, cells: Ints) -> MeshSource:
    """Return some cells with their nodes, facets and regions."""
    vertices = source.cells[cells][:, : vertex_count(source.kind)]
    corners = source.facets[:, : vertex_count(FACET_KIND[source.kind])]
    facets = np.flatnonzero(FacetTable.build(source.kind, vertices).find(corners) >= 0)
    part = source.select(np.unique(source.cells[cells]), cells, facets)
    return dataclasses.replace(part, groups=tuple(group for group in part.groups if len(group.members)))
