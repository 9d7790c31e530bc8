"""Preparation of a run: the equations of its job on a mesh that is read, generated, or found by a search."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.errors import Interrupted
from hpcinv.job.job import Job
from hpcinv.job.mesh_file import CUT
from hpcinv.job.mesh_generators import is_generator
from hpcinv.job.states import StateSpec
from hpcinv.mesh import Body
from hpcinv.on_demand import on_demand
from hpcinv.output.progress import Progress
from hpcinv.results.quantities_of_interest import check_points
from hpcinv.results.shape_distance import Expected, read_expected
from hpcinv.results.solution import Solution
from hpcinv.solver.equations import Equations
from hpcinv.solver.observer import Observer, is_stop_asked
from hpcinv.solver.workspace import Workspace
from hpcinv.trust.accuracy import AccuracyRecord
from hpcinv.trust.certificate import Estimate

_FREE_CUT = "the region 'cut', where the image ends in the body, is free; hold or load it as the rest of the body does"


@dataclass(frozen=True)
class Prepared:
    """Equations of a job, and what a search for accuracy found.

    Attributes:
        equations: of each solve of the job's plan.
        solutions: after a search for accuracy, its first solution. The same holds for the other attributes.
        record: how that solution was found.
        estimate: its estimated error.
        unused_options: PETSc options of the job that were not used.
    """

    job: Job
    equations: Sequence[Equations]
    expected: Expected | None = None
    solutions: tuple[Solution, ...] = ()
    record: AccuracyRecord | None = None
    estimate: Estimate | None = None
    unused_options: Sequence[str] = ()

    @property
    def body(self) -> Body:
        return self.equations[0].body


def prepare(job: Job, workspace: Workspace, progress: Progress, timings: Timings, stop: Observer) -> Prepared:
    """Return the equations of a job, on a mesh that meets the accuracy that it demands, if it does; collective.

    Raises:
        MeshError, SystemPartMissing: the same on every rank.
        Interrupted: ``stop`` asked to stop on some rank.
    """
    if job.accuracy:
        return _prepared_by_search(job, workspace, progress, timings, stop)
    return _prepared_on_job_mesh(job, workspace, progress, timings, stop)


def _prepared_on_job_mesh(
    job: Job, workspace: Workspace, progress: Progress, timings: Timings, stop: Observer
) -> Prepared:
    """Return the equations of a job on its mesh; collective."""
    comm = workspace.comm
    verb = "meshing" if is_generator(Path(job.mesh.file)) else "reading"
    with timings("mesh"), progress.phase(verb, job.mesh.file):
        body = workspace.body(job, progress.detail)
        progress.detail(f"{sum(body.partition.cells):,} cells")
        if job.mesh.is_image and not is_cut_held_or_loaded(job, body):
            progress.warn(_FREE_CUT)
        expected = read_expected(job, body)
        check_points(job.quantities, body)
        if any(interface.known.rest_surface is not None for interface in job.all_interfaces):
            on_demand("check of rest surfaces")(job, body)
        for text in on_demand("check of cavities")(job, body) if job.cavities else ():
            progress.warn(text)
    _end_if_asked(comm, stop)
    equations = workspace.equations(job, body, timings)
    _end_if_asked(comm, stop)
    return Prepared(job, equations, expected)


def is_cut_held_or_loaded(job: Job, body: Body) -> bool:
    """Return whether something acts on some facet where the image ends, or it ends nowhere in the body; collective."""
    if CUT not in body.regions:
        return True
    holders: list[Job | StateSpec] = [job, *job.states]
    names = {support.region for holder in holders for support in holder.supports or ()}
    names |= {name for holder in holders for effect in holder.effects for name in effect.surfaces}
    cut = body.facets(CUT)
    acts = any(np.intersect1d(cut, body.regions[name].facets).size for name in names if name in body.regions)
    return bool(body.mesh.comm.allreduce(acts, op=MPI.LOR))


def _end_if_asked(comm: MPI.Intracomm, stop: Observer) -> None:
    """Raise ``Interrupted`` on all ranks if some rank asks to stop; collective."""
    if is_stop_asked(comm, stop):
        raise Interrupted("stopped by a signal before there was anything to save", "Start the same command again.")


def _prepared_by_search(
    job: Job, workspace: Workspace, progress: Progress, timings: Timings, stop: Observer
) -> Prepared:
    """Return the equations on a mesh and in spaces that meet the accuracy that the job demands; collective."""
    with progress.phase("searching", "for mesh and degree"):
        record, best = on_demand("search for accuracy")(job, workspace.comm, timings, progress.note, stop).run()
    job, equations = best.job, [best.equations] * len(best.job.plan)
    return Prepared(job, equations, None, (best.solution,), record, best.estimate, best.unused_options)
