"""Equilibrium of a scene at one load factor: PETSc SNES with a line search on the assembled residual and tangent."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import hpcinv.runtime  # noqa: F401  (its import order first)

# isort: split
import numpy as np
from petsc4py import PETSc

from hpcinv.linearsystem import LinearSystem
from hpcinv.newton import NewtonIteration, NewtonMonitor, Outcome
from hpcinv.petsc_options import SolverOptions, Value
from hpcinv.runtime import MPI
from hpcinv.vectors import norm

if TYPE_CHECKING:
    from hpcinv.scene import Scene
    from hpcinv.supports import Supports
    from hpcinv.timings import Timings

_GIVEN_UP = -7  # SNES_DIVERGED_INNER: what PETSc is told when NewtonMonitor gives up
_DONE = 4  # SNES_CONVERGED_SNORM_RELATIVE

_OUTCOMES_BY_REASON: dict[int, Outcome] = {
    PETSc.SNES.ConvergedReason.DIVERGED_LINEAR_SOLVE: Outcome.LINEAR_SOLVER,
    PETSc.SNES.ConvergedReason.DIVERGED_LINE_SEARCH: Outcome.LINE_SEARCH,
    PETSc.SNES.ConvergedReason.DIVERGED_FUNCTION_NANORINF: Outcome.NOT_FINITE,
    PETSc.SNES.ConvergedReason.DIVERGED_FUNCTION_DOMAIN: Outcome.INVERTED,
    PETSc.SNES.ConvergedReason.DIVERGED_MAX_IT: Outcome.ITERATION_LIMIT,
}


@dataclass(frozen=True)
class Solve:
    """What one solve at a fixed load factor did; ``iterations`` is empty if a test of the user's options ended it.

    ``signs`` are those of the determinants of its tangents (empty if the linear solver does not tell them): the number
    of negative eigenvalues has changed by an odd number where it changes. ``gap`` is the distance of the loaded body
    from the given one (m) after a step of a fixed-point method. ``strategy`` is what it was a part of; at a
    ``turning_point`` the load is an extremum along the path.
    """

    load: float
    outcome: Outcome
    iterations: tuple[NewtonIteration, ...]
    factorizations: int
    signs: tuple[int, ...] = ()
    gap: float | None = None
    strategy: str = "load steps"
    turning_point: bool = False


class Equilibrium(LinearSystem):
    """Newton's method for the discrete equations of one scene.

    The tangent is kept while corrections contract (Shamanskii); the matrix is then left untouched, so that PETSc keeps
    its factors too, and its symbolic analysis serves the whole run. A correction that would turn an element inside out,
    or strain it beyond what its law is defined for, is halved before the line search sees it.

    Args:
        scene: residual and load factor.
        supports: Dirichlet conditions on the scene's unknowns.
        options: PETSc options of the job, beside the defaults.
        limit: Newton iterations after which a solve is given up.
        reuse: largest contraction at which the tangent is kept, 0 for full Newton.
        stop_asked: whether a signal asks to stop; all ranks are asked before each iteration.
    """

    def __init__(
        self,
        scene: Scene,
        supports: Supports,
        timings: Timings,
        *,
        options: Mapping[str, Value],
        limit: int = 30,
        reuse: float = 0.3,
        stop_asked: Callable[[], bool] = lambda: False,
    ) -> None:
        super().__init__(scene, supports, timings, options)
        self.limit, self.reuse, self.stop_asked = limit, reuse, stop_asked
        with timings("set-up"):
            # SNES iterates on a vector of its own: the state moves along with every trial of the line search.
            self._x, self._before = self.rhs.duplicate(), self.rhs.duplicate()
            self.snes = self._create_snes()
        self._monitor = self._new_monitor(1.0)
        self._fresh, self._judged, self._signs = False, False, list[int]()
        self._tangents = 0
        self._correction: float | None = None
        self._outcome: Outcome | None = None
        self._fault: Outcome | None = None

    def _create_snes(self) -> PETSc.SNES:
        snes = PETSc.SNES().create(self.comm)
        snes.setOptionsPrefix(SolverOptions.prefix)
        snes.setKSP(self.ksp)
        snes.setFunction(self._assemble_residual, self.rhs)
        snes.setJacobian(self._assemble_tangent, self.matrix)
        snes.setConvergenceTest(self._judge)
        snes.setFromOptions()
        snes.setLineSearchPreCheck(self._back_off)
        return snes

    def solve(self, load: float, tolerance: float, *, begins_near: bool = False) -> Solve:
        """Newton's method from the present state, which is left unchanged if the outcome is not accepted.

        Args:
            load: load factor.
            tolerance: estimated error of the state relative to its norm.
            begins_near: whether the present state is known to be near the solution.
        """
        self.set_load(load)
        self._monitor = self._new_monitor(tolerance, begins_near=begins_near and self.reuse > 0)
        self._outcome, self._fault, self._fresh, self._correction, self._tangents = None, None, False, None, 0
        self._signs, self._judged = [], False
        start, x = self.state.x.petsc_vec, self._x
        accepted = start.copy()
        start.copy(x)
        start.copy(self._before)
        with self.timings("newton"):
            before = _logged_seconds()
            self.snes.solve(None, x)
            for event, seconds in _logged_seconds().items():
                self.timings.move("newton", event, seconds - before[event])
        reason: Any = self.snes.getConvergedReason()  # an int, whatever its stub says
        # Without an outcome of ours, PETSc ended the solve: it failed, or by a test that the user's options chose.
        # Where our test is asked, it alone says what has converged: PETSc takes a line search that failed with a tiny
        # step for convergence.
        outcome = self._outcome or _OUTCOMES_BY_REASON.get(reason, Outcome.DIVERGED)
        if reason > 0 and self._outcome is None:
            outcome = Outcome.LINE_SEARCH if self._judged else Outcome.CONVERGED
        if outcome in (Outcome.ITERATION_LIMIT, Outcome.DIVERGED):
            outcome = self._fault or outcome  # what kept the last correction short is why
        if outcome is Outcome.LINEAR_SOLVER:
            self.forget_factors()
        self.set_state(x)
        if outcome.accepted:
            outcome = self.fault_of_solution() or outcome
        if not outcome.accepted:
            self.set_state(accepted)
        accepted.destroy()
        return Solve(load, outcome, tuple(self._monitor.history), self._tangents, tuple(self._signs))

    def predict(self, load: float) -> float:
        """Move the state along the tangent of the solution path to another load factor, with the factors at hand.

        A step that would turn an element inside out is not taken.

        Returns:
            The length of the step, taken or not.
        """
        start, x = self.state.x.petsc_vec.copy(), self._x
        self.set_load(load)
        self._assemble_residual(self.snes, start, self.rhs)
        with self.timings("linear solve"):
            self.ksp.solve(self.rhs, x)
        length = norm(x)
        x.aypx(-1.0, start)
        self.set_state(x)
        if not np.isfinite(length) or self.fault():
            self.set_state(start)
        start.destroy()
        return length

    @contextmanager
    def newton(self, line_search: str) -> Iterator[None]:
        """Within this context every iteration has a new tangent, and another line search (a type of PETSc's)."""
        search = self.snes.getLineSearch()
        kept, reuse = search.getType(), self.reuse
        search.setType(line_search)
        self.reuse = 0.0
        try:
            yield
        finally:
            search.setType(kept)
            self.reuse = reuse

    def interrupted(self) -> bool:
        """Whether a signal has asked any rank to stop; collective."""
        return bool(self.comm.allreduce(self.stop_asked(), op=MPI.LOR))

    def destroy(self) -> None:
        """Free what PETSc holds."""
        for part in (self.snes, self._x, self._before):
            part.destroy()
        super().destroy()

    def _new_monitor(self, tolerance: float, *, begins_near: bool = False) -> NewtonMonitor:
        return NewtonMonitor(tolerance, self.limit, self.reuse, begins_near)

    def _assemble_residual(self, _snes: PETSc.SNES, x: PETSc.Vec, b: PETSc.Vec) -> None:
        self.set_state(x)
        self.residual(b)

    def _assemble_tangent(self, _snes: PETSc.SNES, x: PETSc.Vec, _A: PETSc.Mat, _P: PETSc.Mat) -> None:
        self._fresh = self._monitor.wants_new_tangent
        if self._fresh:
            self._tangents += 1
            self.set_state(x)
            self.tangent()

    def _judge(self, snes: PETSc.SNES, it: int, norms: tuple[float, float, float]) -> int:
        """PETSc's convergence test."""
        residual, self._judged = norms[2], True
        if self.interrupted():
            self._outcome = Outcome.INTERRUPTED
            return _GIVEN_UP
        x = snes.getSolution()
        if it == 0:
            if not np.isfinite(residual):
                self._outcome = Outcome.NOT_FINITE
                return _GIVEN_UP
            if residual == 0.0:
                self._outcome = Outcome.CONVERGED
                return _DONE
            return 0
        if self._fresh and (sign := self.sign_of_determinant()):
            self._signs.append(sign)
        if self._correction is None:  # no line search: a trust region, say
            self._before.aypx(-1.0, x)
            self._correction = norm(self._before)
            x.copy(self._before)
        iteration = NewtonIteration(self._correction, norm(x), residual, self._fresh)
        self._outcome = self._monitor.judge(iteration)
        if self._outcome is None:
            return 0
        return _DONE if self._outcome.accepted else _GIVEN_UP

    def _back_off(self, x: PETSc.Vec, y: PETSc.Vec) -> bool:
        """Halve the correction ``-y`` until the state is admissible, at most ten times."""
        # The whole correction is what measures the error: a damped one is small even far from the solution.
        self._correction = norm(y)
        trial = x.duplicate()
        shortened = False
        with self.timings("admissibility check"):
            self._fault = None
            for _ in range(10):
                x.copy(trial)
                trial.axpy(-1.0, y)
                self.set_state(trial)
                if (fault := self.fault()) is None:
                    break
                self._fault = fault
                y.scale(0.5)
                shortened = True
        trial.destroy()
        return shortened


def _logged_seconds() -> dict[str, float]:
    """Seconds that PETSc's log has counted on this rank, by phase."""
    if not PETSc.Log.isActive():
        PETSc.Log.begin()
    events = {"factorization": "PCSetUp", "linear solve": "KSPSolve"}
    return {phase: PETSc.Log.Event(event).getPerfInfo()["time"] for phase, event in events.items()}
