"""Interface of the solution methods, and the state from which they start."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace

from dolfinx.fem import Function

from hpcinv.base.parallel.petsc_vectors import norm
from hpcinv.mesh.source import Floats
from hpcinv.model.contact_reports import SlipHistory
from hpcinv.model.outcome import Outcome
from hpcinv.solver.equations import Equations
from hpcinv.solver.equilibrium import Equilibrium
from hpcinv.solver.equilibrium_path import Solves
from hpcinv.solver.newton import Solve, Tolerance
from hpcinv.solver.predictor import Increment, Prediction

NESTED = "nested iteration"
"""Strategy of a solve that begins with the solution on coarser cells."""
GUESS = "guess"
"""Strategy of a solve that begins with a solution of a similar problem."""


@dataclass(frozen=True)
class Guess:
    """Initial state at full load, of a similar problem or extrapolated: local values of the fields, ghosts included.

    Attributes:
        displacement: values of the degrees of freedom of the displacement, in m.
        pressure: values of the degrees of freedom of the pressure, in Pa; ``None`` in the displacement form.
        sign: sign of the tangent's determinant in the similar problem's solution, 0 if it is not known.
        strategy: name of the solve from it, for reports.
        keeps_factors: whether the error is so small that factors of the similar problem may correct it.
    """

    displacement: Floats
    pressure: Floats | None
    sign: int = 0
    strategy: str = GUESS
    keeps_factors: bool = False

    def solve(self, equations: Equations, equilibrium: Equilibrium, tolerance: Tolerance | None = None) -> Solve:
        """Solve equations at full load from the guess.

        The solution is not accepted where the tangent's determinant has another sign than in the similar problem: a
        limit point or a branching point lies between the two, and the path from the unloaded body has another solution.

        Args:
            tolerance: estimated error of the solution, as in `NewtonMonitor`; the job's without it.
        """
        u, p = equations.unloaded().fields
        u.x.array[:] = self.displacement
        if p is not None:
            p.x.array[:] = self.pressure
        equations.put_fields((u, p))
        equilibrium.numbers.recover(1.0)
        predicted = self._prediction(equilibrium) if self.keeps_factors else None
        wanted = equations.job.solver.tolerance if tolerance is None else tolerance
        solve = equilibrium.solve(1.0, wanted, predicted=predicted, begins_near=True)
        if predicted is not None:
            predicted.origin.destroy()
        solve = replace(solve, strategy=self.strategy)
        if solve.outcome.accepted and self.sign and solve.signs and solve.signs[-1] != self.sign:
            return replace(solve, outcome=Outcome.ANOTHER_PATH)
        return solve

    @staticmethod
    def _prediction(equilibrium: Equilibrium) -> Prediction | None:
        """Return the present state as a prediction for factors of the similar problem, if there are any."""
        if not equilibrium.linear.reuse_factors():
            return None
        x, sign = equilibrium.system.position(), equilibrium.linear.sign_of_determinant()
        return Prediction(norm(x), Increment(0.0, 0.0), x, is_taken=True, signs=(sign,) if sign else ())


def sign_of(solves: Sequence[Solve]) -> int:
    """Return the sign of the tangent's determinant in accepted solves, 0 if it had both or is not known."""
    signs = {sign for solve in solves if solve.outcome.accepted for sign in solve.signs}
    return signs.pop() if len(signs) == 1 else 0


@dataclass(frozen=True)
class Start:
    """Start of the solution in one direction, by default the unloaded body.

    Attributes:
        solution: displacement (m) and pressure (Pa; ``None`` in the displacement form) of a checkpoint.
        load: share of the load under which that is a solution.
        solves: completed solves up to there.
        guess: initial state at full load, for methods that can use it; after a failure, the unloaded body is used.
        origin: displacement (m) and pressure (Pa) at which the load path begins; without it, with the unloaded body.
        slips: histories of the slip of all contacts, of a checkpoint; none without friction.
    """

    solution: tuple[Function, Function | None] | None = None
    load: float = 0.0
    solves: tuple[Solve, ...] = ()
    guess: Guess | None = None
    origin: tuple[Function, Function | None] | None = None
    slips: tuple[SlipHistory | None, ...] = ()

    @property
    def is_unloaded(self) -> bool:
        """True for the unloaded body, where nothing is known."""
        return self.solution is None and self.guess is None and self.origin is None and not self.solves


UNLOADED = Start()


class Method(ABC):
    """A path from the unloaded body, or from a checkpoint, to the solution of one direction.

    Attributes:
        reached_load: share of the load under which the present state is a solution; 1 only at the end.
    """

    equilibrium: Equilibrium
    reached_load: float = 0.0

    @abstractmethod
    def solves(self, start: Start = UNLOADED) -> Solves:
        """Yield every solve; the last one is accepted, or its outcome is the reason why the method ended.

        Whenever it yields, the mesh is at the coordinates of the job. The equations must be in ``start.solution``, or
        unloaded without one.
        """

    def check_start(self, start: Start) -> None:
        """Check that contacts of the unloaded body touch it, and do not overlap it; collective.

        Raises:
            MeshError: on all ranks, if one does.
        """
        system = self.equilibrium.system
        if start.load == 0.0 and start.solution is None:
            system.set_load(0.0 if system.weak_form.contacts.has_obstacles else 1.0)
            system.weak_form.contacts.check_start()

    @abstractmethod
    def can_restart_after(self, solve: Solve) -> bool:
        """Return whether a run can be resumed from the state after a solve that was just yielded."""

    @abstractmethod
    def min_mesh_J(self) -> float:
        """Return the smallest determinant of the map from the mesh to the unknown body."""
