"""Snapshots: the displacement of the boundary at accepted steps of a run, in small files."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hpcinv.base.quantity.arrays import Floats, Ints
from hpcinv.base.reading.door import admitted
from hpcinv.errors import OutputError
from hpcinv.output.surfaces.boundary_surface import DAMAGE, write_arrays

NAME = "snapshots"
_LEVELS = 65_535  # of a displacement between its smallest and its largest value


@dataclass(frozen=True)
class Snapshot:
    """The boundary after an accepted step.

    Attributes:
        solution: number of the solution in the order of the run.
        solves: number of solves in that solution so far, failed ones included.
        state: name of the state of the body; empty in a job without states.
        load: load factor.
        residual: position residual of a fixed-point method, m; NaN with other methods.
        points: rows of the boundary's points that are kept, (n,).
        displacement: of these from the mesh of the solve to the computed body, (n, 3) m, to 1/65535 of its range.
    """

    solution: int
    solves: int
    state: str
    load: float
    residual: float
    points: Ints
    displacement: Floats

    @property
    def name(self) -> str:
        return f"{self.solution:03}-{self.solves:06}.npz"


def write_snapshot(directory: Path, snapshot: Snapshot, most: int) -> None:
    """Add a snapshot; if there are more than ``most`` then, every second one of the same solution is removed.

    Raises:
        OutputError: it cannot be written.
    """
    values = snapshot.displacement
    low, range_ = values.min(axis=0), np.ptp(values, axis=0)
    levels = np.rint((values - low) / np.where(range_ > 0, range_, 1.0) * _LEVELS).astype(np.uint16)
    try:
        directory.mkdir(exist_ok=True)
    except OSError as error:
        raise OutputError(
            f"{directory}: cannot be made: {error.strerror}", "Is the run's directory writable?"
        ) from error
    write_arrays(
        directory / snapshot.name,
        {
            "state": snapshot.state,
            "load": snapshot.load,
            "residual": snapshot.residual,
            "points": snapshot.points.astype(np.int32),
            "levels": levels.T.copy(),  # component by component, which compresses better
            "low": low,
            "range": range_,
        },
    )
    own = [path for path in _all(directory) if _place(path)[0] == snapshot.solution]
    if len(own) > most:
        for path in own[-2::-2]:
            path.unlink(missing_ok=True)


def remove_after(directory: Path, solution: int, solves: int) -> None:
    """Remove the snapshots of steps that a resumed run takes again."""
    for path in _all(directory):
        if _place(path) > (solution, solves):
            path.unlink(missing_ok=True)


def read_snapshots(directory: Path) -> list[Snapshot]:
    """Read all snapshots in the order of the run; none if there is no such directory.

    Raises:
        OutputError: one is damaged.
    """
    snapshots = []
    for path in _all(directory):
        solution, solves = _place(path)
        try:
            with np.load(admitted(path)) as file:
                content = dict(file)
            values = content["low"] + content["levels"].T / _LEVELS * content["range"]
            state, load, residual = str(content["state"]), float(content["load"]), float(content["residual"])
            snapshots.append(
                Snapshot(solution, solves, state, load, residual, content["points"].astype(np.int64), values)
            )
        except DAMAGE as error:
            raise OutputError(f"{path}: cannot be read: {error}", "Remove it, or run the job again.") from error
    return snapshots


def _all(directory: Path) -> list[Path]:
    return sorted(path for path in directory.glob("*.npz") if path.stem.replace("-", "").isdigit())


def _place(path: Path) -> tuple[int, int]:
    solution, _, solves = path.stem.partition("-")
    return int(solution), int(solves)
