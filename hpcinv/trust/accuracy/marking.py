"""Marking of cells for local refinement: the fewest cells for a given reduction of the error.

Halving the size of a cell divides its share of the error by ``2^k`` and makes eight cells of it. The number of cells is
smallest if all cells have the same share, as far as halving allows. Of cells that touch a singular edge, whose ``k`` is
small, the pieces that touch it are halved again, so that the mesh is graded towards it.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hpcinv.mesh.source import Floats, Ints
from hpcinv.trust.accuracy.refinement_forecast import RefinementPlaces

# Factor on the number of added cells, for those that are bisected to keep the mesh conforming.
CLOSURE = 1.5
DEEPEST = 40
TOUCHING = 2.0  # pieces of a cell that touch its singular edge (with closure); more: fewer halvings there


@dataclass(frozen=True)
class CellErrors:
    """Errors of cells, in the order of the source.

    Attributes:
        shares: of the error, (n,).
        orders: orders with which they fall, (n,); infinite where no singular edge limits them.
    """

    shares: Floats
    orders: Floats

    @property
    def touching(self) -> npt.NDArray[np.bool_]:
        """Mask (n,) of cells that touch a singular edge."""
        return np.asarray(np.isfinite(self.orders))


@dataclass(frozen=True)
class MarkingPlan:
    """Number of halvings of each cell (n,), and the predicted effect."""

    levels: Ints
    places: RefinementPlaces


def plan(indicators: Floats, reduction: float, order: float, limits: Floats | None = None) -> MarkingPlan:
    """Return levels that divide the sum of the cells' ``indicators`` (n,) by ``reduction`` with the fewest cells.

    Args:
        order: ``k`` of the share of a cell.
        limits: least ``k`` of cells that touch a singular edge (n,), infinite of others.
    """
    shares = indicators / indicators.sum()
    positive = np.maximum(shares, 1e-300)
    graded = np.zeros(len(shares), dtype=bool) if limits is None else np.isfinite(limits)
    orders = np.full(len(shares), order) if limits is None else np.minimum(limits, order)
    growth = np.where(graded, np.log2(TOUCHING), 3.0)

    def levels(threshold: float) -> Ints:
        wanted = np.round(np.log2(positive / threshold) / (orders + growth))
        return np.asarray(np.clip(wanted, 0, DEEPEST), dtype=np.int64)

    low, high = np.log(positive.max()) - DEEPEST * (order + 3), np.log(positive.max())
    for _ in range(60):
        middle = (low + high) / 2
        if remaining(shares, orders, levels(np.exp(middle))) * reduction > 1:
            high = middle
        else:
            low = middle
    chosen = levels(np.exp(low))
    pieces = np.where(graded, 7 * (TOUCHING**chosen - 1), 8.0**chosen - 1)
    return MarkingPlan(
        chosen, RefinementPlaces(1 + CLOSURE * float(np.mean(pieces)), remaining(shares, orders, chosen))
    )


def remaining(shares: Floats, orders: Floats, levels: Ints) -> float:
    """Return the predicted ratio of errors after ``levels`` halvings of each cell."""
    left = np.where(levels > 0, 2.0 ** (-np.where(levels > 0, orders, 1.0) * levels), 1.0)
    return float(np.sum(shares * left) / max(np.sum(shares), 1e-300))
