"""Initial state at full load: the solution of a similar problem, or an extrapolation of several solutions."""

from dataclasses import dataclass, replace

from hpcinv.mesh.source import Floats
from hpcinv.model.outcome import Outcome
from hpcinv.solver.equilibrium import Equilibrium
from hpcinv.solver.newton import Solve
from hpcinv.solver.problem import Model


@dataclass(frozen=True)
class Guess:
    """Local values of the fields on each rank, ghosts included.

    Attributes:
        displacement: values of the degrees of freedom of the displacement, in m.
        pressure: values of the degrees of freedom of the pressure, in Pa; ``None`` in the displacement form.
        sign: sign of the tangent's determinant in the similar problem's solution, 0 if it is not known.
    """

    displacement: Floats
    pressure: Floats | None
    sign: int = 0

    def solve(self, model: Model, equilibrium: Equilibrium) -> Solve:
        """Solve the equations of a model at full load from the guess.

        The solution is not accepted where the tangent's determinant has another sign than in the similar problem: a
        limit point or a branching point lies between the two, and the path from the unloaded body has another solution.
        """
        u, p = model.solution()
        u.x.array[:] = self.displacement
        if p is not None:
            p.x.array[:] = self.pressure
        model.set_solution(u, p)
        solve = equilibrium.solve(1.0, model.job.solver.tolerance, begins_near=True)
        solve = replace(solve, strategy="guess")
        if solve.outcome.accepted and self.sign and solve.signs and solve.signs[-1] != self.sign:
            return replace(solve, outcome=Outcome.ANOTHER_PATH)
        return solve
