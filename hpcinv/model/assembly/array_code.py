"""NumPy's versions of ``csr_tangent.c`` and ``tangent_product.c``, for machines without a C compiler.

Their functions take the same arguments.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hpcinv.base.quantity.arrays import LocalIndices, Singles
from hpcinv.mesh.source import Floats

_GROUPS = 64
"""groups of cells that are multiplied at once; with more, their values leave the cache of a core"""

type SlotNumbers = tuple[int, int, int, int, int]
"""first unknown, components, nodes, directions, place in the tables"""


class CsrCode:
    """Functions of ``csr_tangent.c``."""

    @staticmethod
    def find(
        _count: int,
        row: LocalIndices,
        column: LocalIndices,
        starts: LocalIndices,
        columns: LocalIndices,
        entries: LocalIndices,
    ) -> None:
        width = 1 + int(max(columns.max(initial=0), column.max(initial=0)))
        names = np.repeat(np.arange(len(starts) - 1), np.diff(starts)) * width + columns  # ascending
        entries[:] = np.searchsorted(names, row.astype(np.int64) * width + column)

    @staticmethod
    def add(
        cells: int,
        m: int,
        n: int,
        nodes: int,
        others: int,
        entries: Floats,
        first: LocalIndices,
        row: LocalIndices,
        _per_pair: int,
        values: Floats,
    ) -> None:
        first, row = first.reshape(cells, nodes, others), row.reshape(cells, nodes, -1)
        pairs = first[:, None] + np.arange(m)[:, None, None] * row[:, None]
        places = pairs[:, :, None] + np.arange(n)[:, None, None]
        np.add.at(values, places.ravel(), entries.ravel())


class ProductCode:
    """Function of ``tangent_product.c``.

    Args:
        tests, trials: slots.
        are_points_given: whether the moduli are given at the points of the product.
    """

    def __init__(self, tests: Sequence[SlotNumbers], trials: Sequence[SlotNumbers], *, are_points_given: bool) -> None:
        self._tests, self._trials, self._are_points_given = tests, trials, are_points_given

    def multiply(
        self,
        groups: int,
        moduli: Singles,
        shares: Singles,
        tables: Singles,
        places: LocalIndices,
        x: Singles,
        y: Singles,
    ) -> None:
        for begin in range(0, groups, _GROUPS):
            chosen = slice(begin, begin + _GROUPS)
            products = self._products(moduli[chosen], shares, tables, x[places[chosen]])
            np.add.at(y, places[chosen].ravel(), products.ravel())

    def _products(self, moduli: Singles, shares: Singles, tables: Singles, nodal: Singles) -> Singles:
        """Return the products for some groups of cells, (groups, unknowns, lanes)."""
        groups, points = len(nodal), len(shares)

        def table_of(slot: SlotNumbers) -> Singles:
            _, _, nodes, directions, place = slot
            return tables[place : place + points * directions * nodes].reshape(points, directions, nodes)

        def nodes_of(slot: SlotNumbers, values: Singles) -> Singles:
            first, components, nodes, *_ = slot
            return values[:, first : first + components * nodes].reshape(groups, components, nodes, -1)

        parts = [np.einsum("pdn,gcnl->gpcdl", table_of(slot), nodes_of(slot, nodal)) for slot in self._trials]
        values = np.concatenate([part.reshape(groups, points, -1, part.shape[-1]) for part in parts], axis=2)
        if self._are_points_given:
            duals = np.einsum("p,gprcl,gpcl->gprl", np.diagonal(shares), moduli, values, optimize=True)
        else:
            duals = np.einsum("pi,gircl,gpcl->gprl", shares, moduli, values, optimize=True)
        products, place = np.zeros_like(nodal), 0
        for slot in self._tests:
            _, components, _, directions, _ = slot
            own = duals[:, :, place : place + components * directions]
            own = own.reshape(groups, points, components, directions, -1)
            target = nodes_of(slot, products)  # a view
            target += np.einsum("pdn,gpcdl->gcnl", table_of(slot), own)
            place += components * directions
        return products
