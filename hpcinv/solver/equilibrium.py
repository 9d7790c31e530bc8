"""Newton's method for the equilibrium of a system and the equations of its unknown numbers, by PETSc's SNES.

SNES iterates on the state x. Numbers q, such as pressures of cavities or the load factor of a path, follow it: before
the line search, each correction of the state gets what the numbers change (`hpcinv.solver.bordered_solver`), and a
trial of the line search takes the same share of both. So one loop, with its kept factors, its checks and PETSc's line
searches, serves fixed loads, unknown loads and motions, and paths that are followed by their length.
"""

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from petsc4py import PETSc

from hpcinv.base.parallel.petsc_calls import weakly
from hpcinv.base.parallel.petsc_vectors import dot, norm
from hpcinv.mesh.source import Floats
from hpcinv.model.assembly.system import System
from hpcinv.model.outcome import Outcome
from hpcinv.solver.border import Border
from hpcinv.solver.bordered_solver import BorderedSolver
from hpcinv.solver.linear_solver import LinearSolver
from hpcinv.solver.mip_newton import ExtrapolatedStress
from hpcinv.solver.newton import Floor, NewtonIteration, NewtonMonitor, Solve, Tolerance
from hpcinv.solver.observer import SILENT, Observer, is_stop_asked
from hpcinv.solver.petsc_options import SolverOptions
from hpcinv.solver.predictor import Increment, Prediction, Predictor

type Kept = tuple[Floats, Any]
"""a state, ghosts included, and numbers"""

_GIVEN_UP = -7  # SNES_DIVERGED_INNER, returned to PETSc when NewtonMonitor ends a solve without convergence
_DONE = 4  # SNES_CONVERGED_SNORM_RELATIVE

CONTRACTING = 0.5
"""Ratio of a second correction to the first from which on it is left out. Corrections by the same factors need not
converge above it (Deuflhard, Newton Methods for Nonlinear Problems, 2011, doi:10.1007/978-3-642-23899-4, ch. 2). If it
is raised, the second one may lead away from the solution."""

_LARGEST_SIZE = 2.0  # above the size of any body, in scaled lengths

_OUTCOMES_BY_REASON: dict[int, Outcome] = {
    PETSc.SNES.ConvergedReason.DIVERGED_LINEAR_SOLVE: Outcome.LINEAR_SOLVER,
    PETSc.SNES.ConvergedReason.DIVERGED_LINE_SEARCH: Outcome.LINE_SEARCH,
    PETSc.SNES.ConvergedReason.DIVERGED_FUNCTION_NANORINF: Outcome.NOT_FINITE,
    PETSc.SNES.ConvergedReason.DIVERGED_FUNCTION_DOMAIN: Outcome.INVERTED,
    PETSc.SNES.ConvergedReason.DIVERGED_MAX_IT: Outcome.ITERATION_LIMIT,
}


@dataclass
class _Progress:
    """State of one solve.

    Attributes:
        first_step: increment of the first correction, or of the prediction; ``None`` before either.
        signs: signs of the determinants of new tangents.
        factorizations: number of factorizations before the solve, without its prediction's.
        travelled: sum of the corrections since the last factorization.
        too_far: value of it from which earlier factors are not tried any more.
        has_new_tangent: whether the present correction is computed with a new tangent.
        correction: norm of the last correction before it was shortened.
        short: the fault for which the last correction was shortened.
        refused: the reason why no correction can be taken.
        farthest: ratio of the first correction to the prediction above which the solve ends.
        is_tested: whether PETSc has called the convergence test.
        numbers: the unknown numbers, if there are any.
        load: load factor, which is one of the numbers along a path.
        origin: numbers before the present correction.
        change: change of the numbers by the present correction; ``None`` before there is one.
        step: correction of the state that goes with it, after the state of which `_last_state` is a copy.
    """

    monitor: NewtonMonitor
    numbers: BorderedSolver
    load: float
    origin: Any = None
    change: Floats | None = None
    step: PETSc.Vec | None = None
    first_step: Increment | None = None
    factorizations: int = 0
    travelled: float = 0.0
    too_far: float = math.inf
    signs: list[int] = field(default_factory=list)
    has_new_tangent: bool = False
    correction: float | None = None
    outcome: Outcome | None = None
    short: Outcome | None = None
    refused: Outcome | None = None
    farthest: float = math.inf
    is_tested: bool = False

    def outcome_of(self, reason: int) -> Outcome:
        """Return the outcome of the solve, for PETSc's ``reason``.

        Without an outcome of the convergence test, PETSc ended the solve, by a failure or by a test that the user's
        options chose. Where the convergence test is called, it alone decides on convergence: PETSc takes a line search
        that failed with a tiny step for convergence.
        """
        outcome = self.outcome or _OUTCOMES_BY_REASON.get(reason, Outcome.DIVERGED)
        if reason > 0 and self.outcome is None:
            outcome = Outcome.LINE_SEARCH if self.is_tested else Outcome.CONVERGED
        if outcome in (Outcome.ITERATION_LIMIT, Outcome.DIVERGED):
            outcome = self.short or outcome
        return outcome


