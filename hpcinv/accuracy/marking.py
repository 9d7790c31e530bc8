"""Which cells to refine, and how often: the fewest cells for the error that is asked for; numpy alone.

Halving the cells of a cell's place divides its share of the error by ``2^k`` and makes eight of it. The fewest cells
with a given sum of shares are those whose shares per cell are equal, as far as cells can be split.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hpcinv.accuracy.forecast import Places

# Cells that are bisected to fit those which were marked, seen as a factor on the cells that are added.
CLOSURE = 1.5
DEEPEST = 40


@dataclass(frozen=True)
class MarkingPlan:
    """How often to halve each cell (n,), and what is to be expected of it in the end."""

    levels: npt.NDArray[np.int64]
    places: Places


def plan(indicators: npt.NDArray[np.float64], reduction: float, order: float) -> MarkingPlan:
    """Levels that divide the sum of the ``indicators`` (n,) of the cells by ``reduction`` with the fewest cells.

    Args:
        order: ``k``, with which the share of a cell falls.
    """
    shares = indicators / indicators.sum()
    positive = np.maximum(shares, 1e-300)

    def levels(threshold: float) -> npt.NDArray[np.int64]:
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
    return MarkingPlan(chosen, _expected(indicators, chosen, order))


def _expected(indicators: npt.NDArray[np.float64], levels: npt.NDArray[np.int64], order: float) -> Places:
    cells = 1 + CLOSURE * float(np.mean(8.0**levels - 1))
    error = float(np.sum(indicators * 2.0 ** (-order * levels)) / indicators.sum())
    return Places(cells, error)
