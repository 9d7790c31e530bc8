"""Order of a mesh on one process: by parts, and back by tags."""

import dataclasses

import numpy as np

from hpcinv.errors import MeshError
from hpcinv.mesh.cells import vertex_count
from hpcinv.mesh.io.gmsh_model import metis
from hpcinv.mesh.source import Ints, MeshSource
from hpcinv.mesh.topology import FacetTable


def partitioned(source: MeshSource, count: int) -> tuple[MeshSource, int]:
    """A whole mesh divided into ``count`` parts by METIS, and the number of facets between parts.

    Raises:
        MeshError: the mesh has fewer cells than parts.
    """
    if count > len(source.cells):
        raise MeshError(
            f"{source.path}: has {len(source.cells)} cells, too few for {count} parts", "Choose fewer parts."
        )
    corners = source.cells[:, : vertex_count(source.kind)]
    part = metis(corners, source.kind, count)
    return sort_by_parts(source, part, count), int(FacetTable.build(source.kind, corners).separates(part).sum())


def sort_by_parts(source: MeshSource, part: Ints, count: int) -> MeshSource:
    """A whole mesh ordered by the ``part`` (cells,) of its cells, of ``count`` parts.

    A node belongs to the first part that has it, a facet to the last of the parts of its nodes.
    """
    cells = np.argsort(part, kind="stable")
    first = np.full(len(source.points), count, dtype=np.int64)
    for column in source.cells.T:
        np.minimum.at(first, column, part)
    nodes = np.argsort(first, kind="stable")
    facets = np.argsort(first[source.facets].max(axis=1, initial=0), kind="stable")
    parts = np.concatenate([[0], np.cumsum(np.bincount(part, minlength=count))])
    return dataclasses.replace(source.select(nodes, cells, facets), parts=tuple(parts.tolist()))


def sort_by_tags(source: MeshSource) -> MeshSource:
    """A whole mesh without parts, its nodes and cells sorted by their tags, and facets by their nodes."""
    tagged = source.select(np.argsort(source.node_tags), np.argsort(source.cell_tags), np.arange(len(source.facets)))
    nodes, cells = np.arange(len(source.points)), np.arange(len(source.cells))
    return dataclasses.replace(tagged.select(nodes, cells, np.lexsort(tagged.facets.T[::-1])), parts=())
