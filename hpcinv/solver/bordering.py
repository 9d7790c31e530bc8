"""Arc-length continuation: the path of equilibria (x, λ), also where the load factor λ turns.

From a point of the path the tangent ``t`` leads to a predictor, which Newton's method corrects in the plane normal to
it (Riks):

    R(x, λ) = 0,      t·(x - x_predicted) = 0.

Bordering solves this with the factors of ``K = ∂R/∂x`` alone: with ``K d = R`` and ``K g = -∂R/∂λ`` the correction is
``-d + g Δλ``, where ``Δλ = t·d / t·g`` keeps it in the plane. The length of the path is measured in x only (Crisfield),
so that ``dλ/ds = 1/t·g``, which changes sign at a turning point of the load. ∂R/∂λ is a difference quotient, exact
for loads in proportion to λ; it directs the iteration, and does not enter its result.

PETSc's SNESNEWTONAL has the same constraint, but steps of one fixed length; it neither goes back from a step that
failed or that would turn an element inside out, nor keeps a tangent, nor looks for turning points.

Sources: Riks, Int. J. Solids Struct. 15, 529–551, 1979, doi:10.1016/0020-7683(79)90081-7;
Crisfield, Comput. Struct. 13, 55–62, 1981, doi:10.1016/0045-7949(81)90108-5;
Keller, *Lectures on Numerical Methods in Bifurcation Problems*, 1987 (bordering).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from hpcinv.model.outcome import Outcome
from hpcinv.parallel.petsc_vectors import dot, norm
from hpcinv.solver.newton import NewtonIteration, NewtonMonitor

if TYPE_CHECKING:
    from petsc4py import PETSc


class ParametrisedSystem(Protocol):
    """``R(x, λ) = 0`` at a state x and a load factor λ that it keeps, and its tangent."""

    def position(self) -> PETSc.Vec: ...
    def set_state(self, x: PETSc.Vec) -> None: ...
    def set_load(self, load: float) -> None: ...
    def residual(self, b: PETSc.Vec) -> None: ...
    def tangent(self) -> None: ...
    def fault(self) -> Outcome | None: ...
    def fault_of_solution(self) -> Outcome | None: ...


class TangentSolver(Protocol):
    """Solves with the tangent that the system assembled last."""

    def solve(self, b: PETSc.Vec, x: PETSc.Vec) -> bool: ...
    def sign_of_determinant(self) -> int: ...


class Equations(Protocol):
    """A system and its linear solver, and requests to stop."""

    @property
    def system(self) -> ParametrisedSystem: ...
    @property
    def linear(self) -> TangentSolver: ...
    def interrupted(self) -> bool: ...


@dataclass(frozen=True)
class Tangent:
    """Direction of the path at one of its points: unit vector ``t``, and ``dλ/ds`` along it."""

    direction: PETSc.Vec
    slope: float


@dataclass
class Corrected:
    """What one correction did: the point that it ended at, and what it took."""

    outcome: Outcome
    x: PETSc.Vec
    load: float
    iterations: tuple[NewtonIteration, ...]
    factorizations: int
    signs: tuple[int, ...]


class Bordering:
    """Newton's method for the equations and one constraint, and the tangent of their path.

    Args:
        equations: what is solved.
        limit, reuse: as for `NewtonMonitor`.
        cases: number of load cases; where one ends, ∂R/∂λ jumps.
    """

    def __init__(self, equations: Equations, like: PETSc.Vec, *, limit: int, reuse: float, cases: int = 1) -> None:
        self.equations, self.limit, self.reuse, self.cases = equations, limit, reuse, cases
        # residual, its change with the load, K⁻¹ of both, and a trial
        self._r, self._r_load, self._d, self._g, self._trial = (like.duplicate() for _ in range(5))

    def tangent(self, x: PETSc.Vec, load: float, along: PETSc.Vec | None, direction: int = 1) -> Tangent | None:
        """Tangent of the path at one of its points, with new factors; ``None`` if these are singular.

        Args:
            along: a vector that the tangent shall make an acute angle with; without it, λ shall
            direction: grow (1) or fall (-1) along it.
        """
        self.equations.system.set_state(x)
        if not self._linearise(load, direction):
            return None
        return self.present_tangent(along, direction)

    def present_tangent(self, along: PETSc.Vec | None, direction: int = 1) -> Tangent:
        """The same with the factors at hand, which are of a state nearby."""
        g = self._g.copy()
        length = norm(g)
        sign = direction if along is None else math.copysign(1, dot(along, g))
        if length == 0.0:  # the state does not depend on the load
            return Tangent(g, sign * math.inf)
        g.scale(sign / length)
        return Tangent(g, sign / length)

    def correct(
        self, x: PETSc.Vec, load: float, t: PETSc.Vec, tolerance: float, *, direction: int, scale: float
    ) -> Corrected:
        """Newton's method from ``(x, load)`` in the plane through x normal to ``t``; it fails where corrections grow.

        Args:
            tolerance: estimated error of x relative to its norm, and of the load factor relative to ``scale``.
            direction: of the load factor, where it is at the end of a load case.
        """
        equations = self.equations
        # A shorter step is always at hand, and an iteration that has wandered may end on another path.
        monitor = NewtonMonitor(tolerance, self.limit, self.reuse, growths_allowed=0)
        x, outcome, fault = x.copy(), None, None
        signs: list[int] = []
        factorizations = 0
        self._residual(x, load, self._r)
        if not math.isfinite(norm(self._r)):
            outcome = Outcome.NOT_FINITE
        while outcome is None:
            if equations.interrupted():
                outcome = Outcome.INTERRUPTED
                break
            fresh = monitor.wants_new_tangent
            if fresh:
                factorizations += 1
                equations.system.set_state(x)
                if not self._linearise(load, direction):
                    outcome = Outcome.LINEAR_SOLVER
                    break
                if sign := equations.linear.sign_of_determinant():
                    signs.append(sign)
            if not equations.linear.solve(self._r, self._d):
                outcome = Outcome.LINEAR_SOLVER
                break
            along = dot(t, self._g)
            if along == 0.0:  # the tangent has grown beyond all numbers
                outcome = Outcome.NOT_FINITE
                break
            change = dot(t, self._d) / along
            self._d.axpy(-change, self._g)
            size = math.hypot(norm(self._d), norm(x) * change / scale)
            taken, fault = self._admissible(x)
            x.axpy(-taken, self._d)
            load += taken * change
            self._residual(x, load, self._r)
            outcome = monitor.judge(NewtonIteration(size, norm(x), norm(self._r), fresh))
        if outcome in (Outcome.ITERATION_LIMIT, Outcome.DIVERGED):
            outcome = fault or outcome
        if outcome.accepted:
            equations.system.set_state(x)
            outcome = equations.system.fault() or equations.system.fault_of_solution() or outcome
        return Corrected(outcome, x, load, tuple(monitor.history), factorizations, tuple(signs))

    def _residual(self, x: PETSc.Vec, load: float, b: PETSc.Vec) -> None:
        self.equations.system.set_state(x)
        self.equations.system.set_load(load)
        self.equations.system.residual(b)

    def _linearise(self, load: float, direction: int) -> bool:
        """Factorize K at the present state and solve ``K g = -∂R/∂λ``; false if that failed."""
        equations = self.equations
        equations.system.set_load(load)
        equations.system.residual(self._trial)
        h = self._difference_step(load, direction)
        equations.system.set_load(load + h)
        equations.system.residual(self._r_load)
        equations.system.set_load(load)
        self._r_load.axpy(-1.0, self._trial)
        self._r_load.scale(-1 / h)
        equations.system.tangent()
        return equations.linear.solve(self._r_load, self._g)

    def _difference_step(self, load: float, direction: int) -> float:
        """Change of the load factor towards the middle of the load case that lies in this direction."""
        position = load * self.cases
        case = math.floor(position + direction * 1e-9)
        middle = min(max(case, 0), self.cases - 1) + 0.5
        return math.copysign(1e-3, middle - position) / self.cases

    def _admissible(self, x: PETSc.Vec) -> tuple[float, Outcome | None]:
        """Share of the correction that may be taken, halved at most ten times, and what kept it short."""
        share, fault = 1.0, None
        for _ in range(10):
            x.copy(self._trial)
            self._trial.axpy(-share, self._d)
            self.equations.system.set_state(self._trial)
            found = self.equations.system.fault()
            if found is None:
                break
            fault, share = found, share / 2
        return share, fault

    def destroy(self) -> None:
        """Free what PETSc holds."""
        for vector in (self._r, self._r_load, self._d, self._g, self._trial):
            vector.destroy()
