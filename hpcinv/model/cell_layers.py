"""Layers of a body on its mesh.

Where the law, its parameters or the inelastic stretch jump, so does the pressure of the mixed form, and a continuous
one is wrong by the jump in the cells at the interface. So each layer has the Taylor–Hood pair of spaces, with
pressures of its own at the interface, and the displacement, which is continuous, connects them (`Unknowns`).
"""

import numpy as np
from dolfinx import la

from hpcinv.base.parallel.runtime import MPI
from hpcinv.job.job import Job
from hpcinv.mesh import Body
from hpcinv.mesh.source import Ints
from hpcinv.model.fields import parts


def layers_of_cells(job: Job, body: Body) -> Ints | None:
    """Return a number for the layer of each local cell, ``None`` if the body is one; collective.

    Raises:
        MeshError: on all ranks, if a cell is in no region or in two.
    """
    if not job.is_mixed or not (layerings := job.layerings):
        return None
    cells = body.mesh.topology.index_map(3)
    laws = [name.removeprefix("material.") for name in job.laws]
    cell_laws = np.zeros(cells.size_local + cells.num_ghosts, dtype=np.int64)
    layers = np.zeros_like(cell_laws)
    for layering in layerings:
        names = list(layering.classes)
        number = np.array([*layering.classes.values(), 0])[parts(body, names, "material")]
        if layering.law is not None:
            number[cell_laws != layering.law] = 0
        elif names == laws and layering is layerings[0]:
            cell_laws = number
        layers = layers * (1 + max(layering.classes.values())) + number  # the same on all meshes of the body
    vector = la.vector(cells, dtype=np.int64)
    vector.array[: cells.size_local] = layers[: cells.size_local]
    vector.scatter_forward()  # only the owner of a ghost is sure to have its region
    numbers: Ints = vector.array.copy()
    return numbers if len(layers_on(body.mesh.comm, numbers)) > 1 else None


def layers_on(comm: MPI.Intracomm, layers: Ints) -> Ints:
    """Return the layers that any rank has, in ascending order; collective."""
    return np.unique(np.concatenate(comm.allgather(np.unique(layers))))
