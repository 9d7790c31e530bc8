"""Writer of checkpoints during a run: after a number of steps, and when the run stops early."""

import time
from collections.abc import Callable, Sequence

from dolfinx.fem import Function

from hpcinv.errors import OutputError, SystemPartMissing
from hpcinv.model.contact_reports import SlipHistory, histories_of
from hpcinv.output.checkpoint import Checkpoints, Position, Restart, named, named_slips
from hpcinv.output.run_store import RunStore
from hpcinv.physics.effects import Direction
from hpcinv.results.solution import Solution
from hpcinv.solver.equations import Equations
from hpcinv.solver.linear.selection import Used
from hpcinv.solver.newton import Solve
from hpcinv.solver.observer import Observer, SolvedDirection, SolveEvent


class CheckpointWriter(Observer):
    """Writes checkpoints at the intervals of the job, and of the last state before a run stops.

    Args:
        warn: prints a sentence, if this installation cannot write checkpoints.
        restart: the checkpoint from which the run was resumed.
    """

    def __init__(
        self,
        checkpoints: Checkpoints | None,
        store: RunStore,
        equations: Equations,
        warn: Callable[[str], None],
        restart: Restart | None = None,
    ) -> None:
        self._checkpoints, self._store, self._equations, self._warn = checkpoints, store, equations, warn
        self._settings, self._comm = equations.job.checkpoint, equations.body.mesh.comm
        self._finished: list[Solution] = []
        self._direction: Direction = equations.job.directions[0]
        self._steps, self._last = 0, time.monotonic()  # since the last checkpoint
        self._saved = None if restart is None else restart.position

    def begun(self, direction: Direction, linear: Used) -> None:
        self._direction = direction

    def finished(self, solution: Solution) -> None:
        """Add the solution of a finished direction to all later checkpoints."""
        self._finished.append(solution)

    @property
    def can_save(self) -> bool:
        """True if the run has checkpoints: without them, what a stopped run has solved would be lost."""
        return self._checkpoints is not None

    @property
    def has_saved_finished(self) -> bool:
        """True if the last checkpoint has the solutions of all finished directions."""
        *earlier, last = self._finished
        return self._saved == _position(earlier, last.load, last.solves, histories_of(last.contacts))

    def save_finished(self) -> None:
        """Save the solutions of all finished directions, unless that is the last checkpoint; collective."""
        *earlier, last = self._finished
        self._save(earlier, last.load, last.solves, last.fields, histories_of(last.contacts))

    def solved(self, event: SolveEvent) -> None:
        self._steps += event.can_restart
        if self._settings.every and self._steps >= self._settings.every and self._is_late_enough():
            self._write(event.load, event.solves)

    def ended(self, solved: SolvedDirection) -> None:
        if self._steps and (solved.stopped or (self._settings.every and solved.load != 1.0)):
            self._write(solved.load, solved.solves)

    def _is_late_enough(self) -> bool:
        """Return whether the last checkpoint is old enough, by the clock of rank 0; collective."""
        least = self._settings.seconds
        return not least or bool(self._comm.bcast(time.monotonic() - self._last >= least))

    def _write(self, load: float, solves: Sequence[Solve]) -> None:
        slips = self._equations.slip_histories(self._direction, load)
        self._save(self._finished, load, solves, self._equations.state().fields, slips)

    def _save(
        self,
        earlier: Sequence[Solution],
        load: float,
        solves: Sequence[Solve],
        last: tuple[Function, Function | None],
        slips: Sequence[SlipHistory | None],
    ) -> None:
        """Write a checkpoint of solutions, and of the ``last`` state (m, Pa), in the direction after theirs.

        Args:
            slips: histories of the slip of contacts in the last state.
        """
        self._steps, self._last = 0, time.monotonic()
        if self._checkpoints is None:
            return
        position = _position(earlier, load, solves, slips)
        if position == self._saved:
            return
        self._store.check_in_place()
        with self._equations.timings("checkpoint"):
            parts = [named(number, *fields) for number, fields in enumerate([*(s.fields for s in earlier), last])]
            histories = [*(histories_of(solution.contacts) for solution in earlier), slips]
            parts += [named_slips(number, of_direction) for number, of_direction in enumerate(histories)]
            try:
                self._checkpoints.write(position, {name: f for part in parts for name, f in part.items()})
            except OutputError:  # raised on some ranks only
                self._store.check_in_place_on_this_rank()
                raise
            except SystemPartMissing as exc:  # the run can end without them
                self._checkpoints = None
                self._warn(f"no checkpoints: {exc.message}\n  {exc.advice}")
                return
        self._saved = position


def _position(
    earlier: Sequence[Solution], load: float, solves: Sequence[Solve], slips: Sequence[SlipHistory | None]
) -> Position:
    """Return the position of a run after solutions, in the direction after theirs."""
    histories = [*(histories_of(solution.contacts) for solution in earlier), slips]
    numbers = tuple(tuple(h if h is None else h.numbers for h in of_direction) for of_direction in histories)
    return Position(len(earlier), load, (*(solution.solves for solution in earlier), tuple(solves)), numbers)
