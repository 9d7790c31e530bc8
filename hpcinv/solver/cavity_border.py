"""Pressures of cavities as unknown numbers: the equilibrium is linear in them."""

from collections.abc import Sequence

import numpy as np
from petsc4py import PETSc

from hpcinv.base.parallel.petsc_vectors import dot
from hpcinv.mesh.source import Floats
from hpcinv.model.assembly.system import System
from hpcinv.model.cavities import CavityEquation
from hpcinv.solver.border import Border


class CavityBorder(Border):
    """The pressures of all cavities of unknown pressure, with their equations."""

    least = 1e-15  # volumes are known to some units of the last digit; raised, smaller changes of volumes are ignored
    least_load = 1e-9  # forces of pressures are in proportion to the load factor; raised, paths begin off equilibrium

    def __init__(self, system: System, cavities: Sequence[CavityEquation]) -> None:
        self._system, self._cavities, self.count = system, cavities, len(cavities)
        self._first: Floats | None = None  # C at full load where a path from another state begins
        self._rows = [system.position() for _ in cavities]

    def put(self, load: float) -> None:
        for cavity in self._cavities:
            cavity.set_pressure(cavity.pressure, self._factor)

    @property
    def _factor(self) -> float:
        """Present load factor of the pressures, which belong to the first load case."""
        return float(self._system.weak_form.parameters.constant.value[0])

    def kept_numbers(self) -> Floats:
        return np.array([cavity.pressure for cavity in self._cavities])

    def restore(self, numbers: Floats) -> None:
        for cavity, pressure in zip(self._cavities, numbers, strict=True):
            cavity.pressure = float(pressure)

    def change(self, change: Floats) -> None:
        self.restore(self.kept_numbers() + change)

    def begin_path(self) -> None:
        self._first = self.equations(1.0)

    def equations(self, load: float) -> Floats:
        if self._first is not None:
            return self._values(1.0) - (1 - load) * self._first
        return self._values(load)

    def _values(self, load: float) -> Floats:
        return np.array([cavity.evaluate(load)[0] for cavity in self._cavities])

    def set_columns(self, columns: Sequence[PETSc.Vec], r: PETSc.Vec, load: float) -> None:
        # Differences of unit pressures are exact.
        for column, cavity in zip(columns, self._cavities, strict=True):
            pressure = cavity.pressure
            cavity.set_pressure(pressure + 1.0, self._factor)
            self._system.residual(column)
            column.axpy(-1.0, r)
            cavity.set_pressure(pressure, self._factor)

    def linearise(self, load: float) -> Floats:
        by_pressure = []
        for row, cavity in zip(self._rows, self._cavities, strict=True):
            _, by_volume, slope = cavity.evaluate(load if self._first is None else 1.0)
            by_pressure.append(slope)
            cavity.slope(row)
            row.scale(by_volume)
        return np.diag(by_pressure)

    def slopes(self, direction: PETSc.Vec) -> Floats:
        return np.array([dot(row, direction) for row in self._rows])

    def recover(self, load: float) -> None:
        system = self._system  # the state has them implicitly
        self.restore(np.zeros(self.count))
        self.put(load)
        r, columns = system.position(), [system.position() for _ in self._cavities]
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
