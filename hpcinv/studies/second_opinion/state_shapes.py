"""Shapes of a run from which a deck follows: the rest shape, the loaded one, and the given one."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from hpcinv.errors import OutputError
from hpcinv.geometry.workshop.run_shapes import DEFORMED, UNDEFORMED, read_shape
from hpcinv.job.job import Job
from hpcinv.mesh.source import MeshSource


def shapes_of(run: Path, job: Job, state: str) -> tuple[Job, MeshSource, MeshSource, MeshSource]:
    """Return the job of a state by itself, and the rest shape, the loaded and the given one; in m.

    Args:
        state: of a job with states; empty for the given one, or the first loaded one if the rest shape is given.

    Raises:
        OutputError: there is no such state, or it has no loads.
    """
    rest = read_shape(run, UNDEFORMED)
    if not job.states:
        loaded = read_shape(run, DEFORMED)
        return job, rest, loaded, loaded if job.directions[0] == "inverse" else rest
    own, given_name = job_of_state(run, job, state), _given_state(job)
    loaded = read_shape(run, own.state)
    if all(solve.job.state != given_name for solve in job.plan):
        return own, rest, loaded, rest
    return own, rest, loaded, loaded if own.state == given_name else read_shape(run, given_name)


def job_of_state(run: Path, job: Job, state: str = "") -> Job:
    """Return the job of a state by itself; arguments and errors as of `shapes_of`."""
    if not job.states:
        return job
    jobs = {solve.job.state: solve.job for solve in job.plan}
    name = state or (given if (given := _given_state(job)) in jobs else next(iter(jobs)))
    if name not in jobs:
        raise OutputError(
            f"--shape {name}: is not a loaded state of {run}", f"Its loaded states are {', '.join(jobs)}."
        )
    return jobs[name]


def _given_state(job: Job) -> str:
    return next(own.name for own in job.states if own.given)


def unwritten_of_other_states(job: Job, *, is_given: bool) -> Iterator[str]:
    """Yield what of a state refers to the given body, if neither its rest shape nor its loaded one is that body."""
    if is_given:
        return
    for number, support in enumerate(job.supports):
        if support.remote is not None or (support.slides and support.normal is None):
            yield f"supports[{number}]: its point or its normals are of the given state"
    for number, effect in enumerate(job.effects):
        if getattr(effect, "density_in", "reference") == "current":
            yield f"effects[{number}]: its density is of the given state"
    for name, family in job.fibres.items():
        if family.given_on == "current":
            yield f"fibres.{name}: its direction is of the given state"
