"""Unknown numbers of loads, such as pressures of cavities: the equilibrium is linear in them."""

from collections.abc import Iterable, Sequence
from typing import Protocol

import numpy as np
from petsc4py import PETSc

from hpcinv.base.parallel.petsc_vectors import dot
from hpcinv.mesh.source import Floats
from hpcinv.model.assembly.system import System
from hpcinv.model.constraint_report import ConstraintReport
from hpcinv.solver.border import Border


class LoadEquation(Protocol):
    """The equation ``C(x, q, λ) = 0`` for one number ``q``, scaled.

    Attributes:
        number: q.
        unit: SI value of a scaled unit of it.
    """

    number: float
    unit: float

    def numbers(self) -> Iterable[tuple[int, str, float]]:
        """Return the quantities that have the number at the present load factor, as `System.set_numbers` takes them."""

    def value(self, load: float) -> float:
        """Return C at the present state."""

    def linearise(self, load: float, b: PETSc.Vec) -> float:
        """Set ``b`` to the derivative of C by the state, and return the derivative by the number."""

    def report(self, load: float) -> ConstraintReport:
        """Return the report of the present state."""


class LoadNumbers[E: LoadEquation](Border):
    """Unknown numbers of loads, with an equation for each."""

    least = 1e-15  # C is known to some units of the last digit; raised, smaller changes of it are ignored
    least_load = 1e-9  # forces of pressures are in proportion to the load factor; raised, paths begin off equilibrium

    def __init__(self, system: System, loads: Sequence[E]) -> None:
        self._system, self.loads, self.count = system, loads, len(loads)
        self._first: Floats | None = None  # C at full load where a path from another state begins
        self._rows = [system.position() for _ in loads]

    def put(self, load: float) -> None:
        for entry in self.loads:
            self._system.set_numbers(entry.numbers())

    @property
    def units(self) -> Floats:
        return np.array([entry.unit for entry in self.loads])

    def reports(self, load: float) -> Sequence[ConstraintReport]:
        return [entry.report(load) for entry in self.loads]

    def kept_numbers(self) -> Floats:
        return np.array([entry.number for entry in self.loads])

    def restore(self, numbers: Floats) -> None:
        for entry, number in zip(self.loads, numbers, strict=True):
            entry.number = float(number)

    def change(self, change: Floats) -> None:
        self.restore(self.kept_numbers() + change)

    def begin_path(self) -> None:
        self._first = self.equations(1.0)

    def equations(self, load: float) -> Floats:
        if self._first is not None:
            return self._values(1.0) - (1 - load) * self._first
        return self._values(load)

    def _values(self, load: float) -> Floats:
        return np.array([entry.value(load) for entry in self.loads])

    def set_columns(self, columns: Sequence[PETSc.Vec], r: PETSc.Vec, load: float) -> None:
        # Differences of unit numbers are exact.
        for column, entry in zip(columns, self.loads, strict=True):
            number = entry.number
            entry.number = number + 1.0
            self._system.set_numbers(entry.numbers())
            self._system.residual(column)
            column.axpy(-1.0, r)
            entry.number = number
            self._system.set_numbers(entry.numbers())

    def linearise(self, load: float) -> Floats:
        load = load if self._first is None else 1.0
        return np.diag([entry.linearise(load, row) for row, entry in zip(self._rows, self.loads, strict=True)])

    def slopes(self, direction: PETSc.Vec) -> Floats:
        return np.array([dot(row, direction) for row in self._rows])

    def recover(self, load: float) -> None:
        system = self._system  # the state has them implicitly
        self.restore(np.zeros(self.count))
        self.put(load)
        r, columns = system.position(), [system.position() for _ in self.loads]
        system.residual(r)
        self.set_columns(columns, r, load)
        gram = np.array([[dot(a, b) for b in columns] for a in columns])
        self.restore(np.linalg.solve(gram, np.array([-dot(a, r) for a in columns])))
        self.put(load)
        for vector in (r, *columns):
            vector.destroy()

    def destroy(self) -> None:
        for row in self._rows:
            row.destroy()
