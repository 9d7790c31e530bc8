"""Predictor and corrector of arc-length continuation: the path of equilibria (x, λ), through limit points of the load.

From a point of the path the predictor is a step along the tangent ``t``. Newton's method is the corrector, in the plane
normal to the tangent, with the load factor as one of its unknown numbers (`hpcinv.solver.constraints.path_load`). The
length of the path is measured in x only (Crisfield). So ``dλ/ds = 1/t·g`` with ``g = dx/dλ``, which changes sign at a
limit point of the load. ∂R/∂λ is a difference quotient, exact for loads in proportion to λ; it affects the convergence,
not the result.

PETSc's SNESNEWTONAL has the same constraint, but steps of fixed length; it neither repeats a step that failed or that
would turn an element inside out, nor keeps a tangent, nor finds limit points.

Sources: Riks, Int. J. Solids Struct. 15, 529–551, 1979, doi:10.1016/0020-7683(79)90081-7;
Crisfield, Comput. Struct. 13, 55–62, 1981, doi:10.1016/0045-7949(81)90108-5.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from petsc4py import PETSc

from hpcinv.base.parallel.petsc_vectors import dot, norm
from hpcinv.model.outcome import Outcome
from hpcinv.solver.bordered_solver import BorderedSolver
from hpcinv.solver.constraints.path_load import PathLoad
from hpcinv.solver.equilibrium import Equilibrium
from hpcinv.solver.newton import Solve

_ROUNDED = 1e-9
"""Rate of the state, relative to its floor at full load, that is the rounding error of the difference quotient ∂R/∂λ.
With a larger one, states that depend on the load a little are landed on without a prediction."""


@dataclass(frozen=True)
class BorderedTangent:
    """Direction of the path at one of its points: unit vector ``t``, and ``dλ/ds`` along it."""

    direction: PETSc.Vec
    slope: float


def tangent_along(g: PETSc.Vec, chord: PETSc.Vec | None, direction: int = 1) -> BorderedTangent:
    """Return the tangent of the path from ``g = dx/dλ``; arguments as for `Bordering.tangent`."""
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
        g: ``dx/dλ`` of the last tangent; ``None`` if the outcome is not accepted.
    """

    solve: Solve
    x: PETSc.Vec
    g: PETSc.Vec | None = None


class Bordering:
    """Newton's method for the equations and one constraint, and the tangent of their path.

    Args:
        cases: number of load cases; ∂R/∂λ jumps at the end of each.
    """

    def __init__(self, equilibrium: Equilibrium, cases: int = 1) -> None:
        self.equilibrium = equilibrium
        self._floor = equilibrium.floor(1.0)
        system, others = equilibrium.system, equilibrium.numbers
        self._plane = PathLoad(system, others, cases)
        self._numbers = BorderedSolver(system, equilibrium.linear, [*others.borders, self._plane])

    def tangent(self, x: PETSc.Vec, load: float, chord: PETSc.Vec | None, direction: int = 1) -> BorderedTangent | None:
        """Return the tangent of the path at one of its points, with new factors; ``None`` if these are singular.

        Args:
            chord: a vector with which the tangent makes an acute angle; without it, ``direction`` orients the tangent.
            direction: 1 if λ grows along the tangent, -1 if it falls.
        """
        plane, system = self._plane, self.equilibrium.system
        plane.t, plane.load, plane.direction = None, load, direction
        system.set_state(x)
        self._numbers.put(load)
        if not self._numbers.linearise(load) or (g := self._path()) is None:
            return None
        if self._floor.exceeds(norm(g), _ROUNDED):
            g.set(0.0)
        return tangent_along(g, chord, direction)

    def correct(
        self, x: PETSc.Vec, load: float, t: PETSc.Vec, tolerance: float, *, direction: int, scale: float
    ) -> Corrected:
        """Solve from ``(x, load)`` in the plane through x normal to ``t``; fail where corrections grow.

        The state is the one that was found, or ``x``.

        Args:
            tolerance: estimated error of x relative to its norm, and of the load factor relative to ``scale``.
            direction: 1 or -1, direction of the load factor, which matters at the end of a load case.
        """
        plane, equilibrium = self._plane, self.equilibrium
        plane.t, plane.load, plane.direction, plane.scale = t, load, direction, scale
        equilibrium.system.set_state(x)
        # The step can be shortened instead, and an iteration whose corrections grow may end on another path.
        solve = equilibrium.solve(load, tolerance, numbers=self._numbers, growths_allowed=0)
        g = self._path() if solve.outcome.accepted else None
        if g is None and solve.outcome.accepted:
            solve = replace(solve, outcome=Outcome.LINEAR_SOLVER)
        return Corrected(solve, equilibrium.system.position(), g)

    def _path(self) -> PETSc.Vec | None:
        """Return ``dx/dλ``, ``None`` where it does not exist."""
        try:
            return self._numbers.path()
        except np.linalg.LinAlgError:
            return None

    def destroy(self) -> None:
        self._numbers.destroy()
