"""The bounding box of points that are spread over the ranks."""

from __future__ import annotations

import hpcinv.parallel.runtime  # noqa: F401  (its import order first)

# isort: split
import numpy as np
import numpy.typing as npt

from hpcinv.parallel.runtime import MPI

type Floats = npt.NDArray[np.float64]


def extent(comm: MPI.Intracomm, points: Floats) -> tuple[Floats, Floats]:
    """Least and greatest coordinates of the points (n, 3) of all ranks, ∞ and -∞ if there are none; collective."""
    low, high = points.min(axis=0, initial=np.inf), points.max(axis=0, initial=-np.inf)
    comm.Allreduce(MPI.IN_PLACE, low, MPI.MIN)
    comm.Allreduce(MPI.IN_PLACE, high, MPI.MAX)
    return low, high


def diagonal(comm: MPI.Intracomm, points: Floats) -> float:
    """Length of the bounding box's diagonal; collective."""
    low, high = extent(comm, points)
    return float(np.linalg.norm(high - low))
