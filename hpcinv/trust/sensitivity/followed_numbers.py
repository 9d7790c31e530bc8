"""Derivatives of unknown numbers of loads and supports, which follow a parameter with the state.

With their equations ``C(x, q; θ) = 0``, state and numbers follow a parameter θ as

    K dx/dθ + ∂R/∂q dq/dθ = -∂R/∂θ,      B dx/dθ + ∂C/∂q dq/dθ = -∂C/∂θ,

which is solved with the factors of K (`hpcinv.solver.bordered_solver`).
"""

import numpy as np
from petsc4py import PETSc

from hpcinv.errors import SolveError
from hpcinv.job.sensitivities import Parameter
from hpcinv.mesh.source import Floats
from hpcinv.results.solution import Solution
from hpcinv.solver.bordered_solver import BorderedSolver
from hpcinv.solver.constraints import solved_borders
from hpcinv.solver.equations import Equations
from hpcinv.solver.equilibrium import Equilibrium


class FollowedNumbers:
    """The unknown numbers of a solution, which the equations are in; there may be none. Methods are collective.

    Attributes:
        count: number of them, and of their equations.
        assumption: of derivatives on contacts, in words; empty without any.

    Raises:
        SolveError: on all ranks, if the tangent is singular.
    """

    assumption = ""

    def __init__(self, equations: Equations, solution: Solution, equilibrium: Equilibrium) -> None:
        self._solution = solution
        self._borders = solved_borders(solution.job, solution.constraints, equations, equilibrium.system)
        self.count = sum(border.count for border in self._borders)
        self._bordered = BorderedSolver(equilibrium.system, equilibrium.linear, self._borders)
        if not self._bordered.linearise(1.0):
            raise _singular()

    def solve(self, b: PETSc.Vec, by_parameter: Floats, x: PETSc.Vec) -> Floats:
        """Set ``x`` to the derivative of the state by a parameter.

        Args:
            b: ``-∂R/∂θ``.
            by_parameter: ``∂C/∂θ``.

        Returns:
            Derivatives (SI) of the unknown numbers, as the reports of the solution have them.

        Raises:
            SolveError: on all ranks, if the tangent is singular.
        """
        try:
            change = self._bordered.solve_refined(b, -by_parameter, x)
        except np.linalg.LinAlgError:
            change = None
        if change is None:
            raise _singular()
        units = np.concatenate([np.zeros(0), *(border.units for border in self._borders)])
        return np.asarray(-change * units)

    def rates(self, parameter: Parameter) -> Floats:
        """Return the explicit derivatives of C by a number of the job, zero for parameters that it does not have."""
        job = self._solution.job
        return np.concatenate([np.zeros(0), *(border.rates(parameter, job) for border in self._borders)])

    def force_rates(self, rates: Floats) -> Floats:
        """Return the derivatives of C along rates of the nodal forces (scaled) of the owned unknowns."""
        return np.concatenate([np.zeros(0), *(border.force_rates(rates) for border in self._borders)])

    def equations(self) -> Floats:
        """Return C on the mesh as it lies, where motions of regions do not change."""
        return np.concatenate([np.zeros(0), *(border.equations_on_mesh(1.0) for border in self._borders)])

    def destroy(self) -> None:
        """Free PETSc objects."""
        self._bordered.destroy()
        for border in self._borders:
            border.destroy()


def _singular() -> SolveError:
    return SolveError(
        "sensitivities: the tangent at the solution is singular, so that there are no derivatives there",
        "Leave the section 'sensitivities' out, or take a load at which the solution is not at a limit point.",
    )
