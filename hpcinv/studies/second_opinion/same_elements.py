"""A rest shape loaded here with the elements of another program, so that only the programs differ."""

from __future__ import annotations

import tempfile
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import HpcinvError
from hpcinv.geometry.workshop.run_shapes import DEFORMED, read_shape
from hpcinv.interface import run as run_job
from hpcinv.job.job import Job, load
from hpcinv.job.rules import wants_pressure
from hpcinv.job.vocabulary import COORDINATES
from hpcinv.mesh.mesh_files import save
from hpcinv.mesh.source import Floats
from hpcinv.studies.second_opinion.equilibrium_near import equilibrium_near
from hpcinv.studies.second_opinion.loaded_body import LoadedBody
from hpcinv.studies.second_opinion.programs import Program

_OF_20_NODES = ("C3D20", "hex20")
_ON_GIVEN_BODY = ("first", "quantities", "expected_shape", "regions")
"""sections of a job that the forward run has not; the file of the rest shape has the regions, except vertices"""


def with_elements(
    job: Job, body: LoadedBody, program: Program, element: str, theirs: Floats
) -> tuple[Floats | None, str]:
    """Return the places (n, 3), m, of the rest shape under load with an element of a program, or why not.

    Its elements are ours without the unknown pressure, but for hexahedra of degree 2, which may have 20 nodes.

    Args:
        theirs: places (n, 3), m, of its nodes; of 20 nodes in a cell, those on edges.
    """
    if reason := _unlike(job, body, program, element):
        return None, reason
    if element not in _OF_20_NODES and not job.is_mixed:
        return body.loaded, ""
    if reason := _not_comparable(job, body, element):
        return None, reason
    try:
        with _forward_job(job, body, slides=element not in _OF_20_NODES) as (forward, directory):
            if element in _OF_20_NODES:
                near = partial(equilibrium_near, forward, body.rest, slides=body.slides, has_20_nodes=True)
                found = (near(start) for start in (body.loaded, theirs))
                places = next((places for places in found if places is not None), None)
                return places, "" if places is not None else "Newton's iteration with 20 nodes fails"
            run_job(forward, MPI.COMM_SELF, directory=directory / "run", progress=False)
            return read_shape(directory / "run", DEFORMED).points, ""
    except HpcinvError as error:
        return None, error.message.splitlines()[0]


def equilibrium_of(job: Job, body: LoadedBody, program: Program, element: str, theirs: Floats) -> Floats | None:
    """Return the places (n, 3), m, of our equilibrium with an element of a program that is next to its body.

    ``None`` if there is none, or if that is not known. Arguments as of `with_elements`.
    """
    if _unlike(job, body, program, element) or _not_comparable(job, body, element):
        return None
    if any(support.moves for support in job.supports):
        return None
    try:
        with _forward_job(job, body, slides=False) as (forward, _):
            is_edges = element in _OF_20_NODES
            return equilibrium_near(forward, body.rest, theirs, slides=body.slides, has_20_nodes=is_edges)
    except HpcinvError:
        return None


@contextmanager
def _forward_job(job: Job, body: LoadedBody, *, slides: bool) -> Iterator[tuple[Job, Path]]:
    """Yield the job that loads the rest shape without unknown pressure, and a directory while it is needed.

    Args:
        slides: whether it has the oblique slides of the body.
    """
    degree = job.discretisation.displacement
    changes: dict[str, Any] = {
        "analysis": "forward",
        "certificate": "off",
        "output": {"mesh": ["msh"], "fields": False},
        "discretisation": {"displacement": degree, "formulation": "displacement"},
    }
    with tempfile.TemporaryDirectory() as directory:
        file = Path(directory) / "rest.msh"
        save(file, body.rest, body.rest.points)
        mesh = {"file": str(file), "geometry_degree": degree}
        kept = {key: value for key, value in _data(job).items() if key not in _ON_GIVEN_BODY}
        if body.remotes:
            kept["supports"] = list(_with_points_at_rest(kept["supports"], body))
        if body.slides and not slides:
            kept["supports"] = list(_without_slides(kept["supports"], {slide.place for slide in body.slides}))
        points = {name: {"vertices": body.rest.points[rows].tolist()} for name, rows in body.vertices.items()}
        yield load({**kept, **changes, "mesh": mesh, "regions": points}, directory=job.resolve("")), Path(directory)


def _data(job: Job) -> Mapping[str, Any]:
    """Return what was written for a job, of a state with its loads and supports instead of all states'."""
    if not job.state:
        return job.data
    [own] = [state for state in job.data["states"] if state["name"] == job.state]
    state = {key: own[key] for key in ("effects", "supports") if key in own}
    return {key: value for key, value in job.data.items() if key != "states"} | state


def _with_points_at_rest(supports: Sequence[Mapping[str, Any]], body: LoadedBody) -> Iterator[Mapping[str, Any]]:
    """Yield supports whose remote loads have the place of their point in the rest body."""
    points = {remote.place: remote.point.tolist() for remote in body.remotes}
    for number, support in enumerate(supports):
        about = points.get(f"supports[{number}]")
        yield support if about is None else {**support, "remote": {**support["remote"], "about": about}}


def _without_slides(supports: Sequence[Mapping[str, Any]], places: Collection[str]) -> Iterator[dict[str, Any]]:
    """Yield what supports hold along axes."""
    for number, support in enumerate(supports):
        if f"supports[{number}]" not in places:
            yield dict(support)
        elif axes := [axis for axis in support["fix"] if axis != "normal"]:
            yield {"region": support["region"], "fix": axes}


def _unlike(job: Job, body: LoadedBody, program: Program, element: str) -> str:
    """Return why we have no such elements; empty if we have them."""
    if element == "S8R":
        return "ours have columns of three nodes, and it makes solids of one element through the thickness"
    if body.rest.degree != job.discretisation.displacement:
        return "our displacements are linear, and middle nodes of its elements move by themselves"
    return program.mixed if job.is_mixed or wants_pressure(job.laws) else ""


def _not_comparable(job: Job, body: LoadedBody, element: str) -> str:
    """Return why the forward run would have other supports than the deck; empty if it has the same."""
    moved = [support for support in job.supports if support.moves and support.remote is None]
    formulas = [formula for support in moved for formula in support.displacement or () if formula is not None]
    if any(formula.names & COORDINATES.keys() for formula in formulas):
        return "a support moves, as formulas of places on the given body say"
    if moved and element in _OF_20_NODES:
        return "a support moves, and ours have 27 nodes"
    if any(slide.plane_normal is None for slide in body.slides):
        return "a support slides on a curved face, whose normals are of the given body"
    if element in _OF_20_NODES and body.remotes:
        return "a region is rigid, and ours have 27 nodes"
    return ""
