"""Quantities of interest between all contact tractions that a given shape admits.

A linear program gives the tractions at an end; a solve with these shows the quantity there, and the next program begins
there, until it has settled (`hpcinv.trust.intervals.pressed_bodies`, `hpcinv.trust.intervals.admissible_tractions`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import combinations

import numpy as np

from hpcinv.base.parallel.runtime import MPI
from hpcinv.mesh.source import Floats
from hpcinv.results.solution import Solution
from hpcinv.solver.equations import Equations
from hpcinv.trust.intervals.admissible_tractions import (
    AdmissibleTractions,
    NoPressure,
    UnboundedEnd,
    settled_end,
)
from hpcinv.trust.intervals.pressed_bodies import Pressed, PressedBodies
from hpcinv.trust.intervals.shape_width import ShapeWidth, shape_width

_SETTLED = 1e-5
"""Change of a quantity that one more program may promise at an end that has settled, relative to its value or
distance. Lowered, ends take more solves."""
_DEPTH = 1e-6  # overlap in lengths of the body that is tolerated there
_PLANES = 12
"""Planes that are added to each friction cone during the search for one end. Raised, programs take longer; lowered,
ends at which tractions turn do not settle."""


@dataclass(frozen=True)
class Interval:
    """Ends of one quantity, in SI; ``None`` for an end that does not exist.

    Attributes:
        value: at the solution.
        unit: SI unit, empty if it has none.
        remedies: keys of 'known' that would bound an end that does not exist.
        has_settled: whether one more linear program would not move either end.
        solves: solves with other pressures.
    """

    name: str
    value: float
    low: float | None
    high: float | None
    unit: str
    remedies: tuple[str, ...]
    has_settled: bool
    solves: int


@dataclass(frozen=True)
class ContactIntervals:
    """Intervals of a job's quantities, and of force and mean rest gap of its interfaces.

    Attributes:
        distance: largest distance (m) between two unloaded shapes at ends, a lower bound of what is undetermined.
        overlap: depth (m) to which the unloaded bodies overlap for every pressure, 0 if what is known excludes all;
            ``None`` where some are admissible.
        friction: least factor of the friction coefficients that holds all parts, where the given ones do not; ``inf``
            if none does.
        count: number of pressures and tangential tractions.
        fine: number of pressures that the ones among them stand for in a coarse field; else 0.
        excess: distance (m) by which bodies that do not overlap miss a known rest surface at least; 0 if that is not
            the reason why none are admissible.
        width: of the positions of all nodes.
        is_locked: whether tractions within the friction cone balance each other, however large.
    """

    intervals: tuple[Interval, ...]
    distance: float
    overlap: float | None
    friction: float | None
    count: int
    fine: int
    excess: float
    width: ShapeWidth | None
    is_locked: bool


def contact_intervals(
    equations: Equations, solution: Solution, announce: Callable[[str], None] = lambda _: None
) -> ContactIntervals:
    """Return the intervals of the scalar quantities of an inverse solution with contact; collective.

    It takes, for each end, some factorizations, each with a substitution for each pressure.

    Args:
        announce: called with what each solve takes, before the ends are searched.
    """
    bodies, fault, is_locked = PressedBodies(equations, solution, announce=announce), NoPressure(0.0), False
    found, is_empty, width = list[Interval](), False, None
    try:
        ends = _Ends(bodies, equations)
        for name in reversed(bodies.units):  # force and gap first, whose ends are where others begin
            found.insert(0, ends.interval(name))
        width = shape_width(bodies.at_start.near, bodies.moves, equations.scales.length, announce)
        if any(end is None for interval in found for end in (interval.low, interval.high)):
            is_locked = bodies.at_start.near.is_locked
    except NoPressure as reason:
        fault, is_empty = reason, True
    finally:
        bodies.destroy()
        equations.put(solution)
    overlap = -fault.gap * equations.scales.length if is_empty else None
    more = bodies.count, bodies.fine, fault.excess * equations.scales.length, width, is_locked
    return ContactIntervals(tuple(found), ends.distance, overlap, fault.friction, *more)


class _Ends:
    """Search of ends; methods are collective."""

    def __init__(self, bodies: PressedBodies, equations: Equations) -> None:
        self._bodies, self._comm = bodies, equations.body.mesh.comm
        self._depth = _DEPTH * equations.body.length
        self._shapes, self._solved_bodies = list[Floats](), [bodies.at_start]
        self._directions = [list[Floats]() for _ in bodies.at_start.near.cones]

    @property
    def distance(self) -> float:
        """Largest distance (m) of a node in two of the shapes that were found."""
        largest = max(
            (float(np.linalg.norm(a - b, axis=1).max(initial=0.0)) for a, b in combinations(self._shapes, 2)),
            default=0.0,
        )
        return float(self._comm.allreduce(largest, op=MPI.MAX))

    def interval(self, name: str) -> Interval:
        """Return the interval of a quantity; raise `NoPressure` if no pressures are admissible."""
        bodies = self._bodies
        first, ends, settled = bodies.at_start.values[name], list[float | None](), True
        before, remedies = len(self._solved_bodies), list[frozenset[str]]()
        tolerance = _SETTLED * max(abs(first), self._promised(name), 1e-300)
        for sign in (-1.0, 1.0):
            for further in self._directions:
                further.clear()
            solve, choose = partial(self._solved, name), partial(self._chosen, sign)
            try:
                end = settled_end(solve, choose, self._best(name, sign), tolerance, self._depth)
            except UnboundedEnd:
                ends.append(None)
                remedies.append(self._bounding(name, sign))
                continue
            ends.append(self._farthest(name, sign, end[0]))
            settled &= end[2]
            self._shapes.append(self._last_shape)
        solves, value = len(self._solved_bodies) - before, bodies.computed.get(name, first)
        common = tuple(sorted(frozenset.intersection(*remedies))) if remedies else ()
        return Interval(name, value, ends[0], ends[1], bodies.units[name], common, settled, solves)

    def _bounding(self, name: str, sign: float) -> frozenset[str]:
        """Return the keys of 'known' with which the first program has an end, whatever their value; collective."""
        start = self._bodies.at_start
        areas = [slopes for key, slopes in start.slopes.items() if key.startswith("force on ")]
        found = start.near.bounding(start.slopes[name], sign, areas) if self._comm.rank == 0 else None
        keys: frozenset[str] = self._comm.bcast(found)
        return keys

    def _best(self, name: str, sign: float) -> Floats:
        """Return the numbers with the largest or smallest quantity of all that were solved for.

        Ends are local ones: an energy has its largest value in a corner far from where it is least.
        """
        bodies = self._admissible or self._solved_bodies[:1]
        return max(bodies, key=lambda body: sign * body.values[name]).near.values

    @property
    def _admissible(self) -> list[Pressed]:
        return [body for body in self._solved_bodies if body.near.depth <= self._depth]

    def _farthest(self, name: str, sign: float, end: float) -> float:
        """Return an end, or the value of an admissible body beyond it: an end that has not settled may lie inside."""
        return sign * max([sign * end, *(sign * body.values[name] for body in self._admissible)])

    def _promised(self, name: str) -> float:
        """Return the largest change of a quantity that the first programs promise."""
        start, largest = self._bodies.at_start, 0.0
        for sign in (-1.0, 1.0):
            try:
                change = self._chosen(sign, start.near, start.slopes[name], np.inf) - self._bodies.start
            except UnboundedEnd:
                continue
            largest = max(largest, abs(float(start.slopes[name] @ change)))
        return largest

    def _solved(self, name: str, values: Floats) -> tuple[float, AdmissibleTractions, Floats]:
        solved = next((body for body in self._solved_bodies if body.near.values is values), None)
        if solved is None:
            solved = self._bodies.solved(values)
            self._solved_bodies.append(solved)
        self._last_shape = solved.shape
        return solved.values[name], solved.near, solved.slopes[name]

    def _chosen(self, sign: float, near: AdmissibleTractions, slopes: Floats, reach: float) -> Floats:
        """Return the numbers at an end; collective."""
        for cone, further in zip(near.cones, self._directions, strict=True):
            further.append(cone.directions(near.values))
            del further[:-_PLANES]
        return near.common_end(self._comm, slopes, sign, reach, self._directions)
