"""Derivatives of an interface that has settled, with surfaces that move: differences, many nodes at a time.

Where multipliers ``m`` have settled, ``m = Λ(u, m)`` with the tractions ``Λ``, whose jumps are searched for in the
state ``u``. Forces and the errors of the multipliers,

    F(u, m) = -B(u)ᵀ Λ(u, m),      r(u, m) = (Λ(u, m) - m) / ε,

have derivatives that follow the overlaps of the facets, their normals, and the points that lie opposite to each other.
Nodes that share no function, directly or by a neighbour, change different numbers, so that one difference serves many.
What presses, sticks and slides stays so: penalties are so low that no difference changes it.

Source: Curtis, Powell & Reid (1974), doi:10.1093/imamat/13.1.117.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial

import numpy as np
import scipy.sparse as sparse

from hpcinv.mesh.source import Floats, Ints
from hpcinv.model.interfaces.pair import SurfacePair

_STEP = 2.0**-22
"""Step of a node, in lengths of the body. Raised, curvature counts; lowered, rounding."""
_MULTIPLIER_STEP = 2.0**-26  # by the largest multiplier
_SHARE = 2.0**-8
"""Penalties by the ones of the solve. Raised, steps change what presses; lowered, rounding errors of slips grow."""

type Numbers = tuple[Floats, Floats]
"""forces on the owned unknowns, and errors of all multipliers"""


@dataclass(frozen=True)
class Rates:
    """Derivatives as entries of this rank, whose sums over all ranks count.

    Attributes:
        count: number of multipliers.
        rows, columns: global numbers of unknowns; multipliers follow them, from ``size`` on.
    """

    count: int
    rows: Ints
    columns: Ints
    values: Floats


class _Entries:
    """Entries of differences, of this rank."""

    def __init__(self, pair: SurfacePair, first: int, size: int) -> None:
        depends, self.nodes = pair.incidence()
        count = int(pair.multiplier_places[0].max(initial=-1)) + 1
        entries = np.ones(len(depends)), (depends[:, 0], depends[:, 1])
        self.by_node = sparse.csr_array(entries, shape=(count, len(self.nodes)))
        self.neighbours = (self.by_node.T @ self.by_node).tocsc()
        self._owners, self.slots = pair.multiplier_places
        self._first, self._size = first, size
        self._is_root = pair.comm.rank == 0
        self._found = list[tuple[Ints, Ints, Floats]]()

    def add(self, column: int, nodes: Ints, functions: Ints, change: Numbers) -> None:
        """Add the part of a difference at some nodes and functions, as a column."""
        forces, errors = change
        rows = self.nodes[nodes].ravel() - self._first
        rows = rows[(rows >= 0) & (rows < len(forces))]
        self._append(rows + self._first, column, forces[rows])
        if self._is_root:
            places = np.flatnonzero(np.isin(self._owners, functions))
            self._append(self._size + places, column, errors[places])

    def _append(self, rows: Ints, column: int, values: Floats) -> None:
        self._found.append((rows, np.full(len(rows), column), values))

    def multipliers_of(self, functions: Ints, slot: int) -> Ints:
        """Return the numbers of one multiplier of each function."""
        return np.flatnonzero(np.isin(self._owners, functions) & (self.slots == slot))

    def owner(self, multiplier: int) -> int:
        return int(self._owners[multiplier])

    def rates(self) -> Rates:
        rows, columns, values = (np.concatenate(part) for part in zip(*self._found, strict=True))
        return Rates(len(self._owners), rows, columns, values)


def settled_rates(pair: SurfacePair, move: Callable[[Ints, float], None], first: int, size: int) -> Rates:
    """Return the derivatives of forces and errors by unknowns and multipliers at the present state; collective.

    Args:
        move: moves unknowns of global numbers by a distance (scaled).
        first: number of the first owned unknown; size: number of all unknowns.
    """
    entries = _Entries(pair, first, size)
    functions_of = entries.by_node.tocsc()
    nodes_of = entries.by_node.tocsr()
    step = _STEP * pair.body_length
    with _softened(pair):
        for group in _groups(entries.neighbours @ entries.neighbours):
            for axis in range(3):
                numbers = entries.nodes[group, axis]
                change = _difference(partial(_moved, pair, move, numbers), step)
                for node, number in zip(group, numbers, strict=True):
                    functions = functions_of.indices[functions_of.indptr[node] : functions_of.indptr[node + 1]]
                    near = entries.neighbours
                    entries.add(int(number), near.indices[near.indptr[node] : near.indptr[node + 1]], functions, change)
        given = pair.multipliers
        step = _MULTIPLIER_STEP * float(np.abs(given).max(initial=0.0)) or 1.0
        for group in _groups(entries.by_node @ entries.by_node.T):
            for slot in np.unique(entries.slots):
                places = entries.multipliers_of(group, int(slot))
                change = _difference(partial(_changed, pair, given, places), step)
                for place in places:
                    function = entries.owner(int(place))
                    near = nodes_of.indices[nodes_of.indptr[function] : nodes_of.indptr[function + 1]]
                    entries.add(size + int(place), near, np.array([function]), change)
        pair.put_multipliers(given)
    return entries.rates()


def _moved(pair: SurfacePair, move: Callable[[Ints, float], None], numbers: Ints, distance: float) -> Numbers:
    move(numbers, distance)
    pair.locate()
    found = pair.settling()
    move(numbers, -distance)
    return found


def _changed(pair: SurfacePair, given: Floats, places: Ints, change: float) -> Numbers:
    values = given.copy()
    values[places] += change
    pair.put_multipliers(values)
    return pair.settling()


def _difference(values: Callable[[float], Numbers], step: float) -> Numbers:
    ahead, behind = values(step), values(-step)
    return (ahead[0] - behind[0]) / (2 * step), (ahead[1] - behind[1]) / (2 * step)


@contextmanager
def _softened(pair: SurfacePair) -> Iterator[None]:
    """Context with lower penalties; the present state has not changed at its end."""
    pair.scale_penalties(_SHARE)
    try:
        yield
    finally:
        pair.scale_penalties(1 / _SHARE)


def _groups(conflicts: sparse.sparray) -> list[Ints]:
    """Return groups of numbers; no two numbers of a group have an entry in common."""
    table = conflicts.tocsr()
    colours = np.full(table.shape[0], -1)
    for number in range(len(colours)):
        taken = set(colours[table.indices[table.indptr[number] : table.indptr[number + 1]]].tolist())
        colours[number] = next(colour for colour in range(len(colours)) if colour not in taken)
    return [np.flatnonzero(colours == colour) for colour in range(int(colours.max(initial=-1)) + 1)]
