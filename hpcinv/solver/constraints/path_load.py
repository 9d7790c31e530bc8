"""Load factor of a path that is followed by its length, with the plane in which the corrector seeks the next state.

    t·(x - x_predicted) = 0

Source: Riks, Int. J. Solids Struct. 15, 529-551, 1979, doi:10.1016/0020-7683(79)90081-7.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from petsc4py import PETSc

from hpcinv.base.parallel.petsc_vectors import dot
from hpcinv.job.job import Job
from hpcinv.mesh.source import Floats
from hpcinv.model.assembly.system import System
from hpcinv.model.constraint_report import ConstraintReport
from hpcinv.model.discrete_model import DiscreteModel
from hpcinv.solver.border import Border
from hpcinv.solver.bordered_solver import BorderedSolver


class PathLoad(Border):
    """The load factor, and the plane through the state where a solve begins that is normal to ``t``.

    Args:
        others: the other unknown numbers, whose equations depend on the load factor, too.
        cases: number of load cases; derivatives by the load factor jump at the end of each.

    Attributes:
        t: unit vector; ``None`` where only the tangent of the path is asked for.
        load: present load factor.
        direction: 1 or -1, direction of the load factor, which matters at the end of a load case.
        scale: change of the load factor that counts as much as one of the state by its norm.
    """

    count, order = 1, 3

    @classmethod
    def of_job(cls, job: Job, equations: DiscreteModel, system: System) -> Iterable[PathLoad]:
        return []  # the path adds it while it is followed by its length

    def __init__(self, system: System, others: BorderedSolver, cases: int) -> None:
        self._system, self._others, self._cases = system, others, cases
        self._others_by_load = np.zeros(others.count)
        self.load: float = 0.0
        self.direction, self.scale = 1, 1.0
        self.t: PETSc.Vec | None = None

    def reports(self, load: float) -> Sequence[ConstraintReport]:
        return []

    def put(self, load: float) -> None:
        """Nothing is left to do: the system has the load factor."""

    def kept_numbers(self) -> float:
        return self.load

    def restore(self, numbers: float) -> None:
        self.load = numbers

    def change(self, change: Floats) -> None:
        self.load += float(change[0])

    def recover(self, load: float) -> None:
        self.load = load

    def equations(self, load: float) -> Floats:
        return np.zeros(1)  # corrections stay in the plane

    def set_columns(self, columns: Sequence[PETSc.Vec], r: PETSc.Vec, load: float) -> None:
        """Set the column to a difference quotient; also note how the other equations change."""
        h, before, others = self._difference_step(load), self._others.equations(load), self._others
        others.put(load + h)
        self._system.residual(columns[0])
        self._others_by_load = (others.equations(load + h) - before) / h
        others.put(load)
        columns[0].axpy(-1.0, r)
        columns[0].scale(1 / h)

    def linearise(self, load: float) -> Floats:
        return np.zeros((1, 1))

    def others_by_numbers(self) -> Floats:
        return self._others_by_load[:, None]

    def slopes(self, direction: PETSc.Vec) -> Floats:
        return np.array([1.0 if self.t is None else dot(self.t, direction)])

    def size(self, change: Floats) -> float:
        return abs(float(change[0])) / self.scale

    def _difference_step(self, load: float) -> float:
        """Return a small change of the load factor towards the middle of the load case in this direction."""
        position = load * self._cases
        case = math.floor(position + self.direction * 1e-9)
        middle = min(max(case, 0), self._cases - 1) + 0.5
        return math.copysign(1e-3, middle - position) / self._cases
