"""Newton's method for equilibrium together with the equations of cavities whose pressures are unknown.

The equilibrium ``R(x, q) = 0`` is linear in the pressures q, and each of them has one more equation ``C(x, q) = 0``.
Bordering solves the linearised system with the factors of ``K = ∂R/∂x`` alone: with ``K d = R`` and ``K g = ∂R/∂q`` the
corrections are

    Δx = -d - g Δq,      (B g - ∂C/∂q) Δq = C - B d,      B = ∂C/∂x.

The first correction is in proportion to the step in the load factor. It predicts rotations and strains, and the
step is shortened without another factorization. A quadratic extrapolation of the path saves no factorizations.

It needs one back-substitution more for each cavity, with direct and iterative solvers and on any number of ranks. At a
limit point of the pressure K is singular, while the whole system is not; steps do not end there but by chance.

Source: Keller, *Lectures on Numerical Methods in Bifurcation Problems*, 1987 (bordering).
"""

from collections.abc import Callable, Sequence

import numpy as np

from hpcinv.mesh.source import Floats
from hpcinv.model.cavities import CavityEquation
from hpcinv.model.outcome import Outcome
from hpcinv.parallel.petsc_vectors import dot, norm
from hpcinv.solver.equilibrium import Equilibrium
from hpcinv.solver.newton import NewtonIteration, NewtonMonitor, Solve
from hpcinv.solver.predictor import Increment

type Shortened = Callable[[float, Increment], float]

STRATEGY = "cavities"
"""Strategy of the solves with unknown pressures of cavities."""


