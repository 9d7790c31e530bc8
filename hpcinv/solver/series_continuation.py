"""Continuation in the load factor by power series: each expansion takes one factorization and reaches far.

At an equilibrium the path is expanded (`hpcinv.solver.power_series`), all orders with the same factors. Newton's method
corrects the state at the end of the range, and at the full load it decides as after any load step. A range whose end
it cannot correct is shortened. Where ranges are shorter than the smallest load step, such a step is tried at last; the
path ends where it fails.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from dolfinx.fem import Function
from petsc4py import PETSc

from hpcinv.base.parallel.petsc_vectors import norm
from hpcinv.base.quantity.arrays import Floats
from hpcinv.model.assembly.taylor_residual import TaylorResidual
from hpcinv.model.outcome import Outcome
from hpcinv.physics.points.scalar_graph import NotAnalytic
from hpcinv.solver.branch_switching import Bifurcation, bifurcation_of, switched
from hpcinv.solver.equilibrium import Equilibrium
from hpcinv.solver.equilibrium_path import EquilibriumPath, Policy, Solves
from hpcinv.solver.newton import SERIES, SWITCHED, Solve
from hpcinv.solver.power_series import Coefficients, PowerSeries
from hpcinv.solver.predictor import Increment, Prediction

_ORDERS = 20
"""Orders of an expansion. Fewer have a shorter range on slender bodies; more cost more than they reach farther."""
_FEWEST = 8
"""Orders of an expansion; from there on, each second order may be its last. Fewer do not show bifurcations."""
_ENOUGH = 1e-5
"""Error of a series at the full load at which its orders end. Newton's method corrects it with one factorization; of a
larger one, slender bodies take two. A smaller one takes orders that cost more than they save."""
_ACCURACY = 1e-4
"""Distance of the two last orders at the end of a range, relative to the range. A larger one needs more corrections."""
_POLISHED = 30.0
"""Error of a series, in tolerances, that the factors at its beginning may correct. They contract slowly where the body
has moved far: with a larger one, their corrections are often followed by a factorization all the same."""
_PRECISE = 1e-10  # relative error of coefficients; a larger one shortens the range without a trace
_REFINEMENTS = 12  # of a coefficient by factors of a near tangent, or rounded ones, after which new factors are made
_ROUNDED = 3  # refinements of a coefficient by rounded factors of the present tangent; exact ones take one
_CHEAPER = 8.0
"""New factors are made where refinements would take this many times as long, by the cost model, which is rough for
small bodies. With a value of 1 or 3, a column of cubic cells takes 77 factorizations instead of 35."""
_SLOW = 0.5  # contraction of refinements from which on they are given up
_TINY = 1e-100
"""Norm of the rate of the state by the load up to which only the load counts in the parameter: squares of smaller ones
underflow. With a larger one, the path of such a body would be cut into more ranges."""
_PATH_TOLERANCE = 1e-8  # of states between expansions; near a limit point of the load it matters
_LOCATED = 1e-9  # error of a series at a limit point that counts as found; the load there has no error of first order
_AHEAD = 1.2
"""Multiple of a range up to which a limit point is looked for. With a smaller one, Newton's method may pass the point
at the end of a range before it; a larger one finds limit points that do not exist, which shorten the range."""
_SHORT_RANGES = 3
"""Successive ranges shorter than the smallest load step, relative to the load, after which the path is thought to end.
Raised, bounds that the load only nears take more factorizations; lowered, limit points near bifurcations are missed."""
_NEAR = 3.0  # times the tangent of the path, up to which the solution of a small step belongs to it
_BEYOND_LIMIT = 0.3  # of the way to a limit point: a solve there confirms it; farther, Newton's method may fail
_BEFORE_LIMIT = 0.7  # share of the way to a limit point after which the path is expanded again
_TRIALS = 4  # ends of one range that are tried
_SHORTER = 0.6  # ratio of their parameters
_CHECKS = 8  # states along a range that are checked for inverted elements


@dataclass(frozen=True)
class SeriesSteps(Policy):
    """Ranges of power series; what they do not reach is left to others, with a line of the log.

    Attributes:
        smallest: smallest load step, as a share of a load case; path_tolerance: of the states on the way.
        side: as of `SeriesContinuation`.
        is_chosen: whether the job asks for the series; else it is silent where there is none.
    """

    smallest: float
    path_tolerance: float
    side: int = 0
    is_chosen: bool = False

    def solves(self, path: EquilibriumPath) -> Solves:
        observer, last = path.equilibrium.observer, None
        try:
            series = SeriesContinuation(path.equilibrium, self.side)
        except NotAnalytic as reason:
            if self.is_chosen:
                observer.failing([f"load steps instead of a power series: {reason}"])
            return
        path.begin()
        for last in series.follow(path, self):
            yield last
        if last is not None and not (
            last.outcome.accepted or last.outcome in (Outcome.LIMIT_POINT, Outcome.INTERRUPTED)
        ):
            observer.failing([f"load steps instead of a power series: {last.outcome.text}"])


class SeriesContinuation:
    """The equilibrium path by power series; methods are collective.

    Args:
        side: side of the other path to follow at the first bifurcation, 1 or -1 (`branch_switching`); 0 to stay.

    Raises:
        NotAnalytic: on all ranks, if the residual has no Taylor series, or the path does not begin unloaded.
    """

    def __init__(self, equilibrium: Equilibrium, side: int = 0) -> None:
        system = equilibrium.system
        if system.is_on_path:
            raise NotAnalytic("the path begins with another state")
        if equilibrium.numbers.count:
            raise NotAnalytic("a pressure of a cavity, or the motion under a remote load, is unknown")
        if system.weak_form.contacts.pairs:
            raise NotAnalytic("surfaces of an interface belong to different cells")
        if system.supports.is_curved:
            raise NotAnalytic("a support slides on a curved surface")
        self._equilibrium, self._system, self._linear = equilibrium, system, equilibrium.linear
        with system.timings("programs"):
            self._taylor = TaylorResidual(system.weak_form)
        self._scale, self._contraction, self._refinements, self._side = np.inf, 1.0, 0, side
        self._are_near = self._is_refined = False  # whether factors are of a tangent near, and correct iteratively

    def follow(self, path: EquilibriumPath, steps: SeriesSteps) -> Solves:
        """Yield a solve for each range on the way to the full load, as a `Policy` does."""
        system = self._system
        is_exact, are_near, short = path.load == 0.0, path.has_near_factors, 0
        while path.load < 1.0:
            load, goal, before = path.load, path.target(1.0), self._linear.factorizations
            system.linearise(load)
            origin = system.position()
            # Later expansions begin at states that are not exact.
            kept = _POLISHED * path.tolerance if is_exact else 0.0
            series = self._expand(load, goal, _ENOUGH, are_near=are_near)
            path.spent += self._linear.factorizations - before
            if isinstance(series, Outcome):  # after a solve that failed there may be no factors
                yield path.report(Solve(load, series, (), 0), SERIES)
                return
            mark = self._linear.inertia_mark()
            for solve in self._corrected(series, origin, goal, kept, path, steps):
                are_near = solve.factorizations > 0
                solve = self._branched(solve, series, origin, mark, path.cases)
                yield path.report(solve, SWITCHED if solve.strategy == SWITCHED else SERIES)
            origin.destroy()
            least = steps.smallest / path.cases
            is_short = solve.load < goal and solve.load - load < least * solve.load
            is_accepted, is_exact = solve.outcome.accepted, False
            if not (is_accepted or (is_short and solve.outcome is Outcome.DIVERGED)):
                return
            short = short + 1 if is_short and solve.strategy != SWITCHED and self._limit(series) is None else 0
            if short == _SHORT_RANGES or not is_accepted:
                solve = self._small_step(series, path, steps)
                yield path.report(solve, SERIES)
                if not solve.outcome.accepted:
                    return
                short, are_near = 0, solve.factorizations > 0
        if self._side:
            self._equilibrium.observer.failing(["no other path branches off before the full load"])

    def _small_step(self, series: PowerSeries, path: EquilibriumPath, steps: SeriesSteps) -> Solve:
        """Return the smallest load step from the present state, which shows whether and why the path ends there."""
        load, origin = path.load, self._system.position()
        solve = path.solve(path.target(steps.smallest / path.cases), steps.path_tolerance)
        moved = self._system.position()
        moved.axpy(-1.0, origin)
        slope = np.sqrt(self._system.comm.allreduce(series.states[0] @ series.states[0])) / series.loads[0]
        if norm(moved) > _NEAR * slope * (solve.load - load):
            solve = replace(solve, outcome=Outcome.ANOTHER_PATH)
            self._system.set_state(origin)
        origin.destroy()
        moved.destroy()
        return solve

    def expand(self, goal: float, wanted: float, *, are_near: bool) -> PowerSeries | Outcome:
        """Return the series at the present state, an equilibrium at load factor 0, or the reason why there is none.

        Arguments as of `_expand`.
        """
        self._system.linearise(0.0)
        return self._expand(0.0, goal, wanted, are_near=are_near)

    def _corrected(
        self,
        series: PowerSeries,
        origin: PETSc.Vec,
        goal: float,
        kept: float,
        path: EquilibriumPath,
        steps: SeriesSteps,
    ) -> Iterator[Solve]:
        """Yield the solves at the end of the range of a series, until one is accepted or all trials have failed.

        Args:
            kept: error of the series that the present factors may correct.
        """
        system, path_tolerance = self._system, min(steps.path_tolerance, _PATH_TOLERANCE)
        least = steps.smallest / path.cases
        a, is_pade = series.range(_ACCURACY)
        limit = self._limit(series)
        if limit is not None and series.load_at(series.weights(limit, pade=is_pade)) < goal:
            if series.error(limit, pade=is_pade) <= _LOCATED:
                yield from self._end_at_limit(series, origin, limit, a, path_tolerance, is_pade=is_pade)
                return
            a = _BEFORE_LIMIT * limit
        a = self._parameter_at(series, goal, a if limit is None else min(a, limit), is_pade=is_pade)
        a = self._admissible(series, origin, a, is_pade=is_pade)
        for _ in range(_TRIALS):
            weights = series.weights(a, pade=is_pade)
            load = series.load_at(weights)
            load = goal if abs(load - goal) < 1e-9 else load
            self._move(series, origin, weights)
            predicted = self._prediction(origin) if series.error(a, pade=is_pade) <= kept else None
            solve = path.solve(load, path_tolerance, predicted=predicted, begins_near=True)
            if predicted is not None:
                predicted.origin.destroy()
            if not solve.outcome.accepted:
                system.set_state(origin)
            yield solve
            if solve.outcome.accepted or solve.outcome.is_final:
                return
            if solve.outcome is not Outcome.VOLUME_CHANGED:
                a *= _SHORTER
                continue
            a = self._physical(series, origin, a, least / 4, is_pade=is_pade)
            load = series.load_at(series.weights(a, pade=is_pade))
            if load - series.load < least:
                yield Solve(load, solve.outcome, (), 0)
                return

    def _branched(self, solve: Solve, series: PowerSeries, origin: PETSc.Vec, mark: int, cases: int) -> Solve:
        """Return a solve with the bifurcation before it, if the series has one and the inertia of the tangent changes.

        If the other path is to be followed, it is the solve that begins there.

        Args:
            mark: mark of the inertia at the beginning of the series.
        """
        unknowns, comm = self._system.weak_form.unknowns, self._system.comm
        found = bifurcation_of(series, unknowns.owned_displacement_dofs, comm)
        if found is None or not solve.outcome.accepted or not series.load < found.load < solve.load:
            return solve
        spent = self._linear.factorizations - solve.factorizations
        self._system.linearise(solve.load)
        self._linear.factorize()
        if self._linear.inertia_mark() != mark:
            solve = replace(solve, bifurcation=found.load, mode=found.displacement)
            if self._side:
                solve = self._switched(solve, series, origin, found, cases)
        return replace(solve, factorizations=self._linear.factorizations - spent)

    def _switched(self, solve: Solve, series: PowerSeries, origin: PETSc.Vec, found: Bifurcation, cases: int) -> Solve:
        """Return the solve that begins the other path, or the given one on the first path."""
        side, self._side, first = self._side, 0, self._system.position()
        corrected = switched(self._equilibrium, series, origin, found, side, tolerance=_PATH_TOLERANCE, cases=cases)
        if corrected is None:
            self._system.set_load(solve.load)
            self._system.set_state(first)
            line = f"the other path at load {found.load:.6g} is not followed: the load falls along it"
            self._equilibrium.observer.failing([line])
        else:
            solve = replace(corrected.solve, strategy=SWITCHED, bifurcation=found.load, mode=found.displacement)
        first.destroy()
        return solve

    def _end_at_limit(
        self, series: PowerSeries, origin: PETSc.Vec, a: float, end: float, path_tolerance: float, *, is_pade: bool
    ) -> Iterator[Solve]:
        """Yield the state at a limit point of the load, and the outcome that the load goes no farther.

        A load that nears a bound without end seems to have a maximum, too. An equilibrium beyond it is proof.

        Args:
            end: end of the range of the series.
        """
        spent = self._linear.factorizations
        beyond = min((1 + _BEYOND_LIMIT) * a, end)
        weights = series.weights(beyond, pade=is_pade)
        self._move(series, origin, weights)
        fault = self._system.fault()
        if fault is None:
            solve = self._equilibrium.solve(series.load_at(weights), path_tolerance, begins_near=True)
            fault = None if solve.outcome.accepted else solve.outcome
            if fault is None and 2 * self._parameter(series, origin, solve.load) < a + beyond:
                fault = Outcome.DIVERGED  # to another equilibrium, before the point
        weights = series.weights(a, pade=is_pade)
        load = series.load_at(weights)
        self._move(series, origin, weights)
        fault, spent = fault or self._system.fault(), self._linear.factorizations - spent
        if fault is not None:
            self._system.set_state(origin)
            yield Solve(load, fault, (), spent)
            return
        self._system.set_load(load)
        yield Solve(load, Outcome.CONVERGED, (), spent, limit_point=True)
        yield Solve(load, Outcome.LIMIT_POINT, (), 0)

    def _limit(self, series: PowerSeries) -> float | None:
        """Return the parameter of the first maximum of the load in the range, or not far beyond it."""
        a, is_pade = series.range(_ACCURACY)
        return series.limit(_AHEAD * a, pade=is_pade)

    def _parameter(self, series: PowerSeries, origin: PETSc.Vec, load: float) -> float:
        """Return the parameter of the present state; collective."""
        x = self._system.state.x.petsc_vec
        length = float(self._system.comm.allreduce(series.states[0] @ (x.array - origin.array)))
        return length / series.scale**2 + float((load - series.load) * series.loads[0])

    def _prediction(self, origin: PETSc.Vec) -> Prediction:
        """Return the present state as a prediction, to be corrected by the present factors."""
        length = norm(self._system.state.x.petsc_vec)
        return Prediction(length, Increment(0.0, 0.0), origin.copy(), is_taken=True)

    def _parameter_at(self, series: PowerSeries, goal: float, end: float, *, is_pade: bool) -> float:
        """Return the parameter at which the load factor is ``goal``, or the end of the range before it."""

        def excess(a: float) -> float:
            return series.load_at(series.weights(a, pade=is_pade)) - goal

        low, high = 0.0, end
        if not np.isfinite(high):  # the path is straight
            return (goal - series.load) / float(series.loads[0])
        if excess(high) < 0:
            return high
        for _ in range(100):
            middle = (low + high) / 2
            low, high = (low, middle) if excess(middle) >= 0 else (middle, high)
        return high

    def _admissible(self, series: PowerSeries, origin: PETSc.Vec, a: float, *, is_pade: bool) -> float:
        """Return the part of a range in which no state of some has inverted elements, or leaves the law's domain."""
        for number in range(1, _CHECKS + 1):
            part = a * number / _CHECKS
            self._move(series, origin, series.weights(part, pade=is_pade))
            if self._system.fault() is not None:
                return a * (number - 0.5) / _CHECKS
        return a

    def _physical(self, series: PowerSeries, origin: PETSc.Vec, a: float, width: float, *, is_pade: bool) -> float:
        """Return the part of a range at whose end the state becomes unphysical, to a width in load factors."""
        low, high = 0.0, a
        low_load, high_load = series.load, series.load_at(series.weights(a, pade=is_pade))
        while high_load - low_load > width:
            middle = (low + high) / 2
            weights = series.weights(middle, pade=is_pade)
            load = series.load_at(weights)
            self._system.set_load(load)
            self._move(series, origin, weights)
            if self._system.fault_of_solution() is None:
                low, low_load = middle, load
            else:
                high, high_load = middle, load
        self._system.set_state(origin)
        return low

    def _move(self, series: PowerSeries, origin: PETSc.Vec, weights: Floats) -> None:
        x = origin.copy()
        x.array[:] += weights @ series.states
        self._system.set_state(x)
        x.destroy()

    def _reaches(self, series: PowerSeries, goal: float, error: float) -> bool:
        """Return whether a series reaches ``goal`` with no more than an error."""
        a, is_pade = series.range(_ACCURACY)
        if not np.isfinite(a):
            return True
        if series.load_at(series.weights(a, pade=is_pade)) < goal:
            return False
        return series.error(self._parameter_at(series, goal, a, is_pade=is_pade), pade=is_pade) <= error

    def _expand(self, load: float, goal: float, wanted: float, *, are_near: bool) -> PowerSeries | Outcome:
        """Return the series at the present state, or the reason why there is none.

        Args:
            goal: load factor to which it may lead.
            wanted: error there at which its orders end.
            are_near: whether the present factors belong to a tangent near the assembled one.
        """
        system, taylor = self._system, self._taylor
        step = system.state.copy()  # with ghosts
        b, x = system.rhs, system.rhs.duplicate()
        if failure := self._first_order(load, b, x, are_near=are_near):
            return failure
        t = x.array.copy()
        size = norm(x)
        # It shrinks where the body stiffens, and never grows: at a limit point the range would vanish.
        scale = self._scale = min(self._scale, size if size > _TINY else 1.0)
        first = 1 / np.sqrt((size / scale) ** 2 + 1)
        start = first * t
        coefficients = Coefficients(taylor.orders, len(t), load, scale, system.comm)
        coefficients.add(start, first)
        self._put(1, step, start, first)
        slope = (size / scale) ** 2 * first + first
        for k in range(2, taylor.orders + 1):
            with system.timings("residual"):
                taylor.assemble(k, b)
            b.scale(-1.0)
            self._system.supports.free(b.array)
            if failure := self._fault(b, x):
                return failure
            w = x.array.copy()
            load_rate = -float(system.comm.allreduce(w @ start)) / scale**2 / slope
            state = load_rate * t + w
            coefficients.add(state, load_rate)
            if (k >= _FEWEST and k % 2 == 0) or k == taylor.orders:
                series = coefficients.series()
                if k == taylor.orders or self._reaches(series, goal, wanted):
                    break
            self._put(k, step, state, load_rate)
        x.destroy()
        return series

    def _first_order(self, load: float, b: PETSc.Vec, x: PETSc.Vec, *, are_near: bool) -> Outcome | None:
        """Factorize where that is needed, and solve for the first order ``x``; return the reason why that failed."""
        linear, taylor, timings = self._linear, self._taylor, self._system.timings
        with timings("residual"):
            taylor.begin(_ORDERS, load)
        self._are_near = are_near and linear.has_factors
        if not self._are_near:
            linear.factorize()
        self._is_refined = linear.has_factors and (self._are_near or not linear.configuration.exact)
        self._contraction = 1.0
        if taylor.orders < _ORDERS:
            self._equilibrium.observer.failing([_memory_line(taylor)])
        with timings("residual"):
            taylor.put(1, None, 1.0)
            taylor.assemble(1, b)
        b.scale(-1.0)
        self._lift(b, load)
        if failure := self._fault(b, x):
            return failure
        if self._are_near and self._is_factorization_cheaper(taylor.orders):
            linear.factorize()
            self._are_near, self._is_refined = False, not linear.configuration.exact
        return None

    def _fault(self, b: PETSc.Vec, x: PETSc.Vec) -> Outcome | None:
        """Solve for the next order ``x``; return the reason why that failed."""
        linear = self._linear
        if not np.isfinite(norm(b)):
            return Outcome.NOT_FINITE
        while self._is_refined:
            if self._refine(b, x):
                return None
            self._is_refined = self._are_near and not linear.configuration.exact
            if self._is_refined:
                linear.factorize()
            self._are_near = False
        linear.become_exact()
        return None if linear.solve(b, x) else linear.failure

    def _put(self, order: int, step: Function, values: Floats, load_rate: float) -> None:
        """Give the residual the coefficients of the state of an order."""
        step.x.petsc_vec.array[:] = values
        step.x.scatter_forward()
        with self._system.timings("residual"):
            self._taylor.put(order, step.x.array, load_rate)

    def _is_factorization_cheaper(self, orders: int) -> bool:
        """Return whether factors of the present tangent save more time than they take, by the last refined solve."""
        least = 1 if self._linear.configuration.exact else _ROUNDED
        return (self._refinements - least) * orders > _CHEAPER * self._linear.choice.equal_solves

    def _refine(self, b: PETSc.Vec, x: PETSc.Vec) -> bool:
        """Solve with the assembled tangent by factors of one near it, or rounded ones; return whether that succeeded.

        The contraction in the last solve shows how many refinements a solve takes.
        """
        r, step, last, is_precise = b.copy(), b.duplicate(), 0.0, False
        x.set(0.0)
        with self._system.timings("linear solve"):
            for self._refinements in range(1, _REFINEMENTS + 1):
                self._linear.apply_factors(r, step)
                x.axpy(1.0, step)
                size = norm(step)
                self._contraction = size / last if last else self._contraction
                if not np.isfinite(size) or (last and self._contraction > _SLOW):
                    break
                is_precise, last = self._contraction * size <= _PRECISE * norm(x), size
                if is_precise:
                    break
                self._system.matrix.mult(x, r)
                r.aypx(-1.0, b)
        r.destroy()
        step.destroy()
        return is_precise

    def _lift(self, b: PETSc.Vec, load: float) -> None:
        """Set the rows of prescribed unknowns of ``b`` to their rates, and add what these cause in the others."""
        system, supports = self._system, self._system.supports
        self._system.supports.free(b.array)
        if supports.prescribe_motion:
            forces = b.copy()
            system.lift_path_rates(b, load)
            b.axpy(1.0, forces)
            forces.destroy()


def _memory_line(taylor: TaylorResidual) -> str:
    """Return the line on orders that are left out for lack of memory."""
    return (
        f"power series of {taylor.orders} orders instead of {_ORDERS}, for lack of memory:"
        f" each takes {taylor.order_bytes / 1e6:.3g} MB"
    )
