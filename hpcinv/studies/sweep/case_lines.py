"""Straight lines through the numbers of cases that hold many of them, such as the axes of a grid.

Lines are found by their directions, which many lines of a plan share: those from a few cases to all others. The cases
of all lines of a direction are then found at once.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hpcinv.mesh.source import Floats, Ints
from hpcinv.studies.sweep.neighbours import is_equal

_DIGITS = 9  # of unit vectors and places: directions and lines that agree to them are the same
_FIRST = 8  # cases whose directions to all others are looked at. Raised, irregular plans have lines more often
_MOST = 12  # directions that are kept, those with the longest lines. Raised, planning takes longer


class CaseLines:
    """Lines through some cases.

    Args:
        numbers: numbers of the cases, (n, numbers); n is at least 1.
        least: cases that a line has at least.
    """

    def __init__(self, numbers: Floats, least: int) -> None:
        varies = ~is_equal(numbers.min(axis=0), numbers.max(axis=0))
        self._numbers, self._least = numbers[:, varies] / np.ptp(numbers[:, varies], axis=0), least
        # A number for each vector: vectors that differ have different ones, but for a chance of 1e-9.
        self._mixture = np.sqrt(2.0 + np.arange(self._numbers.shape[1]))
        ways = self._ways() if len(numbers) >= least and varies.any() else []
        self._groups = [_Groups(self._places_beside(way)) for way in ways]

    def through(self, case: int) -> Iterator[Ints]:
        """Yield the cases of each line through a case, in the order of their numbers; the line has the case, too."""
        for groups in self._groups:
            line = groups.members_with(case)
            if len(line) >= self._least:
                yield line

    def _ways(self) -> list[Floats]:
        """Return unit vectors along lines, the longest ones first."""
        count = len(self._numbers)
        found: dict[float, tuple[int, Floats]] = {}
        for case in np.unique(np.linspace(0, count - 1, _FIRST).astype(int)):
            ways = self._numbers - self._numbers[case]
            lengths = np.linalg.norm(ways, axis=1)
            ways = ways[lengths > 0] / lengths[lengths > 0, None]
            # The largest component is positive, of two almost equal ones the first.
            leading = (np.abs(ways) > 0.999 * np.abs(ways).max(axis=1, keepdims=True, initial=0.0)).argmax(axis=1)
            ways *= np.sign(np.take_along_axis(ways, leading[:, None], axis=1))
            keys, rows, counts = np.unique(self._labels(ways), return_index=True, return_counts=True)
            for place in np.flatnonzero(counts + 1 >= self._least):
                known = found.get(keys[place], (0, ways[0]))[0]
                found[keys[place]] = max(known, int(counts[place])), ways[rows[place]]
        longest = sorted(found.values(), key=lambda entry: (-entry[0], *np.round(entry[1], _DIGITS)))
        return [way for _, way in longest[:_MOST]]

    def _labels(self, vectors: Floats) -> Floats:
        return np.asarray(np.round(vectors @ self._mixture, _DIGITS) + 0.0)

    def _places_beside(self, way: Floats) -> Floats:
        """Return a number of each case that is equal for cases on one line in this direction."""
        return self._labels(self._numbers - (self._numbers @ way)[:, None] * way)


class _Groups:
    """Cases grouped by a label."""

    def __init__(self, labels: Floats) -> None:
        _, self._label, counts = np.unique(labels, return_inverse=True, return_counts=True)
        self._members = np.argsort(self._label, kind="stable")
        self._ends = np.cumsum(counts)

    def members_with(self, case: int) -> Ints:
        """Return the cases with the label of a case, in order."""
        label = self._label[case]
        return self._members[(self._ends[label - 1] if label else 0) : self._ends[label]]