class CavityNewton:
    """Newton's method for a system and the equations of its cavities; the state and their pressures are the iterate.

    Args:
        cavities: equations of the cavities of unknown pressure.
    """

    def __init__(self, equilibrium: Equilibrium, cavities: Sequence[CavityEquation]) -> None:
        self.equilibrium, self.cavities = equilibrium, cavities
        position = equilibrium.system.position
        self._r, self._r_pressed, self._d = (position() for _ in range(3))
        self._columns, self._rows = [position() for _ in cavities], [position() for _ in cavities]

    def solve(
        self, load: float, tolerance: float, *, start: float = 0.0, shortened: Shortened = lambda step, _: step
    ) -> Solve:
        """Solve at a load factor above 0 from the present iterate, which is unchanged if it is not accepted.

        Args:
            tolerance: estimated error of the state relative to its norm.
            start: load factor of the present iterate.
            shortened: length of a step in the load factor with this increment of its linear prediction, which is the
                first correction. The solve ends at the load factor after that step.
        """
        system, linear = self.equilibrium.system, self.equilibrium.linear
        origin, pressures = system.position(), self.pressures
        self._set(load, pressures)
        monitor = NewtonMonitor(
            tolerance,
            self.equilibrium.limit,
            self.equilibrium.reuse,
            inexact=linear.configuration.error,
            floor=self.equilibrium.floor(),
        )
        with system.timings("newton"):
            outcome, factorizations, load = self._iterate(start, load, monitor, shortened)
        if outcome.accepted:
            outcome = system.fault() or system.fault_of_solution() or outcome
        if not outcome.accepted:
            system.set_state(origin)
            self._set(load, pressures)
        origin.destroy()
        iterations = linear.take_iterations()
        history = tuple(monitor.history)
        return Solve(load, outcome, history, factorizations, strategy=STRATEGY, linear_iterations=iterations)

    @property
    def pressures(self) -> Floats:
        """The unknown pressures, scaled."""
        return np.array([cavity.pressure for cavity in self.cavities])

    def recover_pressures(self, load: float) -> None:
        """Set the pressures that balance the present state, an equilibrium at this load factor, such as a checkpoint.

        The state has them implicitly, since R is linear in them.
        """
        self._set(load, np.zeros(len(self.cavities)))
        self._columns_of_pressures(load)
        columns = self._columns
        gram = np.array([[dot(a, b) for b in columns] for a in columns])
        self._set(load, np.linalg.solve(gram, np.array([-dot(a, self._r) for a in columns])))

    def _iterate(
        self, start: float, load: float, monitor: NewtonMonitor, shortened: Shortened
    ) -> tuple[Outcome, int, float]:
        """Correct the iterate until the monitor judges it; return its outcome, factorizations and load factor."""
        system, linear, count = self.equilibrium.system, self.equilibrium.linear, len(self.cavities)
        bordered, factorizations, fault = np.zeros((count, count)), 0, None
        x = system.position()
        system.residual(self._r)
        outcome: Outcome | None = None if np.isfinite(norm(self._r)) else Outcome.NOT_FINITE
        while outcome is None:
            if self.equilibrium.interrupted():
                outcome = Outcome.INTERRUPTED
                break
            values = [cavity.evaluate(load) for cavity in self.cavities]
            fresh = monitor.needs_new_tangent
            if fresh:
                factorizations += 1
                if not self._linearise(load):
                    outcome = linear.failure
                    break
                for row, cavity, (_, by_volume, _) in zip(self._rows, self.cavities, values, strict=True):
                    cavity.slope(row)
                    row.scale(by_volume)
                bordered = np.array([[dot(row, column) for column in self._columns] for row in self._rows])
                bordered -= np.diag([by_pressure for *_, by_pressure in values])
            if not linear.solve(self._r, self._d):
                outcome = linear.failure
                break
            wanted = [value - dot(row, self._d) for (value, *_), row in zip(values, self._rows, strict=True)]
            try:
                change = np.linalg.solve(bordered, wanted)
            except np.linalg.LinAlgError:  # the pressure moves no volume
                outcome = Outcome.LINEAR_SOLVER
                break
            for column, dq in zip(self._columns, change, strict=True):
                self._d.axpy(float(dq), column)
            if fresh:
                increment = self.equilibrium.predictor.increments(self._d)
                if monitor.is_too_large(increment):
                    outcome = Outcome.DIVERGED
                    break
                if not monitor.history and (step := shortened(load - start, increment)) < load - start:
                    # The first correction is in proportion to the step, as loads and volumes are.
                    share = step / (load - start)
                    self._d.scale(share)
                    change, load = share * change, start + step
            size = norm(self._d)
            share, fault = system.admissible_share(x, self._d)
            x.axpy(-share, self._d)
            system.set_state(x)
            self._set(load, self.pressures + share * change)
            system.residual(self._r)
            iteration = NewtonIteration(size, norm(x), norm(self._r), fresh)
            self.equilibrium.observer.iteration(iteration)
            outcome = monitor.judge(iteration)
        x.destroy()
        if outcome in (Outcome.ITERATION_LIMIT, Outcome.DIVERGED):
            outcome = fault or outcome
        return outcome, factorizations, load

    def _linearise(self, load: float) -> bool:
        """Factorize K and solve for the columns ``g``; leave R of the iterate in ``_r``."""
        system, linear = self.equilibrium.system, self.equilibrium.linear
        self._columns_of_pressures(load)
        system.tangent()
        for column in self._columns:
            column.copy(self._r_pressed)
            if not linear.solve(self._r_pressed, column):
                return False
        return True

    def _columns_of_pressures(self, load: float) -> None:
        """Set ``_r`` to R, and the columns to ∂R/∂q: differences of unit pressures are exact."""
        system, pressures = self.equilibrium.system, self.pressures
        system.residual(self._r)
        for number, column in enumerate(self._columns):
            pressed = pressures.copy()
            pressed[number] += 1.0
            self._set(load, pressed)
            system.residual(column)
            column.axpy(-1.0, self._r)
        self._set(load, pressures)

    def _set(self, load: float, pressures: Floats) -> None:
        self.equilibrium.system.set_load(load)
        for cavity, pressure in zip(self.cavities, pressures, strict=True):
            cavity.set_pressure(float(pressure), load)

    def destroy(self) -> None:
        """Free PETSc objects."""
        for vector in (self._r, self._r_pressed, self._d, *self._columns, *self._rows):
            vector.destroy()
