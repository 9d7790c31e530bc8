"""Branches of loading in a test of several cycles."""

import numpy as np

from hpcinv.base.quantity.arrays import Floats

REVERSAL = 0.1
"""Share of the range of strain by which it must return to end a branch; raised, small cycles are not seen; lowered,
errors of the measurement count as cycles."""


def loading_branches(measure: Floats, rest_measure: float) -> list[tuple[int, int]]:
    """Return first and last point of each branch of loading: from where the strain begins to grow to its largest value.

    Args:
        measure: in the order of the test, (n,).
        rest_measure: its value in the undeformed state.
    """
    strain = np.abs(measure - rest_measure)
    threshold = REVERSAL * float(np.ptp(strain))
    branches: list[tuple[int, int]] = []
    low, high, is_loading = 0, 0, False
    for i, value in enumerate(strain):
        if is_loading:
            if value >= strain[high]:
                high = i
            elif value < strain[high] - threshold:
                branches.append((low, high))
                low, is_loading = i, False
        elif value <= strain[low]:
            low = i
        elif value > strain[low] + threshold:
            high, is_loading = i, True
    return [*branches, (low, high)] if is_loading else branches
