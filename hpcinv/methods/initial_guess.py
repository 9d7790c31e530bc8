"""A state to begin with at full load: that of a similar problem, or what several of them foretell."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from hpcinv.model.outcome import Outcome

if TYPE_CHECKING:
    from hpcinv.mesh.source import Floats
    from hpcinv.solver.equilibrium import Equilibrium, Solve
    from hpcinv.solver.problem import Model


@dataclass(frozen=True)
class Guess:
    """Local values of the fields on each rank, ghosts included.

    Attributes:
        displacement: of the displacement's degrees of freedom, in m.
        pressure: of the pressure's, in Pa; ``None`` in the displacement form.
        sign: that of the tangent's determinant in the similar problem's solution, 0 where it is not known.
    """

    displacement: Floats
    pressure: Floats | None
    sign: int = 0

    def begin(self, model: Model) -> None:
        """Make it the state of a model."""
        u, p = model.solution()
        u.x.array[:] = self.displacement
        if p is not None:
            p.x.array[:] = self.pressure
        model.set_solution(u, p)

    def follow(self, equilibrium: Equilibrium, tolerance: float) -> Solve:
        """One solve at full load from the present state, the guess.

        It is not accepted where the tangent's determinant has another sign than in the similar problem: between the
        two there is a limit point or a branching point, and on the path from the unloaded body lies another solution.
        """
        solve = replace(equilibrium.solve(1.0, tolerance, begins_near=True), strategy="guess")
        if solve.outcome.accepted and self.sign and solve.signs and solve.signs[-1] != self.sign:
            return replace(solve, outcome=Outcome.ANOTHER_PATH)
        return solve
