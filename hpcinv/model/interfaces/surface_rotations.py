"""Rotations of a surface around its nodes, from one place of its facets to another."""

from __future__ import annotations

import numpy as np

from hpcinv.base.parallel.runtime import MPI
from hpcinv.mesh.source import Floats, Ints


def surface_rotations(names: Ints, nodes: Ints, before: Floats, after: Floats, comm: MPI.Intracomm) -> Floats:
    """Return the rotation (n, 3, 3) of the facets around each node that fits best; collective.

    A rigid motion of the surface has its exact rotation, with its spin about the normals.

    Args:
        names: sorted global numbers of the nodes, on all ranks.
        nodes: global numbers of the facets' nodes on this rank, (facets, k); some of them are not among the names.
        before, after: places of the facets' nodes, (facets, k, 3).

    Source: Kabsch (1976), doi:10.1107/S0567739476001873.
    """
    facet, corner = np.nonzero(np.isin(nodes, names))
    places = np.searchsorted(names, nodes[facet, corner])
    count, size = len(names), nodes.shape[1] if len(nodes) else 1
    sums = np.zeros((count, 7))
    values = np.concatenate(
        [before[facet].sum(axis=1), after[facet].sum(axis=1), np.full((len(facet), 1), size)], axis=1
    )
    np.add.at(sums, places, values)
    comm.Allreduce(MPI.IN_PLACE, sums, MPI.SUM)
    middles = sums[:, :6] / np.maximum(sums[:, 6:], 1.0)
    old, new = before[facet] - middles[places, None, :3], after[facet] - middles[places, None, 3:]
    moments = np.zeros((count, 3, 3))
    np.add.at(moments, places, np.einsum("nka,nkb->nab", new, old))
    comm.Allreduce(MPI.IN_PLACE, moments, MPI.SUM)
    left, _, right = np.linalg.svd(moments)
    left[:, :, 2] *= np.sign(np.linalg.det(left) * np.linalg.det(right))[:, None]  # the least of the three
    rotations: Floats = left @ right
    return rotations
