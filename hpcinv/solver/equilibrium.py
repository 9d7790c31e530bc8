"""Equilibrium of a scene at one load factor: PETSc SNES with a line search on the assembled residual and tangent."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import hpcinv.parallel.runtime  # noqa: F401  (its import order first)

# isort: split
import numpy as np
from petsc4py import PETSc

from hpcinv.model.outcome import Outcome
from hpcinv.parallel.petsc_log import logged_seconds
from hpcinv.parallel.petsc_vectors import norm
from hpcinv.parallel.runtime import MPI
from hpcinv.solver.mip_newton import ExtrapolatedStress
from hpcinv.solver.newton import NewtonIteration, NewtonMonitor
from hpcinv.solver.observer import SILENT, Observer
from hpcinv.solver.petsc_options import SolverOptions, Value
from hpcinv.solver.predictor import Predictor
from hpcinv.solver.step_report import Solve as Solve  # part of this module's interface

if TYPE_CHECKING:
    from hpcinv.model.scene import Scene
    from hpcinv.model.supports import Supports
    from hpcinv.parallel.timings import Timings
    from hpcinv.solver.linear.selection import Choice

_GIVEN_UP = -7  # SNES_DIVERGED_INNER: what PETSc is told when NewtonMonitor gives up
_DONE = 4  # SNES_CONVERGED_SNORM_RELATIVE

_OUTCOMES_BY_REASON: dict[int, Outcome] = {
    PETSc.SNES.ConvergedReason.DIVERGED_LINEAR_SOLVE: Outcome.LINEAR_SOLVER,
    PETSc.SNES.ConvergedReason.DIVERGED_LINE_SEARCH: Outcome.LINE_SEARCH,
    PETSc.SNES.ConvergedReason.DIVERGED_FUNCTION_NANORINF: Outcome.NOT_FINITE,
    PETSc.SNES.ConvergedReason.DIVERGED_FUNCTION_DOMAIN: Outcome.INVERTED,
    PETSc.SNES.ConvergedReason.DIVERGED_MAX_IT: Outcome.ITERATION_LIMIT,
}


class Equilibrium(Predictor):
    """Newton's method for the discrete equations of one scene.

    The tangent is kept while corrections contract (Shamanskii); the matrix is then left untouched, so that PETSc keeps
    its factors too, and its symbolic analysis serves the whole run. Before the line search sees a correction, one of a
    kept tangent that does not contract is found anew, and one that would turn an element inside out, or strain it
    beyond what its law is defined for, is halved.

    Args:
        scene: residual and load factor.
        supports: Dirichlet conditions on the scene's unknowns.
        options: PETSc options of the job, beside the defaults.
        choice: preset of the linear solver.
        limit: Newton iterations after which a solve is given up.
        reuse: largest contraction at which the tangent is kept, 0 for full Newton.
        observer: of the iterations; all ranks are asked before each one whether to stop.
    """

    def __init__(
        self,
        scene: Scene,
        supports: Supports,
        timings: Timings,
        *,
        options: Mapping[str, Value],
        choice: Choice,
        limit: int = 30,
        reuse: float = 0.3,
        observer: Observer = SILENT,
    ) -> None:
        super().__init__(scene, supports, timings, options, choice)
        self.limit, self.reuse, self.observer = limit, reuse, observer
        with timings("set-up"):
            # SNES iterates on a vector of its own: the state moves along with every trial of the line search.
            self._x, self._before = self.rhs.duplicate(), self.rhs.duplicate()
            self.snes = self._create_snes()
            self._extrapolated = ExtrapolatedStress(scene, supports)
        self._monitor = self._new_monitor(1.0)
        self._fresh, self._judged, self._signs = False, False, list[int]()
        self._tangents = 0
        self._correction: float | None = None
        self._outcome: Outcome | None = None
        self._fault: Outcome | None = None
        self._verdict: Outcome | None = None  # of a correction, before it is taken

    def _create_snes(self) -> PETSc.SNES:
        snes = PETSc.SNES().create(self.comm)
        snes.setOptionsPrefix(SolverOptions.prefix)
        snes.setKSP(self.ksp)
        snes.setFunction(self._assemble_residual, self.rhs)
        snes.setJacobian(self._assemble_tangent, self.matrix)
        snes.setConvergenceTest(self._judge)
        snes.setFromOptions()
        snes.setLineSearchPreCheck(self._check)
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
        self._outcome, self._fault, self._verdict, self._fresh, self._correction = None, None, None, False, None
        self._judged = False
        self._tangents, self._signs = self._new_tangents, self._new_signs
        self._new_tangents, self._new_signs = 0, []
        start, x = self.state.x.petsc_vec, self._x
        accepted = start.copy()
        start.copy(x)
        start.copy(self._before)
        self._extrapolated.begin(None)
        if self.predicted is not None and self._takes_full_steps:
            self._monitor.predicted = self.predicted.length
            self._extrapolated.begin(self.predicted.increment)
            self._origin.copy(self._before)
        self.predicted = None
        self.preset.allow(self.choice.budget)
        with self.timings("newton"):
            before = logged_seconds()
            self.snes.solve(None, x)
            for event, seconds in logged_seconds().items():
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
        self.count_iterations(self.snes.getLinearSolveIterations())
        if outcome is Outcome.LINEAR_SOLVER:
            if self.fall_back():
                self.set_state(accepted)
                accepted.destroy()
                return self.solve(load, tolerance, begins_near=begins_near)
            self.forget_factors()
            if not self.preset.exact:
                outcome = Outcome.KRYLOV_LIMIT
        self.set_state(x)
        if outcome.accepted:
            outcome = self.fault_of_solution() or outcome
        if not outcome.accepted:
            self.set_state(accepted)
        accepted.destroy()
        return Solve(
            load,
            outcome,
            tuple(self._monitor.history),
            self._tangents,
            tuple(self._signs),
            linear_iterations=self.counted_iterations(),
        )

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

    def compile(self, *, prescribed_motion: bool) -> None:
        """Compile what solves may come to need, where supports prescribe a motion or not."""
        self._extrapolated.compile()
        if prescribed_motion:
            self.compile_lifting()

    def interrupted(self) -> bool:
        """Whether a signal has asked any rank to stop; collective."""
        return bool(self.comm.allreduce(self.observer.stop_asked(), op=MPI.LOR))

    def destroy(self) -> None:
        """Free what PETSc holds."""
        for part in (self.snes, self._x, self._before):
            part.destroy()
        super().destroy()

    def _new_monitor(self, tolerance: float, *, begins_near: bool = False) -> NewtonMonitor:
        return NewtonMonitor(tolerance, self.limit, self.reuse, begins_near, inexact=self.preset.error)

    def _assemble_residual(self, _snes: PETSc.SNES, x: PETSc.Vec, b: PETSc.Vec) -> None:
        self.set_state(x)
        self.residual(b)

    def _assemble_tangent(self, _snes: PETSc.SNES, x: PETSc.Vec, _A: PETSc.Mat, _P: PETSc.Mat) -> None:
        self._fresh = self._monitor.wants_new_tangent
        if self._fresh:
            self._renew(x)

    def _renew(self, x: PETSc.Vec) -> None:
        self._tangents += 1
        self.set_state(x)
        self.tangent()
        if self._extrapolated.wanted:
            with self.timings("compile"):
                self._extrapolated.compile()
            with self.timings("tangent"):
                self._extrapolated.add_to(self.matrix, self._before)
        self.factorize()

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
        if self._verdict is Outcome.LINEAR_SOLVER:  # there was no correction that could tell convergence
            self._outcome = self._verdict
            return _GIVEN_UP
        iteration = NewtonIteration(self._correction, norm(x), residual, self._fresh)
        self.observer.iteration(iteration)
        self._outcome = self._monitor.judge(iteration)
        if self._outcome is None or not self._outcome.accepted:
            self._outcome = self._verdict or self._outcome
        if self._outcome is None:
            return 0
        return _DONE if self._outcome.accepted else _GIVEN_UP

    @property
    def _takes_full_steps(self) -> bool:
        return self.snes.getType() == "newtonls" and self.snes.getLineSearch().getType() == "basic"

    def _check(self, x: PETSc.Vec, y: PETSc.Vec) -> bool:
        """What becomes of the correction ``-y`` before the line search takes it; whether it is another one then."""
        changed = False
        if self._takes_full_steps:
            changed = not self._fresh and not self._monitor.may_take(norm(y), norm(x))
            if changed:
                self._find_anew(x, y)
            self.set_state(x)
            increment = self.increments(y)
            if not self._monitor.history and not self._monitor.predicted:
                self._extrapolated.begin(increment)
            if self._monitor.is_hopeless(increment):
                self._verdict = self._verdict or Outcome.DIVERGED
        # The whole correction is what measures the error: a damped one is small even far from the solution.
        self._correction = norm(y)
        changed |= self._back_off(x, y)
        x.copy(self._before)
        return changed

    def _find_anew(self, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """The correction with a new tangent."""
        self._fresh = True
        self._renew(x)
        if not self.back_substitute(self.snes.getFunction()[0], y):
            self._verdict = Outcome.LINEAR_SOLVER
            y.set(0.0)

    def _back_off(self, x: PETSc.Vec, y: PETSc.Vec) -> bool:
        """Halve the correction ``-y`` until the state is admissible, at most ten times."""
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
