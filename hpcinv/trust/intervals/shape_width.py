"""Pointwise width of the unloaded shape between all contact tractions that a given shape admits, to first order.

A node moves by ``c · dz`` along an axis. Two linear programs give the ends of one such row ``c``. The rows of all nodes
are nearly combinations of a few, which pivoted orthogonalization chooses: programs for these are exact there, and the
tractions at their ends give a lower bound of the width everywhere else.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from dolfinx import fem

from hpcinv.base.parallel.runtime import MPI
from hpcinv.mesh.source import Floats
from hpcinv.trust.intervals.admissible_tractions import AdmissibleTractions, UnboundedEnd

_MOST = 40
"""Rows with programs of their own. Raised, the width is exact at more nodes, and takes longer."""
_SMALL = 1e-3
"""Rest of a row, relative to the largest row, below which it is a combination of the chosen ones. Lowered, more rows
have programs."""


@dataclass(frozen=True)
class ShapeWidth:
    """Half of the width (m) of the positions of nodes, the largest along x, y and z.

    Attributes:
        field: at the nodes of the displacement.
        largest, place: the largest half width (m), and the node (m) of the given mesh where it is.
        rows: number of rows with programs of their own.
        unbounded: whether some node has no end; then nothing else is known.
    """

    field: fem.Function
    largest: float
    place: tuple[float, ...]
    rows: int
    unbounded: bool


def shape_width(
    near: AdmissibleTractions, moves: Sequence[fem.Function], scale: float, announce: Callable[[str], None]
) -> ShapeWidth:
    """Return the pointwise width; collective.

    Args:
        moves: derivatives (m) of the displacement by each number.
        scale: length (m) of the unit of the mesh.
        announce: called with the price, when the first program has been measured.

    Raises:
        NoPressure: on all ranks, if no tractions are admissible.
    """
    space, comm = moves[0].function_space, moves[0].function_space.mesh.comm
    columns = np.array([move.x.array for move in moves]).T  # (unknowns, numbers)
    owned = space.dofmap.index_map.size_local * space.dofmap.index_map_bs
    low, high = np.full(len(columns), np.inf), np.full(len(columns), -np.inf)
    rows, unbounded = _chosen_rows(columns[:owned], comm), False
    started = time.perf_counter()
    try:
        for number, row in enumerate(rows):
            for sign in (-1.0, 1.0):
                changes = columns @ (near.common_end(comm, row, sign) - near.values)
                low, high = np.minimum(low, changes), np.maximum(high, changes)
            if number == 0:
                seconds = comm.allreduce(time.perf_counter() - started, op=MPI.MAX) * len(rows)
                announce(f"width of the shape: {2 * len(rows)} linear programs in {seconds:.2g} s")
    except UnboundedEnd:
        unbounded = True
    half = np.maximum(np.where(high >= low, high - low, 0.0) / 2, 0.0).reshape(-1, 3).max(axis=1)
    scalar = fem.functionspace(space.mesh, ("Lagrange", space.ufl_element().degree))
    field = fem.Function(scalar, name="contact half width")
    field.x.array[:] = half
    nodes = scalar.tabulate_dof_coordinates() * scale
    found = comm.allgather((float(half.max(initial=0.0)), tuple(nodes[half.argmax()].tolist()) if len(half) else ()))
    largest, place = max(found)
    return ShapeWidth(field, largest, place, len(rows), unbounded)


def _chosen_rows(columns: Floats, comm: MPI.Intracomm) -> list[Floats]:
    """Return rows of a matrix (rows of this rank, n), the same on all ranks; all rows nearly are combinations."""
    left, chosen, largest = columns.copy(), list[Floats](), 0.0
    for _ in range(_MOST):
        sizes = np.linalg.norm(left, axis=1)
        best = int(sizes.argmax()) if len(sizes) else -1
        own = (float(sizes[best]), columns[best], left[best]) if len(sizes) else (0.0, columns[:0], columns[:0])
        size, row, rest = max(comm.allgather(own), key=lambda found: found[0])
        largest = max(largest, size)
        if size <= _SMALL * largest or size == 0.0:
            break
        chosen.append(row)
        left -= np.outer(left @ rest, rest) / size**2
    return chosen
