"""Observers of the solves of a run: the interface of progress, checkpoints, reports and requests to stop."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from hpcinv.base.parallel.runtime import MPI
from hpcinv.model.constraint_report import ConstraintReport
from hpcinv.physics.effects import Direction
from hpcinv.solver.linear.selection import Used
from hpcinv.solver.newton import NewtonIteration, Solve


@dataclass(frozen=True)
class SolveEvent:
    """Report of one solve on the way to the full load, and of the state after it.

    Attributes:
        solves: every completed solve of this direction, including those before a restart.
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
    """Report of the solution in one direction.

    Attributes:
        solves: every completed solve, including those before a restart.
        load: share of the load that was reached.
        stopped: whether a request to stop ended it.
        can_restart: whether there is a state from which a run can be resumed.
        unused_options: PETSc options of the job that PETSc did not use; ``None`` if nothing had to be solved.
        constraints: numbers of loads and supports that the solves found, in the state that was reached.
    """

    direction: Direction
    solves: tuple[Solve, ...]
    load: float
    linear: Used
    stopped: bool
    can_restart: bool
    unused_options: tuple[str, ...] | None
    constraints: tuple[ConstraintReport, ...] = ()


class Observer:
    """Interface for the events of a run, on every rank and in the same order; by default they are ignored."""

    def begun(self, direction: Direction, linear: Used) -> None:
        """Called when the solution in one direction begins."""

    def iteration(self, iteration: NewtonIteration) -> None:
        """Called after each iteration of Newton's method."""

    def solved(self, event: SolveEvent) -> None:
        """Called after each solve, when the equations are in the last accepted state; collective."""

    def failing(self, lines: Sequence[str]) -> None:
        """Called with an explanation when load steps keep failing."""

    def ended(self, solved: SolvedDirection) -> None:
        """Called when the solution in one direction has ended; collective."""

    def stop_asked(self) -> bool:
        """Return whether this rank asks to stop.

        Called before each Newton iteration, after each solve, and between and within the checks of the certificate.
        """
        return False


SILENT = Observer()


class Stopped(Exception):
    """A request to stop has ended work other than a solve, on all ranks at the same place."""


@contextmanager
def freeing(*free: Callable[[], object]) -> Iterator[None]:
    """Context after which functions are called, also if a request to stop ends it; collective.

    They are not called after other errors: freeing is collective, and these may be on one rank alone.
    """
    try:
        yield
    except Stopped:
        for function in free:
            function()
        raise
    for function in free:
        function()


def is_stop_asked(comm: MPI.Intracomm, observer: Observer) -> bool:
    """Return whether some rank asks to stop; collective."""
    asked = np.array([observer.stop_asked()])
    comm.Allreduce(MPI.IN_PLACE, asked, op=MPI.LOR)
    return bool(asked[0])


def stop_if_asked(comm: MPI.Intracomm, observer: Observer) -> None:
    """Raise ``Stopped`` on all ranks if some rank asks to stop; collective."""
    if is_stop_asked(comm, observer):
        raise Stopped


class StopSignal(Observer):
    """Observer that requests a stop when a function returns true, for example after a signal."""

    def __init__(self, asked: Callable[[], bool]) -> None:
        self.asked = asked

    def stop_asked(self) -> bool:
        return self.asked()


class IterationObserver(Observer):
    """Observer that forwards iterations and requests to stop alone, of a solve that is not a step of the run."""

    def __init__(self, observer: Observer) -> None:
        self._observer = observer

    def iteration(self, iteration: NewtonIteration) -> None:
        self._observer.iteration(iteration)

    def stop_asked(self) -> bool:
        return self._observer.stop_asked()


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

    def failing(self, lines: Sequence[str]) -> None:
        for observer in self._observers:
            observer.failing(lines)

    def ended(self, solved: SolvedDirection) -> None:
        for observer in self._observers:
            observer.ended(solved)

    def stop_asked(self) -> bool:
        return any(observer.stop_asked() for observer in self._observers)
