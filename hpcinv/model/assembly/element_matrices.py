"""Element matrices from moduli at quadrature points and tabulated basis functions, by one matrix product.

Forms have separate loops for each pair of components and directions. Here they are, for many cells, one
product of moduli (cells × components, points × directions) by basis functions (points × directions, pairs of basis
functions) in BLAS, which takes a quarter of the time on tetrahedra and a sixth on hexahedra.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from hpcinv.base.quantity.arrays import LocalIndices
from hpcinv.mesh.source import Floats
from hpcinv.model.assembly.moduli_at_points import ModuliAtPoints
from hpcinv.model.assembly.tangent_moduli import Slot
from hpcinv.model.spaces import Unknowns

_CHUNK = 2**19  # entries of element matrices at a time, which fit in the cache of a core


class ElementMatrices:
    """Element matrices of volume integrals over the same cells.

    Iteration evaluates them in the present state, for some cells at a time: arrays (cells, *block.shape) of each block.

    Args:
        director: unknowns of the displacement, if they are not at the nodes.

    Attributes:
        cells: owned cells.
        blocks: blocks of the matrices, by test and trial functions.
    """

    def __init__(self, moduli: ModuliAtPoints, unknowns: Unknowns, director: Any = None) -> None:
        self._mesh = mesh = unknowns.mesh
        self._values, points, weights = moduli.values, moduli.points, moduli.weights
        owned = np.arange(mesh.topology.index_map(mesh.topology.dim).size_local, dtype=np.int32)
        self.cells: LocalIndices = owned if moduli.cells is None else moduli.cells
        tables = [tabulated(element, points) for element in unknowns.scalar_elements]
        if director is not None:
            tables[0] = director.functions(tables[0])
        firsts = [0, 3 * tables[0].shape[2]]  # the first unknown of displacement and pressure
        blocks: dict[tuple[int, int], Block] = {}
        place = 0
        for test, trial in moduli.pairs:
            key = test.part, trial.part
            nodes = [Nodes(firsts[s.part], s.components, tables[s.part].shape[2]) for s in (test, trial)]
            block = blocks.setdefault(key, Block(*nodes))
            block.add(place, weights, *(tables[slot.part][directions_of(slot)] for slot in (test, trial)))
            place += int(np.prod(test.shape + trial.shape))
        self.blocks = tuple(blocks.values())

    def __iter__(self) -> Iterator[tuple[slice, list[Floats]]]:
        for chunk in self.chunks():
            moduli = self._values(self._mesh, self.cells[chunk])
            yield chunk, [block(moduli) for block in self.blocks]

    def chunks(self) -> Iterator[slice]:
        """Yield slices of the cells that are evaluated together."""
        step = max(_CHUNK // sum(math.prod(block.shape) for block in self.blocks), 16)
        for start in range(0, len(self.cells), step):
            yield slice(start, min(start + step, len(self.cells)))


@dataclass(frozen=True)
class Nodes:
    """Unknowns of displacement or pressure in a cell: from ``first`` on, ``components`` at each of ``count`` nodes."""

    first: int
    components: int
    count: int

    def leading(self) -> LocalIndices:
        """Return the first unknown of each node."""
        return self.first + self.components * np.arange(self.count, dtype=np.int32)


class Block:
    """Entries for displacement or pressure as test functions, and as trial functions.

    Attributes:
        rows, columns: unknowns of test and trial functions.
    """

    def __init__(self, rows: Nodes, columns: Nodes) -> None:
        self.rows, self.columns = rows, columns
        self._places: list[tuple[int, int, int]] = []
        self._table: Floats = np.zeros((0, 0))

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Shape of the entries of one cell: test and trial component, test and trial node."""
        return self.rows.components, self.columns.components, self.rows.count, self.columns.count

    def add(self, place: int, weights: Floats, test: Floats, trial: Floats) -> None:
        """Add moduli from ``place`` on, of functions tabulated as (directions, points, functions)."""
        self._places.append((place, len(test), len(trial)))
        products = np.einsum("q,aqi,bqj->qabij", weights, test, trial, optimize=True)
        table = products.reshape(-1, test.shape[2] * trial.shape[2])
        self._table = np.concatenate([self._table, table]) if len(self._table) else table

    def __call__(self, moduli: Floats) -> Floats:
        cells, points, _ = moduli.shape
        m, n = self.rows.components, self.columns.components
        parts = []
        for place, a, b in self._places:
            pair_moduli = moduli[:, :, place : place + m * a * n * b].reshape(cells, points, m, a, n, b)
            parts.append(pair_moduli.transpose(0, 2, 4, 1, 3, 5).reshape(cells * m * n, points * a * b))
        product: Floats = (parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)) @ self._table
        return product.reshape(cells, *self.shape)


def directions_of(slot: Slot) -> slice:
    """Return the entries of `tabulated` that belong to a slot: the values, or the derivatives."""
    return slice(1, 4) if slot.is_gradient else slice(0, 1)


def tabulated(element: Any, points: Floats) -> Floats:
    """Return values of basis functions and their derivatives on the reference cell, (4, points, functions)."""
    table: Floats = element.tabulate(1, points).reshape(4, len(points), -1)
    return table
