"""Observers of the solves of a run: what progress, checkpoints, reports and requests to stop have in common."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hpcinv.effects import Direction
    from hpcinv.solver.linear.selection import Used
    from hpcinv.solver.newton import NewtonIteration
    from hpcinv.solver.step_report import Solve


@dataclass(frozen=True)
class SolveEvent:
    """One solve on the way to the full load, and where it left the solution.

    Attributes:
        solve: the last solve.
        solves: every completed solve of this direction, those before a restart too.
        load: share of the load under which the present state is a solution.
        can_restart: whether a run can be resumed from the present state.
        largest_displacement: of the present state, in m.
        min_mesh_J: smallest determinant of the map from the mesh to the unknown body.
    """

    solve: Solve
    solves: tuple[Solve, ...]
    load: float
    can_restart: bool
    largest_displacement: float
    min_mesh_J: float  # noqa: N815  (the field's symbol)


@dataclass(frozen=True)
class SolvedDirection:
    """How the solution in one direction ended.

    Attributes:
        solves: every completed solve, those before a restart too.
        load: share of the load that was reached.
        linear: the linear solver that was used.
        stopped: whether a request to stop ended it.
        can_restart: whether there is a state from which a run can be resumed.
        unused_options: PETSc options of the job that nothing asked for; ``None`` if nothing had to be solved.
    """

    direction: Direction
    solves: tuple[Solve, ...]
    load: float
    linear: Used
    stopped: bool
    can_restart: bool
    unused_options: tuple[str, ...] | None


class Observer:
    """Receives the events of a run, on every rank and in the same order; the default is to ignore them."""

    def begun(self, direction: Direction, linear: Used) -> None:
        """The solution in one direction begins."""

    def iteration(self, iteration: NewtonIteration) -> None:
        """One iteration of Newton's method."""

    def solved(self, event: SolveEvent) -> None:
        """One solve has ended; the model's state is that of the last accepted one; collective."""

    def ended(self, found: SolvedDirection) -> None:
        """The solution in one direction has ended; collective."""

    def stop_asked(self) -> bool:
        """Whether this rank asks to stop; asked before each Newton iteration and after each solve."""
        return False


SILENT = Observer()
"""nobody observes"""


class Observers(Observer):
    """Several observers, called one after the other."""

    def __init__(self, *observers: Observer) -> None:
        self._observers = observers

    def begun(self, direction: Direction, linear: Used) -> None:
        for observer in self._observers:
            observer.begun(direction, linear)

    def iteration(self, iteration: NewtonIteration) -> None:
        for observer in self._observers:
            observer.iteration(iteration)

    def solved(self, event: SolveEvent) -> None:
        for observer in self._observers:
            observer.solved(event)

    def ended(self, found: SolvedDirection) -> None:
        for observer in self._observers:
            observer.ended(found)

    def stop_asked(self) -> bool:
        return any(observer.stop_asked() for observer in self._observers)
