"""What the driver asks of a method, whichever it is."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hpcinv.methods.initial_guess import Guess
    from hpcinv.solver.equilibrium import Equilibrium, Solve


class Method(ABC):
    """A path from the unloaded body, or from a checkpoint, to the solution of one direction.

    Attributes:
        equilibrium: the equations that it solves.
        reached: share of the load under which the present state is a solution; 1 at the end, and only there.
        turned: turning points of the load on the way to the state that it begins with.
        guess: where a method may begin at full load instead of without load.
    """

    equilibrium: Equilibrium
    reached: float = 0.0
    turned: int = 0
    guess: Guess | None = None

    @abstractmethod
    def solves(self, load: float, *, resumed: bool) -> Iterator[Solve]:
        """Yield every solve; the last one is accepted, or tells why the method ended.

        Whenever it yields, the mesh lies as the job has it.

        Args:
            load: load factor at which the model's state is a solution.
            resumed: whether the state is one of a checkpoint.
        """

    @abstractmethod
    def can_restart_after(self, solve: Solve) -> bool:
        """Whether the state after a solve that was just yielded is one to begin with again."""

    @abstractmethod
    def min_mesh_J(self) -> float:
        """Smallest determinant of the map from the mesh to the body that is looked for."""
