"""Check that a body with planes of symmetry stays on its side of them."""

from __future__ import annotations

from dataclasses import dataclass

import dolfinx
import numpy as np

from hpcinv.job.job import Job
from hpcinv.job.sections import AXES, AxisName
from hpcinv.mesh import Body
from hpcinv.mesh.bounding_box import extent
from hpcinv.mesh.regions import LocalIndices
from hpcinv.mesh.source import Floats
from hpcinv.parallel.runtime import MPI

_ROUND_OFF = 1e-9  # of the body's diagonal


@dataclass(frozen=True)
class SymmetryPlane:
    """A plane of symmetry ``axis = position`` (m), and the depth (m) by which the moved body crosses it.

    What has crossed it lies inside of the body's mirror image.
    """

    region: str
    axis: AxisName
    position: float
    crossed: float


def symmetry_planes(job: Job, body: Body, given: Floats, moved: Floats) -> list[SymmetryPlane]:
    """Find the planes of symmetry among a job's supports; collective.

    A support makes one if it fixes one component alone, normal to the plane in which its region lies in the given body,
    if all of that body is on one side, and if all of the boundary in that plane is in the region: else it may be a rest
    beyond which the body is free to sag.

    Args:
        given, moved: local geometry nodes (n, 3) m of the body that the job gives, and of the one to check.
    """
    held: dict[str, set[AxisName]] = {}
    for support in job.supports:
        held[support.region] = held.get(support.region, set()) | support.held
    alone = [s for s in job.supports if s.fix is not None and len(held[s.region]) == 1]
    planes = (_plane(body, s.region, next(iter(s.held)), given, moved) for s in alone)
    return [plane for plane in planes if plane is not None]


def _plane(body: Body, region: str, axis: AxisName, given: Floats, moved: Floats) -> SymmetryPlane | None:
    comm, i = body.mesh.comm, AXES.index(axis)
    low, high = extent(comm, given)
    tolerance = _ROUND_OFF * float(np.linalg.norm(high - low))
    facets, boundary = body.facets(region), body.facets("boundary")
    first, last = (end[i] for end in extent(comm, given[_nodes(body, facets)].reshape(-1, 3)))
    if last - first > tolerance or (first - low[i] > tolerance and high[i] - last > tolerance):
        return None
    position, side = float(first + last) / 2, 1.0 if first - low[i] <= tolerance else -1.0
    flat = (np.abs(given[_nodes(body, boundary), i] - position) <= tolerance).all(axis=1)
    if comm.allreduce(len(np.setdiff1d(boundary[flat], facets))):
        return None
    depth = comm.allreduce(float((side * (position - moved[:, i])).max(initial=0.0)), op=MPI.MAX)
    return SymmetryPlane(region, axis, position, depth if depth > tolerance else 0.0)


def _nodes(body: Body, facets: LocalIndices) -> LocalIndices:
    """Return the geometry nodes of facets, one row for each."""
    if not len(facets):
        return np.zeros((0, 3), dtype=np.int32)
    return np.asarray(dolfinx.mesh.entities_to_geometry(body.mesh, 2, facets))
