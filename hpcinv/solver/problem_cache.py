"""Cache of the body and the models, with their equations and factorization, for successive runs in one process.

A workspace keeps the last body and the last models. Jobs that differ only in numbers use all again; jobs on the same
mesh use the body again. States of one job that differ only in numbers have one model.
"""

from __future__ import annotations

import gc
import json
from collections.abc import Callable, Sequence
from functools import cache
from typing import cast

from dolfinx.fem import Function
from petsc4py import PETSc

from hpcinv.errors import HpcinvError
from hpcinv.files.inputs import changed_inputs
from hpcinv.job.fingerprint import file_digest
from hpcinv.job.job import Job, PlannedSolve
from hpcinv.job.reuse_key import reuse_group_of, structure_of
from hpcinv.mesh import Body, build_body
from hpcinv.mesh.cell_count import no_report
from hpcinv.parallel.runtime import MPI, on_root
from hpcinv.parallel.timings import Timings
from hpcinv.solver.problem import Model


class Models:
    """Models of the solves of a job, some of which may be one model, with the numbers of one state at a time."""

    def __init__(self, plan: Sequence[PlannedSolve], models: Sequence[Model]) -> None:
        self.plan, self._models = plan, models

    def of(self, number: int, given: Function | None = None) -> Model:
        """Return the model of a solve with the numbers of its state; the mesh must lie as the job gives it; collective.

        Args:
            given: displacement (m) of the given state, for all solves but its own.
        """
        model, solve = self._models[number], self.plan[number]
        if model.job is not solve.job:
            model.update_parameters(solve.job, model.timings)
        model.carry(given if solve.mesh is not None and solve.job.state else None)
        return model


class Workspace:
    """The last body and models of the runs on one communicator, freed at the end of a context; collective."""

    def __init__(self, comm: MPI.Intracomm) -> None:
        self.comm = comm
        self._body: tuple[str, Body] | None = None
        self._models: dict[str, Model] = {}

    def __enter__(self) -> Workspace:
        return self

    def __exit__(self, *_: object) -> None:
        self.clear()

    def body(self, job: Job, report: Callable[[str], None] = no_report) -> Body:
        """Return the body of a job; ``report`` as for `build_body`.

        Raises:
            MeshError, SystemPartMissing: the same on every rank.
        """
        key, is_kept = on_root(self.comm, lambda: self._key(job))  # other ranks may not see the file
        if self._body is not None and is_kept:
            return self._body[1]
        self.clear()
        degree = job.discretisation.displacement
        body = build_body(job.mesh, job.regions, self.comm, resolve=job.resolve, degree=degree, report=report)
        self._body = key, body
        return body

    def _key(self, job: Job) -> tuple[str, bool]:
        """Return the key of a job's body, and whether it is the kept one, made of files as they are now; on rank 0."""
        key = _mesh_of(job)
        if self._body is None or self._body[0] != key:
            return key, False
        home = job.resolve(job.mesh.file).absolute().parent
        return key, not changed_inputs(self._body[1].source.inputs, home)

    def models(self, job: Job, body: Body, timings: Timings) -> Models:
        """Return the models of the solves of a job on its body.

        Raises:
            MeshError: on all ranks, if the mesh lacks what the job names, or a field is not admissible on it.
        """
        plan, digest = job.plan, cache(file_digest)

        def structures() -> list[str]:
            group = reuse_group_of(job, digest)
            return [f"{group} {structure_of(solve.job, digest) if job.states else ''}" for solve in plan]

        keys = on_root(self.comm, structures)
        for key in [key for key in self._models if key not in keys]:
            self._models.pop(key).destroy()
        done: list[Job] = []
        try:
            for key, solve in zip(keys, plan, strict=True):
                if key not in self._models:
                    like = next(iter(self._models.values()), None)
                    self._models[key] = Model(solve.job, body, timings, like)
                    self._models[key].check_supports()
                elif not any(solve.job is one for one in done):
                    self._models[key].update_parameters(solve.job, timings)
                done.append(solve.job)
        except HpcinvError:
            self._forget_models()
            raise
        return Models(plan, [self._models[key] for key in keys])

    def clear(self) -> None:
        """Drop body and models, and free their PETSc objects."""
        self._forget_models()
        self._body = None

    def _forget_models(self) -> None:
        for model in self._models.values():
            model.destroy()
        self._models.clear()


def collect_garbage(comm: MPI.Intracomm) -> None:
    """Collect garbage on all ranks: meshes and matrices hold communicators, of which MPI has few."""
    gc.collect()
    PETSc.garbage_cleanup(cast(PETSc.Comm, comm))


def _mesh_of(job: Job) -> str:
    """Return everything that a body depends on, as text."""
    digests = [file_digest(job.resolve(file)) for file in job.mesh.files]
    spec = job.mesh.model_dump(mode="json") | {"metres": job.mesh.metres, "digest": digests}
    regions = {name: formula.whole for name, formula in job.regions.items()}
    return json.dumps([spec, regions, job.discretisation.displacement], sort_keys=True)
