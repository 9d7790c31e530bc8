"""Interface of the solution methods, and the state from which they start."""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass

from dolfinx.fem import Function

from hpcinv.methods.initial_guess import Guess
from hpcinv.solver.equilibrium import Equilibrium
from hpcinv.solver.newton import Solve


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

        Whenever it yields, the mesh is at the coordinates of the job. The model's state must be ``start.solution``, or
        zero without one.
        """

    @abstractmethod
    def can_restart_after(self, solve: Solve) -> bool:
        """Return whether a run can be resumed from the state after a solve that was just yielded."""

    @abstractmethod
    def min_mesh_J(self) -> float:
        """Return the smallest determinant of the map from the mesh to the unknown body."""
