"""Partition of the cells among the ranks: METIS through gmsh, now or beforehand, or PT-SCOTCH; and its quality."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import dolfinx
import numpy as np

from hpcinv.base.parallel.runtime import MPI, on_root
from hpcinv.mesh.cells import vertex_count
from hpcinv.mesh.io.gmsh_model import metis
from hpcinv.mesh.regions import Mesh
from hpcinv.mesh.source import Ints, MeshSource
from hpcinv.on_demand import on_demand

_MOST_IMBALANCE = 0.1  # above which the parts of a partitioned mesh are partitioned again


@dataclass(frozen=True)
class Partition:
    """Distribution of the cells over the ranks, measured on the distributed mesh."""

    method: str
    cells: tuple[int, ...]  # owned by each rank
    edge_cut: int  # facets between cells of different ranks

    @property
    def imbalance(self) -> float:
        """Largest number of cells of a rank divided by the mean, less 1."""
        return max(self.cells) * len(self.cells) / sum(self.cells) - 1.0


def partitioner(comm: MPI.Intracomm, source: MeshSource, wanted: str) -> tuple[str, Callable[..., Any]]:
    """Name of the method and partitioner for ``dolfinx.mesh.create_mesh``; collective.

    Args:
        wanted: "metis" or "scotch". The parts of a partitioned mesh (METIS) are kept, unless they would be distributed
            unevenly over the ranks: then SCOTCH partitions the mesh again.
    """
    if wanted == "scotch" or (source.is_partitioned and not _balanced(source.parts, comm.size)):
        scotch = dolfinx.graph.partitioner_scotch()
        return "scotch", dolfinx.mesh.create_cell_partitioner(scotch, dolfinx.mesh.GhostMode.none, 2)
    if source.is_partitioned:
        return "parts", _partitioner_to(np.full(len(source.cells), comm.rank))
    # Not inside DOLFINx, where the other ranks would wait forever after an exception on rank 0.
    owner: list[Ints] = []
    corners = source.cells[:, : vertex_count(source.kind)]
    on_root(comm, lambda: owner.append(metis(corners, source.kind, comm.size)))
    return "metis", _partitioner_to(owner[0] if owner else np.zeros(0, dtype=np.int64))


def _balanced(parts: tuple[int, ...], size: int) -> bool:
    """Return whether ``size`` ranks have about equal numbers of cells if the parts are distributed as they are."""
    if size >= len(parts):
        return False
    cells_of = on_demand("cells of a rank in a partitioned mesh")
    fullest = max(last - first for first, last in (cells_of(parts, size, rank) for rank in range(size)))
    return bool(fullest * size <= (1 + _MOST_IMBALANCE) * parts[-1])


def _partitioner_to(destinations: Ints) -> Callable[..., Any]:
    """Partitioner that sends each cell of this rank to its given destination."""

    def send(_comm: Any, _parts: int, _kinds: Any, _cells: Any) -> Any:
        return dolfinx.graph.adjacencylist(destinations.astype(np.int32).reshape(-1, 1))._cpp_object

    return send


def partition_of(mesh: Mesh, method: str) -> Partition:
    """Partition of a distributed mesh with facets and without ghost cells; collective.

    The edge cut is the number of facets that a rank has without owning them.
    """
    cells = mesh.comm.allgather(mesh.topology.index_map(3).size_local)
    return Partition(method, tuple(cells), mesh.comm.allreduce(int(mesh.topology.index_map(2).num_ghosts)))
