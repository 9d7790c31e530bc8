"""Marking of cells for local refinement: the fewest cells for a given reduction of the error.

Halving the size of a cell divides its share of the error by ``2^k`` and makes eight cells of it. The number of cells is
smallest if all cells have the same share, as far as halving allows.
"""

from dataclasses import dataclass

import numpy as np

from hpcinv.accuracy.forecast import Places
from hpcinv.mesh.source import Floats, Ints

# Factor on the number of added cells, for those that are bisected to keep the mesh conforming.
CLOSURE = 1.5
DEEPEST = 40


@dataclass(frozen=True)
class MarkingPlan:
    """Number of halvings of each cell (n,), and the predicted effect."""

    levels: Ints
    places: Places


def plan(indicators: Floats, reduction: float, order: float) -> MarkingPlan:
    """Return levels that divide the sum of the cells' ``indicators`` (n,) by ``reduction`` with the fewest cells.

    Args:
        order: ``k`` of the share of a cell.
    """
    shares = indicators / indicators.sum()
    positive = np.maximum(shares, 1e-300)

    def levels(threshold: float) -> Ints:
        wanted = np.round(np.log2(positive / threshold) / (order + 3))
        return np.asarray(np.clip(wanted, 0, DEEPEST), dtype=np.int64)

    low, high = np.log(positive.max()) - DEEPEST * (order + 3), np.log(positive.max())
    for _ in range(60):
        middle = (low + high) / 2
        if float(np.sum(shares * 2.0 ** (-order * levels(np.exp(middle))))) * reduction > 1:
            high = middle
        else:
            low = middle
    chosen = levels(np.exp(low))
    cells = 1 + CLOSURE * float(np.mean(8.0**chosen - 1))
    return MarkingPlan(chosen, Places(cells, float(np.sum(shares * 2.0 ** (-order * chosen)))))
