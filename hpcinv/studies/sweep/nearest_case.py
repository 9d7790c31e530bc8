"""The nearest of those cases that are not done, of many cases: a tree of points, made anew as points leave it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from hpcinv.mesh.source import Floats

_FIRST = 16  # neighbours that are asked for at first


class NearestCase:
    """Search among the points of cases, (n, dimensions)."""

    def __init__(self, points: Floats) -> None:
        self._points = points if points.shape[1] else np.zeros((len(points), 1))
        self._plant(np.zeros(len(points), dtype=bool))

    def _plant(self, rows: npt.NDArray[np.bool_]) -> None:
        self._is_in_tree, self._rows = rows.copy(), np.flatnonzero(rows)
        self._tree = cKDTree(self._points[self._rows], balanced_tree=False, compact_nodes=False)

    def among(self, eligible: npt.NDArray[np.bool_], point: Floats) -> int | None:
        """Return the eligible case that is nearest to a point, about the first of equally near ones; ``None`` without.

        Args:
            eligible: (n,) whether a case may be the next one.
        """
        count = np.count_nonzero(eligible)
        if not count:
            return None
        if 2 * count < len(self._rows) or np.count_nonzero(eligible & self._is_in_tree) < count:
            self._plant(eligible)
        asked, place = _FIRST, point if len(point) else np.zeros(1)
        while True:
            distances, found = self._tree.query(place, k=np.arange(1, min(asked, len(self._rows)) + 1))
            rows = self._rows[found]
            if (is_there := eligible[rows]).any():
                return int(rows[is_there & (distances == distances[is_there].min())].min())
            asked *= 4