@dataclass(frozen=True)
class _Request:
    """What a solve is asked for, as in `Equilibrium.solve`."""

    load: float
    tolerance: Tolerance
    numbers: BorderedSolver
    begins_near: bool = False
    farthest: float = math.inf
    growths_allowed: int = NewtonMonitor.growths_allowed
    keeps: bool = False


class Equilibrium:
    """Newton's method for a system, with a linear solver, monitored by the corrections.

    The tangent is kept while corrections contract (Shamanskii). The matrix is then not assembled again, so that PETSc
    keeps its factors too, and one symbolic analysis serves the whole run. Before the line search, a correction by a
    kept tangent that does not contract is computed again with a new one, and one that would turn an element inside
    out, or strain it beyond the domain of its law, is halved.

    Args:
        reuse: largest contraction at which the tangent is kept, 0 for full Newton, which load steps with friction have.

    Attributes:
        observer: observer of the iterations; it is asked on all ranks before each one whether to stop.
        numbers: the unknown numbers of the system's loads and supports, by default none.
    """

    _less_far = 0.1  # share of a distance at which earlier factors were no longer good at which they are tried again

    def __init__(self, system: System, linear: LinearSolver, predictor: Predictor, *, limit: int, reuse: float) -> None:
        self.system, self.linear, self.predictor = system, linear, predictor
        self.limit, self.reuse = limit, reuse
        self.observer: Observer = SILENT
        with system.timings("set-up"):
            # SNES iterates on a separate vector, since every trial of the line search changes the state.
            self._x, self._last_state, self._r = (system.rhs.duplicate() for _ in range(3))
            self.snes = self._create_snes()
            self.mip = ExtrapolatedStress(system)
        self.numbers = BorderedSolver(system, linear)
        self._now = _Progress(self._monitor(_Request(0.0, 1.0, self.numbers)), self.numbers, 0.0)
        self._is_softer = False  # whether the last solve failed, and friction gives way more from then on
        self._load = 0.0  # load factor of the last equilibrium

    def _create_snes(self) -> PETSc.SNES:
        snes = PETSc.SNES().create(self.system.comm)
        snes.setOptionsPrefix(SolverOptions.prefix)
        snes.setKSP(self.linear.ksp)
        snes.setFunction(weakly(self._assemble_residual), self._r)
        snes.setConvergenceTest(weakly(self._test_convergence))
        with self.linear.options.blamed():
            snes.setFromOptions()
        # SNES would factorize its first tangent in any case, so the first one is not a tangent.
        snes.setJacobian(lambda *_: None, self.system.matrix)
        snes.computeJacobian(self._x, self.system.matrix)
        snes.setJacobian(weakly(self._assemble_tangent), self.system.matrix)
        snes.setLineSearchPreCheck(weakly(self._check))
        return snes

    def solve(
        self,
        load: float,
        tolerance: Tolerance,
        *,
        predicted: Prediction | None = None,
        begins_near: bool = False,
        farthest: float = math.inf,
        numbers: BorderedSolver | None = None,
        growths_allowed: int = NewtonMonitor.growths_allowed,
        keeps: bool = False,
    ) -> Solve:
        """Solve from the present state and numbers, which are unchanged if the outcome is not accepted.

        Args:
            load: load factor; where it is one of the numbers, the one to begin with.
            tolerance: estimated error of the state relative to its norm, as in `NewtonMonitor`.
            predicted: prediction of the present state; its effort is added to the effort of the solve.
            begins_near: whether the present state is known to be near the solution.
            farthest: ratio of the first correction to the prediction, both with the same tangent, above which the
                solve ends (`Outcome.TOO_NONLINEAR`); the prediction's factors remain.
            numbers: the unknown numbers, if they are not the system's.
            growths_allowed, keeps: as in `NewtonMonitor`.

        The first solve with friction that diverges is made again with friction that gives way more, as later ones are.
        """
        request = _Request(load, tolerance, numbers or self.numbers, begins_near, farthest, growths_allowed, keeps)
        solve = self._solve(request, predicted)
        if not self._is_softer:
            return solve
        again = self._solve(request, before=predicted)
        return replace(again, factorizations=solve.factorizations + again.factorizations)

    def _solve(self, request: _Request, predicted: Prediction | None = None, before: Prediction | None = None) -> Solve:
        """Solve as `solve` does, once.

        Args:
            before: prediction that led from an equilibrium to the present state, of a solve that failed before.
        """
        system, linear, numbers, load = self.system, self.linear, request.numbers, request.load
        self._is_softer = False
        numbers.put(load)
        system.begin_contact_step(load)
        if system.weak_form.passages.has_passed():  # an obstacle that moves
            return self._passed_through(load, predicted, numbers)
        monitor = self._monitor(request)
        kept_numbers = numbers.kept_numbers()
        self._now = now = _Progress(monitor, numbers, load, kept_numbers)
        now.factorizations, now.farthest = linear.factorizations, request.farthest
        if predicted is not None:
            now.factorizations -= predicted.factorizations
            now.signs = list(predicted.signs)
        start, x = system.state.x.petsc_vec, self._x
        accepted = start.copy()
        start.copy(x)
        start.copy(self._last_state)
        if predicted is not None and predicted.is_taken and self._takes_full_steps:
            now.monitor.predicted = predicted.length
            now.first_step = predicted.increment
            predicted.origin.copy(self._last_state)
        now.travelled = predicted.length if predicted is not None else norm(x)
        linear.limit_iterations()
        with system.timings("newton"):
            seconds_before = _linear_solve_seconds()
            with linear.options.blamed():
                self.snes.solve(None, x)
            system.timings.move("newton", "linear solve", _linear_solve_seconds() - seconds_before)
        reason: Any = self.snes.getConvergedReason()  # an int, whatever its stub says
        outcome = now.outcome_of(reason)
        linear.count_iterations(self.snes.getLinearSolveIterations())
        if outcome is Outcome.LINEAR_SOLVER:
            if linear.fall_back():
                system.set_state(accepted)
                numbers.restore(kept_numbers)
                accepted.destroy()
                return self._solve(replace(request, farthest=math.inf, keeps=False), before=predicted or before)
            linear.forget_factors()
            outcome = linear.failure
        system.set_state(x)
        outcome = self._checked(outcome)
        if outcome.accepted:
            system.weak_form.passages.depart()
            system.end_contact_step(now.load)
            self._load = now.load
        else:
            system.set_state(accepted)
            numbers.restore(kept_numbers)
            self._follow_failure(outcome, request, predicted or before)
            numbers.restore(kept_numbers)
            numbers.put(load)
            system.set_state(accepted)
        accepted.destroy()
        history, iterations = tuple(now.monitor.history), linear.take_iterations()
        factorizations = linear.factorizations - now.factorizations
        return Solve(now.load, outcome, history, factorizations, tuple(now.signs), linear_iterations=iterations)

    def _follow_failure(self, outcome: Outcome, request: _Request, predicted: Prediction | None) -> None:
        """Let contacts follow a solve that failed, by the pressures of the equilibrium with which its step began.

        The present state is the beginning of the solve. A prediction, and the load of the step, may carry surfaces
        deep into each other: pressures there are far above any that a solution has.
        """
        system, numbers = self.system, request.numbers
        if predicted is not None:
            system.set_state(predicted.origin)
        numbers.put(request.load if request.begins_near else self._load)
        self._is_softer = system.follow_failure(outcome)

    def _checked(self, outcome: Outcome) -> Outcome:
        """Return the outcome of a solve, whose present state may not be one of the body."""
        if outcome.accepted:
            outcome = self.system.fault_of_solution() or outcome
        if outcome.accepted and self.system.weak_form.passages.has_passed():
            return Outcome.PASSED_THROUGH
        return outcome

    def _passed_through(self, load: float, predicted: Prediction | None, numbers: BorderedSolver) -> Solve:
        """Return the report of a solve that an obstacle prevents, in the state before its prediction."""
        if predicted is not None:
            self.system.set_state(predicted.origin)
            numbers.restore(predicted.numbers)
        return Solve(load, Outcome.PASSED_THROUGH, (), 0 if predicted is None else predicted.factorizations)

    def take_numbers(self, borders: Sequence[Border] = ()) -> None:
        """Let the system have these unknown numbers from now on."""
        self.numbers.destroy()
        for border in self.numbers.borders:
            border.destroy()
        self.numbers = BorderedSolver(self.system, self.linear, borders)

    def predict(self, load: float, *, new_tangent: bool = False) -> Prediction:
        """Move the state and the numbers along the tangent of their path, as `Predictor.predict` does."""
        return self.predictor.predict(load, self.numbers, new_tangent=new_tangent)

    def kept(self) -> Kept:
        """Return the present state and numbers, for `restore`."""
        return self.system.state.x.array.copy(), self.numbers.kept_numbers()

    def restore(self, kept: Kept) -> None:
        """Return to a state and numbers that `kept` returned."""
        values, numbers = kept
        self.system.set_values(values)
        self.numbers.restore(numbers)

    def begin_path(self) -> None:
        """Let the load factor lead from the present state, with numbers that suit it, to the full load; collective."""
        self.numbers.recover(1.0)
        self.system.begin_path()
        self.numbers.begin_path()

    def depart(self, load: float) -> None:
        """Let ways past obstacles begin at the present state, an equilibrium under this load factor."""
        self._load = load
        if passages := self.system.weak_form.passages:
            self.system.set_load(load)
            passages.depart()

    @contextmanager
    def newton(self, line_search: str) -> Iterator[None]:
        """Context in which every iteration has a new tangent and a given line search (a type of PETSc's)."""
        search = self.snes.getLineSearch()
        kept, reuse = search.getType(), self.reuse
        search.setType(line_search)
        self.reuse = 0.0
        try:
            yield
        finally:
            search.setType(kept)
            self.reuse = reuse

    def correct(self, load: float) -> None:
        """Add a full Newton correction to the present state, without a check of the elements, and one by its factors.

        The error that the first one leaves is of second order in it, and of third order after the second. A second one
        that does not contract is left out.
        """
        system = self.system
        state, step = system.position(), system.rhs.duplicate()
        system.linearise(load)
        system.residual(system.rhs)
        self.linear.solve(system.rhs, step)
        state.axpy(-1.0, step)
        system.set_state(state)
        length = step.norm()
        system.residual(system.rhs)
        self.linear.limit_iterations()
        if self.linear.back_substitute(system.rhs, step) and step.norm() < CONTRACTING * length:
            state.axpy(-1.0, step)
            system.set_state(state)
        state.destroy()
        step.destroy()

    def floor(self, load: float | None = None, least: float = 0.0) -> Floor:
        """Return the floor of the norm of states, at the present load factor or at another one; collective when used.

        It is the norm of a state with the nominal displacement, and pressures of the nominal strain, at each node.

        Args:
            least: displacement (scaled) up to which corrections are rounding errors, whatever the nominal one is.
        """
        unknowns, system = self.system.weak_form.unknowns, self.system
        nodes = math.sqrt(unknowns.size)

        def norm_of_nominal_state() -> float:
            if load is not None:
                system.set_load(load)
            with system.timings("programs"):
                nominal = system.weak_form.nominal_displacement
            with system.timings("residual"):
                return nodes * max(nominal()[0], least / NewtonMonitor.rounding)

        return Floor(norm_of_nominal_state, nodes * _LARGEST_SIZE)

    def interrupted(self) -> bool:
        """Return whether any rank is asked to stop; collective."""
        return is_stop_asked(self.system.comm, self.observer)

    def destroy(self) -> None:
        self.take_numbers()
        for part in (self.snes, self._x, self._last_state, self._r, self.predictor, self.linear, self.system):
            part.destroy()

    def _monitor(self, request: _Request) -> NewtonMonitor:
        # In load steps, kept tangents would lose the pressure that friction needs.
        is_full = self.system.weak_form.contacts.depends_on_path and not request.keeps
        reuse = 0.0 if is_full else self.reuse
        return NewtonMonitor(
            request.tolerance,
            self.limit,
            reuse,
            request.begins_near and reuse > 0,
            inexact=self.linear.configuration.error,
            growths_allowed=request.growths_allowed,
            keeps=request.keeps,
            floor=self.floor(least=request.numbers.least),
        )

    def _assemble_residual(self, _snes: PETSc.SNES, x: PETSc.Vec, b: PETSc.Vec) -> None:
        self.system.set_state(x)
        self._let_numbers_follow(x)
        self.system.residual(b)

    def _let_numbers_follow(self, x: PETSc.Vec) -> None:
        """Put the numbers in that go with a state on the way of the present correction."""
        now = self._now
        if now.change is None or now.step is None or not now.numbers.count:
            return
        share, length = 1.0, dot(now.step, now.step)
        if not self._takes_full_steps and length:
            share = (dot(self._last_state, now.step) - dot(x, now.step)) / length
        now.numbers.restore(now.origin)
        now.numbers.change(share * now.change)
        now.load = now.numbers.load_of(now.load)
        now.numbers.put(now.load)

    def _assemble_tangent(self, _snes: PETSc.SNES, x: PETSc.Vec, _A: PETSc.Mat, _P: PETSc.Mat) -> None:
        has_touched = self._now.short is Outcome.PASSED_THROUGH
        self._now.has_new_tangent = has_touched or self._now.monitor.needs_new_tangent
        if self._now.has_new_tangent:
            self._renew_tangent(x)

    def _renew_tangent(self, x: PETSc.Vec) -> None:
        system, first = self.system, self._now.first_step
        system.set_state(x)
        terms = []
        # The tangent with numbers is the tangent of their path too, so it has no other terms.
        if first is not None and not self._now.numbers.count and self.mip.is_needed(first):
            terms.append(self.mip.extrapolation(self._last_state, first))
        system.tangent(*terms)
        self._now.numbers.is_stale = True
        now, count_before = self._now, self.linear.factorizations
        is_near = now.travelled <= now.too_far
        self.linear.factorize(may_keep=self._takes_full_steps and now.monitor.reuse > 0 and is_near)
        if self.linear.factorizations > count_before:
            now.travelled = 0.0

    def _test_convergence(self, snes: PETSc.SNES, it: int, norms: tuple[float, float, float]) -> int:
        now = self._now
        residual, now.is_tested = norms[2], True
        if self.interrupted():
            now.outcome = Outcome.INTERRUPTED
            return _GIVEN_UP
        x = snes.getSolution()
        if it == 0:
            if not np.isfinite(residual):
                now.outcome = Outcome.NOT_FINITE
                return _GIVEN_UP
            if residual == 0.0 and not now.numbers.count:
                now.outcome = Outcome.CONVERGED
                return _DONE
            return 0
        if now.has_new_tangent and (sign := self.linear.sign_of_determinant()):
            now.signs.append(sign * now.numbers.sign)
        if now.correction is None:  # no line search: a trust region, say
            self._last_state.aypx(-1.0, x)
            now.correction = norm(self._last_state)
            x.copy(self._last_state)
        # Without a correction there is nothing to judge by.
        if now.refused in (Outcome.LINEAR_SOLVER, Outcome.TOO_NONLINEAR):
            now.outcome = now.refused
            return _GIVEN_UP
        now.travelled += now.correction
        iteration = NewtonIteration(now.correction, norm(x), residual, now.has_new_tangent)
        self.observer.iteration(iteration)
        now.outcome = now.monitor.judge(iteration)
        if now.outcome is None or not now.outcome.accepted:
            now.outcome = now.refused or now.outcome
        if now.outcome is None:
            return 0
        return _DONE if now.outcome.accepted else _GIVEN_UP

    @property
    def _takes_full_steps(self) -> bool:
        return self.snes.getType() == "newtonls" and self.snes.getLineSearch().getType() == "basic"

    def _check(self, x: PETSc.Vec, y: PETSc.Vec) -> bool:
        """Change the correction ``-y`` before the line search, if necessary; return whether it was changed."""
        now, changed = self._now, False
        if self._takes_full_steps and self.linear.must_renew:
            self.linear.renew()
            now.too_far = self._less_far * now.travelled
            now.travelled, changed = 0.0, True
            self._solve_again(y)
        changed |= self._complete(x, y)
        if self._takes_full_steps:
            if not now.has_new_tangent and now.monitor.exceeds_prediction(norm(y), now.farthest):
                now.refused = Outcome.TOO_NONLINEAR
                self._refuse_step(y)
                return True
            if not now.has_new_tangent and not now.monitor.accepts(norm(y), norm(x)):
                now.has_new_tangent, changed = True, True
                self._renew_tangent(x)
                self._solve_again(y)
                self._complete(x, y)
            self.system.set_state(x)
            increment = self.predictor.increments(y)
            if not now.monitor.history and not now.monitor.predicted:
                now.first_step = increment
            if now.monitor.is_too_large(increment):
                now.refused = now.refused or Outcome.DIVERGED
        # The whole correction measures the error: a damped one is small even far from the solution.
        now.correction = norm(y)
        if now.change is not None and (size := now.numbers.size(now.change)):
            now.correction = math.hypot(now.correction, norm(x) * size)
        share, now.short = self.system.admissible_share(x, y)
        y.scale(share)
        if now.change is not None:
            now.change, now.step = share * now.change, y
        x.copy(self._last_state)
        return changed or share < 1

    def _complete(self, x: PETSc.Vec, y: PETSc.Vec) -> bool:
        """Add what the unknown numbers change to the correction ``-y``; return whether there are any."""
        now, numbers = self._now, self._now.numbers
        if not numbers.count:
            return False
        now.origin = numbers.kept_numbers()
        self.system.set_state(x)
        try:
            if numbers.is_stale and not numbers.set_columns(now.load, may_fall_back=False):
                raise np.linalg.LinAlgError
            now.change = numbers.complete(numbers.equations(now.load), y)
        except np.linalg.LinAlgError:  # such as a pressure that moves no volume
            now.refused = Outcome.LINEAR_SOLVER
            self._refuse_step(y)
        return True

    def _refuse_step(self, y: PETSc.Vec) -> None:
        y.set(0.0)
        self._now.change = np.zeros(self._now.numbers.count)

    def _solve_again(self, y: PETSc.Vec) -> None:
        """Compute the correction ``-y`` again with a new tangent, or new factors."""
        if not self.linear.back_substitute(self._r, y):
            self._now.refused = Outcome.LINEAR_SOLVER
            self._refuse_step(y)


def _linear_solve_seconds() -> float:
    """Return the seconds of all linear solves on this rank, from the log of PETSc, which `runtime` has begun."""
    return float(PETSc.Log.Event("KSPSolve").getPerfInfo()["time"])
