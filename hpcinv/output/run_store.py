"""Store of a run: its directory, locked during the run, and checked before each writing."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Self

from hpcinv.base.files.directory_lock import DirectoryLock
from hpcinv.base.parallel.runtime import MPI, on_root
from hpcinv.errors import JobError, MeshError
from hpcinv.job.fingerprint import fingerprint
from hpcinv.job.job import Job
from hpcinv.mesh import Body, write_mesh
from hpcinv.mesh.data import geometry_node_values
from hpcinv.mesh.mesh_files import UnstorableMesh, left_out
from hpcinv.mesh.source import DataArray
from hpcinv.output.checkpoint import Checkpoints, Restart, cells_digest, nodes_digest
from hpcinv.output.progress import Progress
from hpcinv.output.run_directory import RunDirectory
from hpcinv.output.shape_files import ShapeFile, notes_of
from hpcinv.output.summary import versions
from hpcinv.results.cell_fields import face_arrays, shape_directions
from hpcinv.results.displacement_scale import displacement_scale
from hpcinv.results.solution import Solution
from hpcinv.solver.equations import Equations


class RunStore:
    """Directory of a run on disk, if it has one; methods are collective.

    Use it as a context, which unlocks the directory at its end. A directory that it has made is removed if job or mesh
    turn out to be wrong before there is anything to save.

    Args:
        directory: ``None`` writes nothing.

    Attributes:
        unwritten: why files of shapes are missing, although all else is written.
        shape_files: written files of shapes, by name.

    Raises:
        OutputError: from every method, on all ranks, if another process has locked the directory, or it was removed.
    """

    def __init__(self, directory: Path | RunDirectory | None, comm: MPI.Intracomm) -> None:
        self.directory = RunDirectory(directory) if isinstance(directory, Path) else directory
        self.comm = comm
        self._lock: DirectoryLock | None = None  # on rank 0
        self._is_new = False  # on rank 0
        self.unwritten: list[UnstorableMesh] = []
        self.shape_files: dict[str, ShapeFile] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, _type: object, error: BaseException | None, _traceback: object) -> None:
        if self.directory is not None and self._is_new and isinstance(error, JobError | MeshError):
            self.directory.withdraw()
        self._unlock()

    @property
    def path(self) -> Path | None:
        return self.directory.path if self.directory else None

    def lock(self, job: Job) -> None:
        """Lock the directory in which a run resumes.

        Raises:
            CheckpointError: on all ranks, if the job would remove the checkpoints there.
        """

        def take(directory: RunDirectory) -> None:
            self._lock = directory.lock()
            directory.check_keeps_checkpoints(job)

        if (directory := self.directory) is not None:
            on_root(self.comm, lambda: take(directory))

    def open(
        self, job: Job, equations: Equations, progress: Progress, *, overwrite: bool, resume: bool
    ) -> tuple[Checkpoints | None, Restart | None]:
        """Make the directory for a job, or open the directory of the run to resume.

        Args:
            equations: the equations of its first solve.

        Returns:
            Its checkpoints, and the one to resume from. A search for accuracy has none and starts again.
        """
        if (directory := self.directory) is None:
            return None, None
        # Functions are saved cell by cell, so that a generator must make the same cells again, at the same nodes.
        problem = problem_fingerprint(job, equations.body)
        checkpoints = None
        if not job.accuracy:
            checkpoints = Checkpoints(directory.checkpoints, self.comm, problem, job.checkpoint.keep)
        restart = checkpoints.latest() if checkpoints and resume else None

        def create() -> None:
            self._unlock()  # `create` locks it again
            self._is_new = not (directory.claimed or directory.path.exists())
            self._lock = directory.create(job, overwrite=overwrite or resume)

        if not resume or checkpoints is None:
            on_root(self.comm, create)
        elif not on_root(self.comm, lambda: directory.holds(job)):
            on_root(self.comm, lambda: directory.change(job))
        progress.open_log(self.comm, directory.path, ", ".join(f"{name} {v}" for name, v in versions().items()))
        progress.begin(job, equations.body, equations.unknowns.size, directory.path, restart)
        return checkpoints, restart

    def check_in_place(self) -> None:
        """Raise ``OutputError`` on all ranks if the directory was removed."""
        if (directory := self.directory) is not None:
            on_root(self.comm, lambda: directory.check_in_place(self._lock))

    def check_in_place_on_this_rank(self) -> None:
        """Raise ``OutputError`` on this rank if the directory was removed; not collective."""
        if self.directory is not None:
            self.directory.check_in_place(None)

    def write_shape(self, job: Job, equations: Equations, solution: Solution, progress: Progress) -> None:
        """Write the computed shape of a solution."""
        with progress.phase("writing"):
            if self.directory is not None:
                self.check_in_place()
                written = dict[str, ShapeFile]()
                for error in _write_shape(self.directory.path, job, equations, solution, progress, written):
                    self.unwritten.append(error)
                    progress.warn(error.message)
                self.shape_files |= written
                for text in notes_of(written):
                    progress.note(f"  {text}")

    def _unlock(self) -> None:
        if self._lock is not None:
            self._lock.release()
            self._lock = None


def problem_fingerprint(job: Job, body: Body) -> Mapping[str, Any]:
    """Return the fingerprint of a job on its body, which their checkpoints must share; collective."""
    problem = on_root(body.mesh.comm, lambda: fingerprint(job) | {"inputs": dict(body.source.inputs)})
    return problem | {"cells": cells_digest(body), "nodes": nodes_digest(body)}


def _write_shape(
    path: Path,
    job: Job,
    equations: Equations,
    solution: Solution,
    progress: Progress,
    written: dict[str, ShapeFile],
) -> Iterator[UnstorableMesh]:
    """Write the files of a shape, and note them in ``written``; yield the errors of those that cannot hold it."""
    shape = "shape"
    if solution.state:  # the inverse solve finds the rest shape
        shape += f"-{job.rest if solution.direction == 'inverse' else solution.state}"
    with equations.timings("output"):
        pressures = {f.name: f for contact in solution.contacts for f, _ in contact.fields_with_units}
        values = {name: geometry_node_values(equations.body, pressure) for name, pressure in pressures.items()}
        values |= face_arrays(equations.body, solution)
        arrays = {name: DataArray(name, "nodes", nodal) for name, nodal in values.items()}
        arrays |= shape_directions(equations.body, job.fibres, solution)
        scale = displacement_scale(equations, solution).length
        for suffix in job.shape_formats:
            name = f"{shape}.{suffix}"
            progress.detail(name)
            try:
                write_mesh(path / name, equations.body, solution.other_nodes, arrays)
            except UnstorableMesh as error:  # the solution and its other files are kept
                yield error
                continue
            distance = left_out(path / name, equations.body, solution.other_nodes)
            written[name] = ShapeFile(name, distance, scale, equations.body.source.degree, solution.state)
