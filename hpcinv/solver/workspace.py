"""Cache of the body and its equations, with their factors, for successive runs in one process.

A workspace keeps the last body and the last equations. Jobs that differ only in numbers use all again; jobs on the same
mesh use the body again. States of one job that differ only in numbers have the same equations.
"""

from __future__ import annotations

import gc
from collections.abc import Callable
from dataclasses import replace
from typing import cast

import numpy as np
from petsc4py import PETSc

from hpcinv.base.files.inputs import changed_inputs
from hpcinv.base.parallel.runtime import MPI, on_root
from hpcinv.base.parallel.timings import Timings
from hpcinv.errors import HpcinvError
from hpcinv.job.job import Job
from hpcinv.job.resolved_job import SectionData
from hpcinv.job.reuse_key import body_key, reuse_group_of, structure_of
from hpcinv.mesh import Body, build_body
from hpcinv.mesh.cell_count import no_report
from hpcinv.mesh.source import DataArray, Floats
from hpcinv.solver.equations import Equations


class Workspace:
    """The last body and equations of the runs on one communicator, freed at the end of a context; collective."""

    def __init__(self, comm: MPI.Intracomm) -> None:
        self.comm = comm
        self._body: tuple[str, Body] | None = None
        self._equations: dict[str, Equations] = {}

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
            for equations in [*self._equations.values()][:1]:  # all have the same mesh
                equations.put(equations.unloaded())
            return self._body[1]
        self.clear()
        degree = job.discretisation.displacement
        body = build_body(job.mesh, job.regions, self.comm, resolve=job.resolve, degree=degree, report=report)
        self._body = key, body
        return body

    def put_array(self, name: str, values: Floats) -> None:
        """Give a data array of the body's mesh other values, which later runs have; collective.

        Args:
            values: (rows,) or (rows, components) in the order of the mesh, the same on all ranks.
        """
        assert self._body is not None
        source = self._body[1].source
        array, rows = source.data[name], self.comm.rank == 0
        own = np.ascontiguousarray(values, dtype=np.float64).reshape(-1, array.values.shape[1])
        changed = replace(array, values=own.copy() if rows else array.values.copy())
        cast(dict[str, DataArray], source.data)[name] = changed

    def put_body(self, body: Body) -> None:
        """Let later runs have another body of the same mesh file, with new equations; collective."""
        assert self._body is not None
        self._forget_equations()
        self._body = self._body[0], body

    def _key(self, job: Job) -> tuple[str, bool]:
        """Return the key of a job's body, and whether it is the kept one, made of files as they are now; on rank 0."""
        key = body_key(job)
        if self._body is None or self._body[0] != key:
            return key, False
        home = job.resolve(job.mesh.file).absolute().parent
        return key, not changed_inputs(self._body[1].source.inputs, home)

    def equations(self, job: Job, body: Body, timings: Timings) -> list[Equations]:
        """Return the equations of each solve of a job on its body; several solves may have the same.

        Raises:
            MeshError: on all ranks, if the mesh lacks what the job names, or a field is not admissible on it.
        """
        plan, known = job.plan, SectionData()

        def structures() -> list[str]:
            group = reuse_group_of(job, known)
            return [f"{group} {structure_of(solve.job, known) if job.states else ''}" for solve in plan]

        keys = on_root(self.comm, structures)
        for key in [key for key in self._equations if key not in keys]:
            self._equations.pop(key).destroy()
        jobs: list[Job] = []
        try:
            for key, solve in zip(keys, plan, strict=True):
                if key not in self._equations:
                    like = next(iter(self._equations.values()), None)
                    self._equations[key] = Equations(solve.job, body, timings, like)
                    self._equations[key].check_supports()
                elif not any(solve.job is job for job in jobs):  # the numbers of all states are checked beforehand
                    self._equations[key].renew(solve.job, timings)
                jobs.append(solve.job)
        except HpcinvError:
            self._forget_equations()
            raise
        return [self._equations[key] for key in keys]

    def clear(self) -> None:
        """Drop body and equations, and free their PETSc objects."""
        self._forget_equations()
        self._body = None

    def _forget_equations(self) -> None:
        for equations in self._equations.values():
            equations.destroy()
        self._equations.clear()


def collect_garbage(comm: MPI.Intracomm) -> None:
    """Collect garbage on all ranks: meshes and matrices hold communicators, and MPI has few of them."""
    gc.collect()
    PETSc.garbage_cleanup(cast(PETSc.Comm, comm))
