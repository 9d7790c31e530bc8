"""Refinement of a mesh: all cells cut into eight, or marked cells bisected, with neighbours for conformity.

New nodes are mapped by the geometry of their cell, so that a curved body keeps its shape exactly.
"""

import dataclasses
from dataclasses import dataclass

import numpy as np

from hpcinv.mesh.cells import FACET_KIND
from hpcinv.mesh.refine.bisection import bisected, edges_to_cut
from hpcinv.mesh.refine.degree import add_inner_nodes, change_degree, inner_dofs
from hpcinv.mesh.refine.subdivision import Pieces, eighths, quarters
from hpcinv.mesh.source import Ints, MeshSource


@dataclass(frozen=True)
class RefinedMesh:
    """A refined mesh, and the index (cells,) of the parent of each of its cells."""

    source: MeshSource
    parent: Ints


def refine(source: MeshSource, marked: Ints | None = None) -> RefinedMesh:
    """Cut every cell into eight, or bisect all edges of the ``marked`` tetrahedra and others for conformity.

    Remaining nodes and cells keep their tags; the pieces of a cell take its place in the order of cells. Groups are
    kept, nodal data are interpolated, and cell data are inherited. The source must be a valid mesh (`checks.check`).
    Not collective.

    Raises:
        ValueError: hexahedra are marked; they can only be refined everywhere.
    """
    if marked is not None and source.kind != "tetrahedron":
        raise ValueError("only tetrahedra can be refined in places")
    fine = change_degree(source, 2)  # has nodes at all places where a cell can be cut
    if marked is None:
        cells, facets = eighths(fine), quarters(FACET_KIND[fine.kind], fine.facets)
    else:
        cells, facets = _bisected(fine, marked)
    parents = {2: facets.parents, 3: cells.parents}
    refined = dataclasses.replace(
        fine,
        degree=1,
        cells=cells.vertices,
        cell_tags=_cell_tags(source, cells.parents),
        facets=facets.vertices,
        groups=tuple(
            dataclasses.replace(g, members=np.flatnonzero(np.isin(parents[g.dim], g.members))) for g in fine.groups
        ),
        data={
            name: dataclasses.replace(a, values=a.values[cells.parents]) if a.place == "cells" else a
            for name, a in fine.data.items()
        },
    )
    if source.degree == 2:
        refined = add_inner_nodes(refined, fine, cells.parents, cells.positions)
    return RefinedMesh(refined.drop_unused_nodes(), cells.parents)


def _bisected(fine: MeshSource, marked: Ints) -> tuple[Pieces, Pieces]:
    """Pieces of cells and facets of a mesh of degree 2 after bisection of the ``marked`` cells."""
    chosen = np.zeros(len(fine.cells), dtype=bool)
    chosen[marked] = True
    corners, middles = fine.cells[:, :4], fine.cells[:, inner_dofs(fine.kind, 1)]
    edges = edges_to_cut(fine.points, corners, middles, chosen)
    return bisected(corners, edges), bisected(fine.facets[:, :3], edges)


def _cell_tags(source: MeshSource, parent: Ints) -> Ints:
    """Old tags for cells that were not cut, new ones for pieces."""
    is_piece = np.bincount(parent, minlength=len(source.cells))[parent] > 1
    return np.where(is_piece, source.cell_tags.max() + np.cumsum(is_piece), source.cell_tags[parent])
