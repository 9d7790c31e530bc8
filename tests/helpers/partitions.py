"""How cells and facets are distributed over the ranks."""

from collections.abc import Iterable

import basix
import dolfinx
import numpy as np

from hpcinv.mesh import Body
from hpcinv.mesh.source import MeshSource

VERTICES = {("tetrahedron", 2): 3, ("tetrahedron", 3): 4, ("hexahedron", 2): 4, ("hexahedron", 3): 8}


def facet_sets(source: MeshSource) -> list[list[frozenset[int]]]:
    """The facets of every cell as sets of vertices, the slow and obvious way."""
    local = basix.topology(basix.CellType[source.kind])[2]
    return [[frozenset(cell[v] for v in f) for f in local] for cell in source.cells.tolist()]


def slow_edge_cut(source: MeshSource, owner: Iterable[int]) -> int:
    ranks: dict[frozenset[int], list[int]] = {}
    for facets, rank in zip(facet_sets(source), owner, strict=True):
        for facet in facets:
            ranks.setdefault(facet, []).append(rank)
    return sum(len(set(r)) > 1 for r in ranks.values())


def owners(body: Body) -> np.ndarray:
    """Rank that owns each cell of the source."""
    mine = body.mesh.topology.original_cell_index[: body.mesh.topology.index_map(3).size_local]
    ranks = {int(cell): rank for rank, cells in enumerate(body.mesh.comm.allgather(mine)) for cell in cells}
    return np.array([ranks[cell] for cell in range(len(ranks))])


def input_vertex_sets(body: Body, dim: int, entities: np.ndarray) -> set[frozenset[int]]:
    """Vertex sets, numbered as in the source, of local entities of all ranks; known to every rank."""
    nodes = dolfinx.mesh.entities_to_geometry(body.mesh, dim, entities) if len(entities) else np.zeros((0, 1), int)
    nodes = nodes[:, : VERTICES[body.source.kind, dim]]
    mine = {frozenset(row) for row in body.mesh.geometry.input_global_indices[nodes].tolist()}
    return set().union(*body.mesh.comm.allgather(mine))
