"""Check that a body with planes of symmetry stays on its side of them."""

from __future__ import annotations

from dataclasses import dataclass

import dolfinx
import numpy as np

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.arrays import LocalIndices
from hpcinv.job.job import Job
from hpcinv.job.support import Support
from hpcinv.job.vocabulary import AXES
from hpcinv.mesh import Body
from hpcinv.mesh.extent import extent
from hpcinv.mesh.source import Floats

_ROUND_OFF = 1e-9  # of the body's diagonal


@dataclass(frozen=True)
class SymmetryPlane:
    """A plane of symmetry ``normal·x = position`` (m), and the depth (m) by which the moved body crosses it.

    What has crossed it lies inside of the body's mirror image.
    """

    region: str
    normal: Floats
    position: float
    crossed: float


def symmetry_planes(job: Job, body: Body, mesh_nodes: Floats, other_nodes: Floats) -> list[SymmetryPlane]:
    """Find the planes of symmetry among a job's supports; collective.

    A support makes a plane of symmetry if it fixes one direction alone, normal to the plane in which its region lies.
    The given body must lie on one side, and its boundary in that plane in the region. Else the support may be a rest,
    and next to it the body is free to sag.

    Args:
        mesh_nodes: local geometry nodes (n, 3) m of the given body.
        other_nodes: of the body to check.
    """
    held: dict[str, set[str]] = {}
    for support in job.supports:
        held[support.region] = held.get(support.region, set()).union(support.components)
    alone = [s for s in job.supports if s.fix is not None and len(held[s.region]) == 1]
    alone = [s for s in alone if 2 in body.held_entities(s.region)]
    planes = (_plane(body, s.region, _direction(body, s, mesh_nodes), mesh_nodes, other_nodes) for s in alone)
    return [plane for plane in planes if plane is not None]


def _direction(body: Body, support: Support, mesh_nodes: Floats) -> Floats:
    """Return the unit vector along which a support holds its region, the normal of a facet if it is a normal."""
    if not support.slides:
        axis: Floats = np.eye(3)[AXES.index(next(iter(support.held)))]
        return axis
    direction = np.zeros(3) if support.normal is None else np.array(support.normal)
    if support.normal is None:
        corners = mesh_nodes[_nodes(body, body.facets(support.region))[:, :3]]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        candidates = body.mesh.comm.allgather(normals[0] if len(normals) else None)
        direction = next((normal for normal in candidates if normal is not None), direction)
    size = float(np.linalg.norm(direction))
    return direction / size if size else np.eye(3)[0]


def _plane(body: Body, region: str, normal: Floats, mesh_nodes: Floats, other_nodes: Floats) -> SymmetryPlane | None:
    comm = body.mesh.comm
    low, high = extent(comm, mesh_nodes)
    tolerance = _ROUND_OFF * float(np.linalg.norm(high - low))
    facets, boundary = body.facets(region), body.facets("boundary")
    lowest, highest = _range(comm, mesh_nodes @ normal)
    first, last = _range(comm, (mesh_nodes[_nodes(body, facets)] @ normal).ravel())
    if last - first > tolerance or (first - lowest > tolerance and highest - last > tolerance):
        return None
    position, side = (first + last) / 2, 1.0 if first - lowest <= tolerance else -1.0
    flat = (np.abs(mesh_nodes[_nodes(body, boundary)] @ normal - position) <= tolerance).all(axis=1)
    if comm.allreduce(len(np.setdiff1d(boundary[flat], facets))):
        return None
    depth = comm.allreduce(float((side * (position - other_nodes @ normal)).max(initial=0.0)), op=MPI.MAX)
    return SymmetryPlane(region, normal, position, depth if depth > tolerance else 0.0)


def _range(comm: MPI.Intracomm, values: Floats) -> tuple[float, float]:
    low = comm.allreduce(float(values.min(initial=np.inf)), op=MPI.MIN)
    return low, comm.allreduce(float(values.max(initial=-np.inf)), op=MPI.MAX)


def _nodes(body: Body, facets: LocalIndices) -> LocalIndices:
    """Return the geometry nodes of facets, one row for each."""
    if not len(facets):
        return np.zeros((0, 3), dtype=np.int32)
    return np.asarray(dolfinx.mesh.entities_to_geometry(body.mesh, 2, facets))
