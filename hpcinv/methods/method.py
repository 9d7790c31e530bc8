"""Interface of the solution methods, and the state from which they start."""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, replace

from dolfinx.fem import Function

from hpcinv.mesh.source import Floats
from hpcinv.model.outcome import Outcome
from hpcinv.solver.equations import Equations
from hpcinv.solver.equilibrium import Equilibrium
from hpcinv.solver.newton import Solve

NESTED = "nested iteration"
"""Strategy of a solve that begins with the solution on coarser cells."""


@dataclass(frozen=True)
class Guess:
    """Initial state at full load, of a similar problem or extrapolated: local values of the fields, ghosts included.

    Attributes:
        displacement: values of the degrees of freedom of the displacement, in m.
        pressure: values of the degrees of freedom of the pressure, in Pa; ``None`` in the displacement form.
        sign: sign of the tangent's determinant in the similar problem's solution, 0 if it is not known.
        strategy: name of the solve from it, for reports.
    """

    displacement: Floats
    pressure: Floats | None
    sign: int = 0
    strategy: str = "guess"

    def solve(self, equations: Equations, equilibrium: Equilibrium) -> Solve:
        """Solve equations at full load from the guess.

        The solution is not accepted where the tangent's determinant has another sign than in the similar problem: a
        limit point or a branching point lies between the two, and the path from the unloaded body has another solution.
        """
        u, p = equations.unloaded().fields
        u.x.array[:] = self.displacement
        if p is not None:
            p.x.array[:] = self.pressure
        equations.put_fields((u, p))
        solve = equilibrium.solve(1.0, equations.job.solver.tolerance, begins_near=True)
        solve = replace(solve, strategy=self.strategy)
        if solve.outcome.accepted and self.sign and solve.signs and solve.signs[-1] != self.sign:
            return replace(solve, outcome=Outcome.ANOTHER_PATH)
        return solve


@dataclass(frozen=True)
class Start:
    """Start of the solution in one direction, by default the unloaded body.

    Attributes:
        solution: displacement (m) and pressure (Pa; ``None`` in the displacement form) of a checkpoint.
        load: share of the load under which that is a solution.
        solves: completed solves up to there.
        guess: initial state at full load, for methods that can use it; after a failure, the unloaded body is used.
        origin: displacement (m) and pressure (Pa) at which the load path begins; without it, with the unloaded body.
    """

    solution: tuple[Function, Function | None] | None = None
    load: float = 0.0
    solves: tuple[Solve, ...] = ()
    guess: Guess | None = None
    origin: tuple[Function, Function | None] | None = None

    @property
    def is_unloaded(self) -> bool:
        """True for the unloaded body, where nothing is known."""
        return self.solution is None and self.guess is None and self.origin is None and not self.solves


UNLOADED = Start()


class Method(ABC):
    """A path from the unloaded body, or from a checkpoint, to the solution of one direction.

    Attributes:
        reached: share of the load under which the present state is a solution; 1 only at the end.
    """

    equilibrium: Equilibrium
    reached: float = 0.0

    @abstractmethod
    def solves(self, start: Start = UNLOADED) -> Iterator[Solve]:
        """Yield every solve; the last one is accepted, or its outcome is the reason why the method ended.

        Whenever it yields, the mesh is at the coordinates of the job. The equations must be in ``start.solution``, or
        unloaded without one.
        """

    @abstractmethod
    def can_restart_after(self, solve: Solve) -> bool:
        """Return whether a run can be resumed from the state after a solve that was just yielded."""

    @abstractmethod
    def min_mesh_J(self) -> float:
        """Return the smallest determinant of the map from the mesh to the unknown body."""
