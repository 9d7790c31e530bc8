"""Partition of the cells among the ranks: METIS through gmsh, now or beforehand, or PT-SCOTCH; and its quality."""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import dolfinx
import numpy as np

from hpcinv.base.parallel.runtime import MPI, on_root
from hpcinv.errors import MeshError
from hpcinv.mesh.cells import vertex_count
from hpcinv.mesh.io.gmsh_model import metis
from hpcinv.mesh.regions import Mesh
from hpcinv.mesh.source import Ints, MeshSource
from hpcinv.mesh.topology import FacetTable
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
