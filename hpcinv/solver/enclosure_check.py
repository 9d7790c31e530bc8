"""Check that an incompressible body has a part of its surface that may move.

Where the motion along the normal is prescribed on the whole surface, the volume is prescribed twice, and the pressure
is known up to a constant only: the tangent is singular.
"""

import numpy as np
import numpy.typing as npt
from dolfinx.mesh import entities_to_geometry, exterior_facet_indices

from hpcinv.errors import MeshError
from hpcinv.job.job import Job
from hpcinv.job.sections import AXES
from hpcinv.mesh import Body
from hpcinv.mesh.boundary_shells import outer_facets
from hpcinv.mesh.regions import LocalIndices
from hpcinv.mesh.source import Floats
from hpcinv.parallel.runtime import MPI
from hpcinv.solver.rigid_motion_check import parts_of

_FLAT = 1e-9  # component of a facet's normal that counts as zero


def check_not_enclosed(job: Job, body: Body) -> None:
    """Check that the supports of an incompressible body leave a facet free to move along its normal; collective.

    Raises:
        MeshError: on all ranks, if they do not.
    """
    if not all(law.is_incompressible for law in job.laws.values()):
        return
    topology = body.mesh.topology
    facets = exterior_facet_indices(topology)
    facets = facets[facets < topology.index_map(2).size_local]
    _, areas = outer_facets(body.mesh, facets)
    links = topology.connectivity(2, 3)
    count, labels = parts_of(body)
    of_part = labels[links.array[links.offsets[facets]]]
    faces = np.abs(areas) > _FLAT * np.linalg.norm(areas, axis=1, keepdims=True)
    faces[~_are_flat(body, facets, areas)] = True  # curved: nothing is known of the normals
    for i, axis in enumerate(AXES):
        held = [body.facets(support.region) for support in job.supports if axis in support.held]
        faces[np.isin(facets, np.concatenate(held)) if held else slice(0), i] = False
    free = np.zeros(count, dtype=np.int64)
    free[of_part[faces.any(axis=1)]] = 1
    body.mesh.comm.Allreduce(MPI.IN_PLACE, free, MPI.MAX)
    if not free.all():
        what = "an incompressible body" if count == 1 else f"a part of an incompressible body (of {count} parts)"
        raise MeshError(
            f"supports: prescribe the motion of the whole surface of {what}, whose volume cannot change: its"
            " pressure is known up to a constant only",
            "Leave a part of the surface free, or give the law a bulk modulus.",
        )


def _are_flat(body: Body, facets: LocalIndices, areas: Floats) -> npt.NDArray[np.bool_]:
    """Return whether all nodes of each facet with this area vector lie in one plane."""
    if not len(facets):
        return np.zeros(0, dtype=np.bool_)
    nodes = body.mesh.geometry.x[entities_to_geometry(body.mesh, 2, facets)]
    heights = np.einsum("fni,fi->fn", nodes - nodes[:, :1], areas)
    return np.asarray(np.abs(heights).max(axis=1) <= _FLAT * np.linalg.norm(areas, axis=1) ** 1.5)
