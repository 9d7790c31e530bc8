"""Cache of the body and the model, with its equations and factorization, for successive runs in one process.

A workspace keeps the last body and the last model. Jobs that differ only in numbers use both again; jobs on the same
mesh use the body again.
"""

from __future__ import annotations

import gc
import json
from collections.abc import Callable
from typing import cast

from petsc4py import PETSc

from hpcinv.errors import HpcinvError
from hpcinv.job.fingerprint import file_digest
from hpcinv.job.job import Job
from hpcinv.job.reuse_key import reuse_group_of
from hpcinv.mesh import Body, build_body
from hpcinv.mesh.cell_count import no_report
from hpcinv.parallel.runtime import MPI, on_root
from hpcinv.parallel.timings import Timings
from hpcinv.solver.problem import Model


class Workspace:
    """The last body and model of the runs on one communicator, freed at the end of a context; collective."""

    def __init__(self, comm: MPI.Intracomm) -> None:
        self.comm = comm
        self._body: tuple[str, Body] | None = None
        self._model: tuple[str, Model] | None = None

    def __enter__(self) -> Workspace:
        return self

    def __exit__(self, *_: object) -> None:
        self.clear()

    def body(self, job: Job, report: Callable[[str], None] = no_report) -> Body:
        """Return the body of a job; ``report`` as for `build_body`.

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

    def model(self, job: Job, body: Body, timings: Timings) -> Model:
        """Return the model of a job on its body.

        Raises:
            MeshError: on all ranks, if the mesh lacks what the job names, or a field is not admissible on it.
        """
        key = on_root(self.comm, lambda: reuse_group_of(job))
        if self._model is not None and self._model[0] == key:
            try:
                self._model[1].update_parameters(job, timings)
            except HpcinvError:
                self._forget_model()
                raise
            return self._model[1]
        self._forget_model()
        self._model = key, Model(job, body, timings)
        return self._model[1]

    def clear(self) -> None:
        """Drop body and model, and free their PETSc objects."""
        self._forget_model()
        self._body = None

    def _forget_model(self) -> None:
        if self._model is not None:
            self._model[1].destroy()
        self._model = None


def collect_garbage(comm: MPI.Intracomm) -> None:
    """Collect garbage on all ranks: meshes and matrices hold communicators, of which MPI has few."""
    gc.collect()
    PETSc.garbage_cleanup(cast(PETSc.Comm, comm))


def _mesh_of(job: Job) -> str:
    """Return everything that a body depends on, as text."""
    spec = job.mesh.model_dump(mode="json") | {"digest": file_digest(job.resolve(job.mesh.file))}
    return json.dumps([spec, {name: str(formula) for name, formula in job.regions.items()}], sort_keys=True)
