"""Writer of snapshots during a run: the boundary after each accepted step, for reports."""

import math

from hpcinv.base.parallel.runtime import on_root
from hpcinv.errors import OutputError
from hpcinv.mesh.surface import gather_surface
from hpcinv.output.checkpoint import Restart
from hpcinv.output.run_store import RunStore
from hpcinv.output.surfaces.decimation import Decimated, decimated
from hpcinv.output.surfaces.gathering import cut_of
from hpcinv.output.surfaces.snapshots import NAME, Snapshot, remove_after, write_snapshot
from hpcinv.physics.effects import Direction
from hpcinv.solver.equations import Equations
from hpcinv.solver.observer import Observer, SolveEvent


class SnapshotWriter(Observer):
    """Writes the boundary's displacement after each accepted step before the full load, whose fields are kept anyhow.

    Args:
        equations: of the first solution.
        restart: of a resumed run, which takes the steps after it again.
    """

    def __init__(self, store: RunStore, equations: Equations, restart: Restart | None) -> None:
        self._store, self._equations = store, equations
        output = equations.job.output
        self._most = output.snapshots if output.has_surface and store.path is not None else 0
        self._solution, self._sign = 0, 1
        self._kept: Decimated | None = None  # on rank 0
        self._is_gathered = False
        self._directory = None if store.path is None else store.path / NAME
        if self._directory is not None and restart is not None:
            directory, position = self._directory, restart.position
            solves = len(position.solves[position.direction_index])
            on_root(store.comm, lambda: remove_after(directory, position.direction_index, solves))

    def begin(self, solution: int, equations: Equations, direction: Direction) -> None:
        """Set the number of the solution whose steps follow, its equations and its direction."""
        self._solution, self._equations, self._sign = solution, equations, 1 if direction == "forward" else -1

    def solved(self, event: SolveEvent) -> None:
        is_drawn = self._solution == 0 or self._equations.job.state  # the second direction of a round trip is not
        if self._most and is_drawn and event.can_restart and event.load < 1.0:
            self._store.check_in_place()
            with self._equations.timings("output"):
                self._write(event)

    def _write(self, event: SolveEvent) -> None:
        equations, body = self._equations, self._equations.body
        displacement = equations.unknowns.geometry_values(equations.state().displacement)
        given = None if self._is_gathered else gather_surface(body, body.given_nodes)
        self._is_gathered = True
        moved = gather_surface(body, displacement * self._sign)

        def write() -> None:
            assert moved is not None  # on rank 0
            assert self._directory is not None
            if given is not None:
                cut = cut_of(given)
                self._kept = decimated(cut.points, cut.corners)
            assert self._kept is not None
            rows, residual = self._kept.points, event.solve.position_residual
            snapshot = Snapshot(
                solution=self._solution,
                solves=len(event.solves),
                state=equations.job.state,
                load=event.load,
                residual=math.nan if residual is None else residual,
                points=rows,
                displacement=cut_of(moved).points[rows],
            )
            try:
                write_snapshot(self._directory, snapshot, self._most)
            except OutputError:
                self._store.check_in_place_on_this_rank()
                raise

        on_root(self._store.comm, write)
