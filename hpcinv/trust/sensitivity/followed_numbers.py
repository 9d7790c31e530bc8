"""Derivatives of unknown pressures of cavities and of unknown motions, which follow a parameter with the state.

With their equations ``C(x, q; θ) = 0``, state and numbers follow a parameter θ as

    K dx/dθ + ∂R/∂q dq/dθ = -∂R/∂θ,      B dx/dθ + ∂C/∂q dq/dθ = -∂C/∂θ,

which is solved with the factors of K (`hpcinv.solver.bordered_solver`).
"""

from collections.abc import Mapping

import numpy as np
from petsc4py import PETSc

from hpcinv.errors import SolveError
from hpcinv.job.cavities import Cavity
from hpcinv.job.sections import Support
from hpcinv.job.sensitivities import Parameter
from hpcinv.job.states import StateSpec
from hpcinv.mesh.source import Floats
from hpcinv.results.solution import Solution
from hpcinv.results.unknown_numbers import solved_cavities, solved_motions
from hpcinv.solver.bordered_solver import BorderedSolver
from hpcinv.solver.cavity_border import CavityBorder
from hpcinv.solver.equations import Equations
from hpcinv.solver.equilibrium import Equilibrium


class FollowedNumbers:
    """The unknown numbers of a solution, which the equations are in; there may be none. Methods are collective.

    Attributes:
        count: number of them, and of their equations.

    Raises:
        SolveError: on all ranks, if the tangent is singular.
    """

    def __init__(self, equations: Equations, solution: Solution, equilibrium: Equilibrium) -> None:
        self._equations, self._solution, self._system = equations, solution, equilibrium.system
        self._motions = solved_motions(equations, solution, self._system)
        self._cavities = solved_cavities(equations, solution, self._system.weak_form)
        self._pressures = CavityBorder(self._system, self._cavities) if self._cavities else None
        self._borders = [*self._motions, *([self._pressures] if self._pressures else [])]
        self.count = sum(border.count for border in self._borders)
        self._bordered = BorderedSolver(equilibrium.system, equilibrium.linear, self._borders)
        if not self._bordered.linearise(1.0):
            raise _singular()

    def solve(self, b: PETSc.Vec, by_parameter: Floats, x: PETSc.Vec) -> Mapping[str, float]:
        """Set ``x`` to the derivative of the state by a parameter.

        Args:
            b: ``-∂R/∂θ``.
            by_parameter: ``∂C/∂θ``.

        Returns:
            Derivatives of the unknown pressures (Pa) by the names of the cavities.

        Raises:
            SolveError: on all ranks, if the tangent is singular.
        """
        try:
            change = self._bordered.solve_refined(b, -by_parameter, x)
        except np.linalg.LinAlgError:
            change = None
        if change is None:
            raise _singular()
        stress, first = self._equations.scales.stress, self.count - len(self._cavities)
        return {cavity.name: -float(dq) * stress for cavity, dq in zip(self._cavities, change[first:], strict=True)}

    def rates(self, parameter: Parameter) -> Floats:
        """Return the explicit derivatives of C by a number of a cavity or a remote load, zero for other parameters."""
        owner, place, job = parameter.owner, parameter.place, self._solution.job
        parts = [np.zeros(border.count) for border in self._borders]
        if isinstance(owner, Support) and place[0] == "remote" and parameter.where in job.owners:
            key, axis = str(place[1]), int(place[2])
            for number, report in enumerate(self._solution.remote_loads):
                if parameter.where == f"{job.place('supports')}[{report.support}]":
                    parts[number] = self._motions[number].number_rates(key, axis)
        if self._cavities and isinstance(owner, Cavity):
            parts[-1] = self._cavity_rates(parameter.where.removeprefix("cavities."), parameter)
        if self._cavities and isinstance(owner, StateSpec) and owner.name == job.state:
            parts[-1] = self._cavity_rates(str(place[1]), parameter)
        return np.concatenate([np.zeros(0), *parts])

    def _cavity_rates(self, name: str, parameter: Parameter) -> Floats:
        return np.array([c.number_rate(parameter.place) if c.name == name else 0.0 for c in self._cavities])

    def force_rates(self, rates: Floats) -> Floats:
        """Return the derivatives of C along rates of the nodal forces (scaled) of the owned unknowns."""
        return np.concatenate([np.zeros(0), *(border.force_rates(rates) for border in self._borders)])

    def equations(self) -> Floats:
        """Return C on the mesh as it lies, where motions of regions do not change."""
        motions = [motion.equations(1.0) for motion in self._motions]
        cavities = solved_cavities(self._equations, self._solution, self._system.weak_form)
        return np.concatenate([*motions, np.array([cavity.evaluate(1.0)[0] for cavity in cavities])])

    def destroy(self) -> None:
        """Free PETSc objects."""
        self._bordered.destroy()
        if self._pressures is not None:
            self._pressures.destroy()


def _singular() -> SolveError:
    return SolveError(
        "sensitivities: the tangent at the solution is singular, so that there are no derivatives there",
        "Leave the section 'sensitivities' out, or take a load at which the solution is not at a limit point.",
    )
