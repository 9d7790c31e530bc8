"""Check that an incompressible body has a part of its surface that may move.

Where the motion along the normal is prescribed on the whole surface, the volume is prescribed twice, and the pressure
is known up to a constant only: the tangent is singular.
"""

from __future__ import annotations

import numpy as np
from dolfinx.mesh import exterior_facet_indices

from hpcinv.errors import MeshError
from hpcinv.job.job import Job
from hpcinv.job.sections import AXES
from hpcinv.mesh import Body
from hpcinv.mesh.surface import facet_areas
from hpcinv.parallel.runtime import MPI

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
    areas = facet_areas(body.mesh, facets)
    faces = np.abs(areas) > _FLAT * np.linalg.norm(areas, axis=1, keepdims=True)
    if body.source.degree > 1:  # facets may be curved
        faces[:] = True
    for i, axis in enumerate(AXES):
        held = [body.facets(support.region) for support in job.supports if axis in support.held]
        faces[np.isin(facets, np.concatenate(held)) if held else slice(0), i] = False
    if not body.mesh.comm.allreduce(bool(faces.any()), op=MPI.LOR):
        raise MeshError(
            "supports: prescribe the motion of the whole surface of an incompressible body, whose volume cannot change:"
            " its pressure is known up to a constant only",
            "Leave a part of the surface free, or give the law a bulk modulus.",
        )
