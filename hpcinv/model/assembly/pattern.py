"""Sparsity pattern of a tangent, found node by node.

The unknowns of a node are consecutive, and belong to the same cells. So DOLFINx finds the pairs of nodes, a sixth or a
ninth as many as pairs of unknowns, and each is then replaced by the pairs of their unknowns.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import cpp, la

from hpcinv.base.quantity.arrays import LocalIndices
from hpcinv.model.spaces import Unknowns

_TAG = 1  # of messages by which ranks agree on a map


@dataclass(frozen=True)
class Pattern:
    """Rows of local unknowns, ghosts included, in the manner of CSR.

    Attributes:
        starts: where each row begins, and the end.
        names: global number of each column, (all columns,).
        nodes, components: node of each local unknown, and its number there.
        pairs: pairs of nodes in the manner of CSR: starts, columns, and the place of the second node's first unknown
            in rows of the first node.
    """

    starts: LocalIndices
    names: npt.NDArray[np.int64]
    nodes: LocalIndices
    components: LocalIndices
    pairs: tuple[LocalIndices, LocalIndices, LocalIndices]

    def entries(self, rows: LocalIndices, columns: LocalIndices, find: Callable[..., None]) -> LocalIndices:
        """Return the numbers of entries, by local unknowns; they must be in the pattern.

        Nodes have a ninth as many pairs as unknowns: the search among them takes half the time.

        Args:
            find: the function of ``csr_tangent.c``.
        """
        starts, neighbours, places = self.pairs
        pair = np.empty(len(rows), dtype=np.int32)
        find(len(rows), self.nodes[rows], self.nodes[columns], starts, neighbours, pair)
        return self.starts[rows] + places[pair] + self.components[columns]


def pattern_of(unknowns: Unknowns) -> tuple[Pattern, LocalIndices]:
    """Return the pattern of integrals over cells, and the column of each entry; collective.

    Columns ascend in each row: local unknowns, then unknowns of nodes that are not on this rank. Matrices order them
    differently, so the pattern does not keep them.

    The unknowns of each node must be consecutive (`Unknowns.has_whole_nodes`).
    """
    dofmap, mesh = unknowns.space.dofmap, unknowns.mesh
    unknown_map, bs = dofmap.index_map, dofmap.index_map_bs
    cell_dofs = unknowns.dofs_of_cells()
    components = np.zeros(bs * (unknown_map.size_local + unknown_map.num_ghosts), dtype=np.int32)  # at first ones
    for part in cell_dofs:
        components[part[:, :, 0]] = part.shape[2]
    first = np.flatnonzero(components)  # unknown of each local node
    number = np.cumsum(components > 0, dtype=np.int32) - 1
    names = bs * unknown_map.local_range[0] + first

    nodes = _node_map(unknown_map, bs, first)
    pattern = cpp.la.SparsityPattern(mesh.comm, [nodes, nodes], [1, 1])
    owned_cells = mesh.topology.index_map(mesh.topology.dim).size_local
    for cell in number[np.concatenate([part[:owned_cells, :, 0] for part in cell_dofs], axis=1)]:
        pattern.insert(cell, cell)
    pattern.finalize()
    graph = la.matrix_csr(pattern, dtype=np.float32)  # which has the map of the columns, unlike the pattern
    starts, columns = graph.indptr, graph.indices
    described = la.vector(graph.index_map(1), 2, dtype=np.int64)  # first unknown and components
    entries = described.array.reshape(-1, 2)
    entries[: nodes.size_local] = np.stack([names, components[first]], axis=1)[: nodes.size_local]
    described.scatter_forward()
    names, widths = entries[:, 0], entries[:, 1].astype(np.int32)
    rows, row_columns, places = _unrolled(starts, columns, widths[: len(starts) - 1], widths)
    pairs = starts.astype(np.int32), columns, places
    node_components = np.arange(len(number), dtype=np.int32) - first.astype(np.int32)[number]
    return Pattern(rows, _ranges(names, widths), number, node_components, pairs), row_columns


def _node_map(unknowns: Any, bs: int, first: npt.NDArray[np.int64]) -> Any:
    """Return DOLFINx's map of the nodes with these local unknowns; collective."""
    owned = int(np.searchsorted(first, bs * unknowns.size_local))
    begin = unknowns.comm.exscan(owned) or 0
    numbers = la.vector(unknowns, bs, dtype=np.int64)
    numbers.array[first[:owned]] = begin + np.arange(owned)
    numbers.scatter_forward()
    ghosts = first[owned:]
    owners = np.asarray(unknowns.owners)[ghosts // bs - unknowns.size_local]
    return cpp.common.IndexMap(unknowns.comm, owned, numbers.array[ghosts], owners.astype(np.int32), _TAG)


def _unrolled(
    starts: LocalIndices, columns: LocalIndices, rows: LocalIndices, widths: LocalIndices
) -> tuple[LocalIndices, LocalIndices, LocalIndices]:
    """Return rows and columns of unknowns from rows and columns of nodes, and the place of each node in its row.

    Args:
        rows: number of unknowns of each node with a row.
        widths: number of unknowns of each node with a column.
    """
    begins = np.cumsum(widths, dtype=np.int32) - widths
    node_columns = _ranges(begins[columns], widths[columns])  # columns of a row of each node
    ends = np.zeros(len(columns) + 1, dtype=np.int32)
    np.cumsum(widths[columns], out=ends[1:])
    node_starts, lengths = ends[starts[:-1]], ends[starts[1:]] - ends[starts[:-1]]
    unrolled = np.zeros(int(rows.sum()) + 1, dtype=np.int32)
    np.cumsum(np.repeat(lengths, rows), out=unrolled[1:])
    unknown_columns = node_columns[_ranges(np.repeat(node_starts, rows), np.repeat(lengths, rows))]
    return unrolled, unknown_columns, ends[:-1] - np.repeat(node_starts, np.diff(starts))


def _ranges(begins: npt.NDArray[Any], lengths: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return ``begin, begin + 1, …`` of each length, one range after the other, in the type of ``begins``."""
    ends = np.cumsum(lengths, dtype=begins.dtype)
    numbers = np.arange(ends[-1] if len(ends) else 0, dtype=begins.dtype)
    numbers += np.repeat(begins - (ends - lengths), lengths)
    return numbers
