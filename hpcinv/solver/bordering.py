"""Predictor and corrector of arc-length continuation: the path of equilibria (x, λ), through limit points of the load.

From a point of the path the predictor is a step along the tangent ``t``, and Newton's method is the corrector, in the
plane normal to the tangent (Riks):

    R(x, λ) = 0,      t·(x - x_predicted) = 0.

Bordering solves this with the factors of ``K = ∂R/∂x`` alone: with ``K d = R`` and ``K g = -∂R/∂λ`` the correction is
``-d + g Δλ``, where ``Δλ = t·d / t·g`` keeps it in the plane. The length of the path is measured in x only (Crisfield),
so that ``dλ/ds = 1/t·g``, which changes sign at a limit point of the load. ∂R/∂λ is a difference quotient, exact
for loads in proportion to λ; it affects the convergence, not the result.

PETSc's SNESNEWTONAL has the same constraint, but steps of fixed length; it neither repeats a step that failed or that
would turn an element inside out, nor keeps a tangent, nor finds limit points.

Sources: Riks, Int. J. Solids Struct. 15, 529–551, 1979, doi:10.1016/0020-7683(79)90081-7;
Crisfield, Comput. Struct. 13, 55–62, 1981, doi:10.1016/0045-7949(81)90108-5;
Keller, *Lectures on Numerical Methods in Bifurcation Problems*, 1987 (bordering).
"""

import math
from dataclasses import dataclass

from petsc4py import PETSc

from hpcinv.model.outcome import Outcome
from hpcinv.parallel.petsc_vectors import dot, norm
from hpcinv.solver.equilibrium import Equilibrium
from hpcinv.solver.newton import NewtonIteration, NewtonMonitor, Solve

_ROUNDED = 1e-9
"""Rate of the state, relative to its floor at full load, that is the rounding error of the difference quotient ∂R/∂λ.
With a larger one, states that depend on the load a little are landed on without a prediction."""


@dataclass(frozen=True)
class BorderedTangent:
    """Direction of the path at one of its points: unit vector ``t``, and ``dλ/ds`` along it."""

    direction: PETSc.Vec
    slope: float


def tangent_along(g: PETSc.Vec, chord: PETSc.Vec | None, direction: int = 1) -> BorderedTangent:
    """Return the tangent of the path from ``g = -K⁻¹ ∂R/∂λ``; arguments as for `Bordering.tangent`."""
    g = g.copy()
    length = norm(g)
    sign = direction if chord is None else math.copysign(1, dot(chord, g))
    if length == 0.0:  # the state does not depend on the load
        return BorderedTangent(g, sign * math.inf)
    g.scale(sign / length)
    return BorderedTangent(g, sign / length)


@dataclass(frozen=True)
class Corrected:
    """Result of one run of the corrector: its report, with the load where it ended, and the state there.

    Attributes:
        g: ``-K⁻¹ ∂R/∂λ`` of the last tangent; ``None`` if the outcome is not accepted.
    """

    solve: Solve
    x: PETSc.Vec
    g: PETSc.Vec | None = None


class Bordering:
    """Newton's method for the equations and one constraint, and the tangent of their path.

    Args:
        cases: number of load cases; ∂R/∂λ jumps at the end of each.
    """

    def __init__(self, equations: Equilibrium, cases: int = 1) -> None:
        self.equations, self.cases = equations, cases
        self._floor = equations.floor(1.0)
        # residual, its negative derivative by the load factor, K⁻¹ times both, and the residual that was solved for
        self._r, self._r_load, self._d, self._g, self._r_here = (equations.system.position() for _ in range(5))

    def tangent(self, x: PETSc.Vec, load: float, chord: PETSc.Vec | None, direction: int = 1) -> BorderedTangent | None:
        """Return the tangent of the path at one of its points, with new factors; ``None`` if these are singular.

        Args:
            chord: a vector with which the tangent makes an acute angle; without it, ``direction`` orients the tangent.
            direction: 1 if λ grows along the tangent, -1 if it falls.
        """
        self.equations.system.set_state(x)
        if not self._linearise(load, direction):
            return None
        if self._floor.exceeds(norm(self._g), _ROUNDED):
            self._g.set(0.0)
        self.equations.system.set_load(load)
        return tangent_along(self._g, chord, direction)

    def correct(
        self, x: PETSc.Vec, load: float, t: PETSc.Vec, tolerance: float, *, direction: int, scale: float
    ) -> Corrected:
        """Solve from ``(x, load)`` in the plane through x normal to ``t``; fail where corrections grow.

        Args:
            tolerance: estimated error of x relative to its norm, and of the load factor relative to ``scale``.
            direction: 1 or -1, direction of the load factor, which matters at the end of a load case.
        """
        equations = self.equations
        # The step can be shortened instead, and an iteration whose corrections grow may end on another path.
        floor = equations.floor()
        monitor = NewtonMonitor(tolerance, equations.limit, equations.reuse, growths_allowed=0, floor=floor)
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
            fresh = monitor.needs_new_tangent
            if fresh:
                factorizations += 1
                equations.system.set_state(x)
                if not self._linearise(load, direction):
                    outcome = equations.linear.failure
                    break
                if sign := equations.linear.sign_of_determinant():
                    signs.append(sign)
            if not equations.linear.solve(self._r, self._d):
                outcome = equations.linear.failure
                break
            projection = dot(t, self._g)
            if projection == 0.0:  # underflow: the tangent exceeds the range of numbers
                outcome = Outcome.NOT_FINITE
                break
            change = dot(t, self._d) / projection
            self._d.axpy(-change, self._g)
            size = math.hypot(norm(self._d), norm(x) * change / scale)
            taken, fault = equations.system.admissible_share(x, self._d)
            x.axpy(-taken, self._d)
            load += taken * change
            self._residual(x, load, self._r)
            outcome = monitor.judge(NewtonIteration(size, norm(x), norm(self._r), fresh))
        if outcome in (Outcome.ITERATION_LIMIT, Outcome.DIVERGED):
            outcome = fault or outcome
        if outcome.accepted:
            equations.system.set_state(x)
            outcome = equations.system.fault() or equations.system.fault_of_solution() or outcome
        g = self._g.copy() if outcome.accepted else None
        return Corrected(Solve(load, outcome, tuple(monitor.history), factorizations, tuple(signs)), x, g)

    def _residual(self, x: PETSc.Vec, load: float, b: PETSc.Vec) -> None:
        self.equations.system.set_state(x)
        self.equations.system.set_load(load)
        self.equations.system.residual(b)

    def _linearise(self, load: float, direction: int) -> bool:
        """Factorize K at the present state and solve ``K g = -∂R/∂λ``; return whether that succeeded."""
        equations = self.equations
        equations.system.set_load(load)
        equations.system.residual(self._r_here)
        h = self._difference_step(load, direction)
        equations.system.set_load(load + h)
        equations.system.residual(self._r_load)
        equations.system.set_load(load)
        self._r_load.axpy(-1.0, self._r_here)
        self._r_load.scale(-1 / h)
        equations.system.tangent()
        return equations.linear.solve(self._r_load, self._g)

    def _difference_step(self, load: float, direction: int) -> float:
        """Return a small change of the load factor towards the middle of the load case in this direction."""
        position = load * self.cases
        case = math.floor(position + direction * 1e-9)
        middle = min(max(case, 0), self.cases - 1) + 0.5
        return math.copysign(1e-3, middle - position) / self.cases

    def destroy(self) -> None:
        for vector in (self._r, self._r_load, self._d, self._g, self._r_here):
            vector.destroy()
