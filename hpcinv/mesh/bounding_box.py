"""Bounding box of points that are distributed over the ranks."""

import numpy as np

from hpcinv.base.parallel.runtime import MPI
from hpcinv.mesh.source import Floats


def extent(comm: MPI.Intracomm, points: Floats) -> tuple[Floats, Floats]:
    """Smallest and largest coordinates of the points (n, 3) of all ranks, ∞ and -∞ if there are none; collective."""
    low, high = points.min(axis=0, initial=np.inf), points.max(axis=0, initial=-np.inf)
    comm.Allreduce(MPI.IN_PLACE, low, MPI.MIN)
    comm.Allreduce(MPI.IN_PLACE, high, MPI.MAX)
    return low, high


def diagonal(comm: MPI.Intracomm, points: Floats) -> float:
    """Length of the diagonal of the bounding box; collective."""
    low, high = extent(comm, points)
    return float(np.linalg.norm(high - low))
