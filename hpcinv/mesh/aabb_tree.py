"""Pairs of intersecting boxes, by balanced trees of bounding boxes traversed for all pairs at once."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hpcinv.mesh.source import Floats, Ints

_CHUNK = 200_000  # pairs at a time, to bound the memory


class BoxTrees:
    """Groups of boxes, each group the leaves of a balanced tree.

    Args:
        low, high: corners of the boxes, (groups, boxes of a group, 3).
    """

    def __init__(self, low: Floats, high: Floats) -> None:
        groups, count, _ = low.shape
        leaves = 1 << max(count - 1, 0).bit_length()
        order = _tree_order((low + high) / 2, leaves)
        group = np.arange(groups)[:, None]
        filling = np.full((groups, leaves - count, 3), np.inf)  # boxes that intersect none
        self._place = (group * count + order).reshape(-1)
        low = np.concatenate([low, filling], axis=1)[group, order]
        high = np.concatenate([high, -filling], axis=1)[group, order]
        self._levels = [(low.reshape(-1, 3), high.reshape(-1, 3))]
        while len(self._levels[0][0]) > groups:
            below, above = self._levels[0]
            self._levels.insert(0, (below.reshape(-1, 2, 3).min(axis=1), above.reshape(-1, 2, 3).max(axis=1)))

    def meeting(self, first: Ints, second: Ints) -> Iterator[tuple[Ints, Ints]]:
        """Yield arrays of pairs ``i < j`` of boxes, numbered over all groups, that intersect.

        Args:
            first, second: the pairs of groups, ``first <= second``, whose boxes are compared.
        """
        waiting = [(0, *self._that_meet(0, first, second))]
        while waiting:
            level, a, b = waiting.pop()
            if level + 1 == len(self._levels):
                i, j = self._place[a[a != b]], self._place[b[a != b]]
                yield np.minimum(i, j), np.maximum(i, j)
                continue
            children = [self._that_meet(level + 1, 2 * a + i, 2 * b + j) for i, j in ((0, 0), (0, 1), (1, 0), (1, 1))]
            a, b = (np.concatenate(side) for side in zip(*children, strict=True))
            waiting += [(level + 1, a[s : s + _CHUNK], b[s : s + _CHUNK]) for s in range(0, len(a), _CHUNK)]

    def _that_meet(self, level: int, a: Ints, b: Ints) -> tuple[Ints, Ints]:
        """Return the pairs of nodes of one level with ``a <= b`` whose boxes intersect."""
        low, high = self._levels[level]
        once = a <= b  # the children of one node are compared with each other
        a, b = a[once], b[once]
        for axis in range(3):
            meet = (low[a, axis] <= high[b, axis]) & (low[b, axis] <= high[a, axis])
            a, b = a[meet], b[meet]
        return a, b


def _tree_order(centres: Floats, leaves: int) -> Ints:
    """Return the order of each group's boxes as leaves of its tree; nodes are bisected across their longest side."""
    groups, count, _ = centres.shape
    centres = np.concatenate([centres, np.repeat(centres[:, -1:], leaves - count, axis=1)], axis=1)
    order, group = np.tile(np.arange(leaves), (groups, 1)), np.arange(groups)
    while order.shape[1] > 1:
        here = centres[group[:, None], order]
        axis = (here.max(axis=1) - here.min(axis=1)).argmax(axis=1)
        along = np.take_along_axis(here, axis[:, None, None], axis=2)[..., 0]
        order = np.take_along_axis(order, along.argsort(axis=1), axis=1).reshape(2 * len(order), -1)
        group = group.repeat(2)
    return order.reshape(groups, leaves)
