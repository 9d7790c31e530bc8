"""Newton's method for equilibrium together with equations for unknown numbers of its loads or supports.

The equilibrium ``R(x, q) = 0`` has more unknowns q, such as pressures of cavities, and as many more equations
``C(x, q) = 0``. Each linearised system is solved by bordering (`hpcinv.solver.bordered_solver`).

The first correction is in proportion to the step in the load factor. It predicts rotations and strains, and the
step is shortened without another factorization. A quadratic extrapolation of the path saves no factorizations.

It needs one back-substitution more for each number, with direct and iterative solvers and on any number of ranks. At a
limit point of the pressure of a cavity K is singular, while the whole system is not; steps do not end there but by
chance.
"""

from collections.abc import Callable, Sequence

import numpy as np

from hpcinv.model.outcome import Outcome
from hpcinv.parallel.petsc_vectors import norm
from hpcinv.solver.border import Border
from hpcinv.solver.bordered_solver import BorderedSolver
from hpcinv.solver.equilibrium import Equilibrium
from hpcinv.solver.newton import NewtonIteration, NewtonMonitor, Solve
from hpcinv.solver.predictor import Increment

type Shortened = Callable[[float, Increment], float]


class BorderedNewton:
    """Newton's method for a system and the equations of its borders; the state and their numbers are the iterate.

    Args:
        strategy: name of the solves in reports.
    """

    def __init__(self, equilibrium: Equilibrium, borders: Sequence[Border], strategy: str = "") -> None:
        self.equilibrium, self.borders, self._strategy = equilibrium, borders, strategy
        self._bordered = BorderedSolver(equilibrium, borders)
        self._r, self._d = (equilibrium.system.position() for _ in range(2))

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
        origin, numbers = system.position(), [border.kept_numbers() for border in self.borders]
        self._set(load)
        monitor = NewtonMonitor(
            tolerance,
            self.equilibrium.limit,
            self.equilibrium.reuse,
            inexact=linear.configuration.error,
            floor=self.equilibrium.floor(least=max(border.least for border in self.borders)),
        )
        with system.timings("newton"):
            outcome, factorizations, load = self._iterate(start, load, monitor, shortened)
        if outcome.accepted:
            outcome = system.fault() or system.fault_of_solution() or outcome
        if not outcome.accepted:
            system.set_state(origin)
            for border, kept in zip(self.borders, numbers, strict=True):
                border.restore(kept)
            self._set(load)
        origin.destroy()
        iterations = linear.take_iterations()
        history = tuple(monitor.history)
        return Solve(load, outcome, history, factorizations, strategy=self._strategy, linear_iterations=iterations)

    def _iterate(
        self, start: float, load: float, monitor: NewtonMonitor, shortened: Shortened
    ) -> tuple[Outcome, int, float]:
        """Correct the iterate until the monitor judges it; return its outcome, factorizations and load factor."""
        system, linear, borders = self.equilibrium.system, self.equilibrium.linear, self.borders
        ends = np.cumsum([border.count for border in borders])[:-1]
        factorizations, fault = 0, None
        x = system.position()
        system.residual(self._r)
        outcome: Outcome | None = None if np.isfinite(norm(self._r)) else Outcome.NOT_FINITE
        while outcome is None:
            if self.equilibrium.interrupted():
                outcome = Outcome.INTERRUPTED
                break
            fresh = monitor.needs_new_tangent
            if fresh:
                factorizations += 1
                if not self._bordered.linearise(load):
                    outcome = linear.failure
                    break
            values = np.concatenate([border.equations(load) for border in borders])
            try:
                change = self._bordered.solve(self._r, values, self._d)
            except np.linalg.LinAlgError:  # such as a pressure that moves no volume
                outcome = Outcome.LINEAR_SOLVER
                break
            if change is None:
                outcome = linear.failure
                break
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
            for border, part in zip(borders, np.split(share * change, ends), strict=True):
                border.change(part)
            self._set(load)
            system.residual(self._r)
            iteration = NewtonIteration(size, norm(x), norm(self._r), fresh)
            self.equilibrium.observer.iteration(iteration)
            outcome = monitor.judge(iteration)
        x.destroy()
        if outcome in (Outcome.ITERATION_LIMIT, Outcome.DIVERGED):
            outcome = fault or outcome
        return outcome, factorizations, load

    def _set(self, load: float) -> None:
        self.equilibrium.system.set_load(load)
        for border in self.borders:
            border.put(load)

    def destroy(self) -> None:
        """Free PETSc objects."""
        self._bordered.destroy()
        for vector in (self._r, self._d):
            vector.destroy()
