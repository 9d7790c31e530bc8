"""Which rank owns which cell: METIS through gmsh, or PT-SCOTCH through DOLFINx; and how good the partition is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import dolfinx
import numpy as np

from hpcinv.mesh.cells import vertex_count
from hpcinv.mesh.gmsh_model import metis
from hpcinv.mesh.regions import Mesh
from hpcinv.mesh.source import Ints, MeshSource
from hpcinv.mesh.topology import FacetTable
from hpcinv.runtime import MPI, on_root


@dataclass(frozen=True)
class Partition:
    """How the cells are spread over the ranks: measured on the mesh as it stands, whoever made the partition."""

    method: str
    cells: tuple[int, ...]  # owned by each rank
    edge_cut: int  # facets between cells of different ranks

    @property
    def imbalance(self) -> float:
        """Cells of the fullest rank over the mean, less 1."""
        return max(self.cells) * len(self.cells) / sum(self.cells) - 1.0


def metis_partitioner(comm: MPI.Intracomm, source: MeshSource) -> Callable[..., Any]:
    """A partitioner for ``dolfinx.mesh.create_mesh`` that sends each cell where METIS says; collective."""

    def assign() -> Ints:
        corners = source.cells[:, : vertex_count(source.kind)]
        return metis(corners, source.kind, comm.size)

    # Run now, not inside DOLFINx, where an exception on rank 0 would leave the others waiting.
    owner: list[Ints] = []
    on_root(comm, lambda: owner.append(assign()))
    destinations = owner[0] if owner else np.zeros(0, dtype=np.int64)

    def partitioner(_comm: Any, _parts: int, _kinds: Any, _cells: Any) -> Any:
        return dolfinx.graph.adjacencylist(destinations.astype(np.int32).reshape(-1, 1))._cpp_object

    return partitioner


def scotch_partitioner(comm: MPI.Intracomm, source: MeshSource) -> Callable[..., Any]:
    """PT-SCOTCH on the dual graph, as DOLFINx offers it."""
    scotch = dolfinx.graph.partitioner_scotch()
    partitioner: Callable[..., Any] = dolfinx.mesh.create_cell_partitioner(scotch, dolfinx.mesh.GhostMode.none, 2)
    return partitioner


PARTITIONERS: dict[str, Callable[[MPI.Intracomm, MeshSource], Callable[..., Any]]] = {
    "metis": metis_partitioner,
    "scotch": scotch_partitioner,
}


def owners(mesh: Mesh) -> Ints:
    """Rank that owns each cell, in input order, on rank 0; empty elsewhere; collective."""
    mine = np.asarray(mesh.topology.original_cell_index)[: mesh.topology.index_map(3).size_local]
    gathered = mesh.comm.gather(mine)
    if gathered is None:
        return np.zeros(0, dtype=np.int64)
    owner = np.full(sum(map(len, gathered)), -1, dtype=np.int64)
    for rank, cells in enumerate(gathered):
        owner[cells] = rank
    return owner


def measure(mesh: Mesh, method: str, table: FacetTable | None) -> Partition:
    """Cells of each rank and the edge cut, from the facets that rank 0 knows; collective."""
    owner = owners(mesh)

    def count() -> Partition:
        assert table is not None
        cells = np.bincount(owner, minlength=mesh.comm.size)
        return Partition(method, tuple(cells.tolist()), table.edge_cut(owner))

    return on_root(mesh.comm, count)
