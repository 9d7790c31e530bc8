"""What runs that follow each other in one process hand on: the body, and a model with its equations and factorization.

A workspace keeps the last body and the last model. Jobs that differ in numbers alone find all of it ready; jobs on the
same mesh find the body.
"""

from __future__ import annotations

import gc
import json
from collections.abc import Callable
from typing import TYPE_CHECKING, cast

from petsc4py import PETSc

from hpcinv.errors import HpcinvError
from hpcinv.job.fingerprint import file_digest
from hpcinv.job.reuse_key import reuse_group_of
from hpcinv.mesh import build_body
from hpcinv.mesh.cell_count import no_report
from hpcinv.parallel.runtime import MPI, on_root
from hpcinv.solver.problem import Model

if TYPE_CHECKING:
    from hpcinv.job.job import Job
    from hpcinv.mesh import Body
    from hpcinv.parallel.timings import Timings


class Workspace:
    """The last body and model of the runs on one communicator; all methods are collective.

    Use it as a context, which frees them.
    """

    def __init__(self, comm: MPI.Intracomm) -> None:
        self.comm = comm
        self._body: tuple[str, Body] | None = None
        self._model: tuple[str, Model] | None = None

    def __enter__(self) -> Workspace:
        return self

    def __exit__(self, *_: object) -> None:
        self.clear()

    def body(self, job: Job, report: Callable[[str], None] = no_report) -> Body:
        """The body of a job as its mesh gives it; ``report`` as in `build_body`.

        Raises:
            MeshError, SystemPartMissing: the same on every rank.
        """
        key = on_root(self.comm, lambda: _mesh_of(job))  # other ranks may not see the file
        if self._body is not None and self._body[0] == key:
            return self._body[1]
        self.clear()
        body = build_body(job.mesh, job.regions, self.comm, resolve=job.resolve, report=report)
        self._body = key, body
        return body

    def model(self, job: Job, timings: Timings) -> Model:
        """The model of a job, whose body must have been asked for.

        Raises:
            MeshError: on all ranks, if the mesh lacks what the job names, or a field is not admissible on it.
        """
        assert self._body is not None
        key = on_root(self.comm, lambda: reuse_group_of(job))
        if self._model is not None and self._model[0] == key:
            try:
                self._model[1].update_parameters(job, timings)
            except HpcinvError:
                self._forget_model()
                raise
            return self._model[1]
        self._forget_model()
        self._model = key, Model(job, self._body[1], timings)
        return self._model[1]

    def clear(self) -> None:
        """Forget all, and free what PETSc holds of it."""
        self._forget_model()
        self._body = None

    def _forget_model(self) -> None:
        if self._model is not None:
            self._model[1].destroy()
        self._model = None


def collect_garbage(comm: MPI.Intracomm) -> None:
    """Free what runs have left, now and on all ranks: meshes and matrices hold communicators, which are few."""
    gc.collect()
    PETSc.garbage_cleanup(cast(PETSc.Comm, comm))


def _mesh_of(job: Job) -> str:
    """All that a body depends on, as text."""
    spec = job.mesh.model_dump(mode="json") | {"digest": file_digest(job.resolve(job.mesh.file))}
    return json.dumps([spec, {name: str(formula) for name, formula in job.regions.items()}], sort_keys=True)
