"""Displacements that are the same at all nodes of a region, but for rounding errors."""

from __future__ import annotations

import numpy as np

from hpcinv.mesh.source import Floats

_SAME = 1e-9
"""Differences of displacements over the largest that are rounding errors; raised, a small rotation would be lost"""


def is_uniform(values: Floats) -> bool:
    """Return whether displacements (n,) are the same."""
    return bool(np.ptp(values) <= _SAME * np.abs(values).max())
