"""Which rank owns which cell: METIS through gmsh, now or beforehand, or PT-SCOTCH; and how good the partition is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import dolfinx
import numpy as np

from hpcinv.mesh.cells import vertex_count
from hpcinv.mesh.distributed.partitioned import cells_of
from hpcinv.mesh.io.gmsh_model import metis
from hpcinv.mesh.regions import Mesh
from hpcinv.mesh.source import Ints, MeshSource
from hpcinv.parallel.runtime import MPI, on_root

_UNEVEN = 0.1  # share of cells beyond the mean, of the fullest rank, above which a partition is made anew


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


def partitioner(comm: MPI.Intracomm, source: MeshSource, wanted: str) -> tuple[str, Callable[..., Any]]:
    """What distributes the cells of a source, for ``dolfinx.mesh.create_mesh``, and its name; collective.

    Args:
        wanted: "metis" or "scotch"; METIS has partitioned a partitioned mesh beforehand, and SCOTCH does it again where
            the ranks cannot have equal numbers of its parts.
    """
    if wanted == "scotch" or (source.is_partitioned and not _fit(source.parts, comm.size)):
        scotch = dolfinx.graph.partitioner_scotch()
        return "scotch", dolfinx.mesh.create_cell_partitioner(scotch, dolfinx.mesh.GhostMode.none, 2)
    if source.is_partitioned:
        return "parts", _sends(np.full(len(source.cells), comm.rank))
    # Run now, not inside DOLFINx, where an exception on rank 0 would leave the others waiting.
    owner: list[Ints] = []
    corners = source.cells[:, : vertex_count(source.kind)]
    on_root(comm, lambda: owner.append(metis(corners, source.kind, comm.size)))
    return "metis", _sends(owner[0] if owner else np.zeros(0, dtype=np.int64))


def _fit(parts: tuple[int, ...], size: int) -> bool:
    """Whether as many ranks have about as many cells each, if they take the parts of a mesh as they are."""
    if size >= len(parts):
        return False
    fullest = max(last - first for first, last in (cells_of(parts, size, rank) for rank in range(size)))
    return fullest * size <= (1 + _UNEVEN) * parts[-1]


def _sends(destinations: Ints) -> Callable[..., Any]:
    """A partitioner that sends each cell of this rank to a rank that is known."""

    def send(_comm: Any, _parts: int, _kinds: Any, _cells: Any) -> Any:
        return dolfinx.graph.adjacencylist(destinations.astype(np.int32).reshape(-1, 1))._cpp_object

    return send


def measure(mesh: Mesh, method: str) -> Partition:
    """Cells of each rank and the edge cut, of a mesh with facets and without ghost cells; collective.

    Of the two ranks that share a facet one does not own it.
    """
    cells = mesh.comm.allgather(mesh.topology.index_map(3).size_local)
    return Partition(method, tuple(cells), mesh.comm.allreduce(int(mesh.topology.index_map(2).num_ghosts)))
