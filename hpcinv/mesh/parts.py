"""Connected parts of a body."""

import numpy as np
from dolfinx import la

from hpcinv.base.parallel.runtime import MPI
from hpcinv.mesh.body import Body
from hpcinv.mesh.cells import sub_entities, vertex_count
from hpcinv.mesh.distributed.rows import Rows
from hpcinv.mesh.source import Ints
from hpcinv.mesh.topology import connected


def parts_of(body: Body, *, joined_by_facets: bool = False) -> tuple[int, Ints]:
    """Return the number of parts of the body, which share no node, and the part of each local cell; collective.

    Connected cells of one rank are a piece; pieces of different ranks that share a node belong to one part.
    Parts are numbered in the order of the source's cells.

    Args:
        joined_by_facets: parts that share no facet, but may share nodes.
    """
    comm, topology = body.mesh.comm, body.mesh.topology
    if joined_by_facets:
        joints = topology.index_map(2)
        topology.create_connectivity(3, 2)
        cells = topology.connectivity(3, 2).array.reshape(-1, len(sub_entities(body.source.kind, 2))).astype(np.int64)
    else:
        joints = body.mesh.geometry.index_map()
        cells = body.mesh.geometry.dofmaps[0][:, : vertex_count(body.source.kind)].astype(np.int64)
    owned = joints.size_local
    mine = connected(cells, owned + joints.num_ghosts)
    pieces = Rows.distributed(comm, int(mine.max(initial=-1)) + 1)
    mine += pieces.first
    joint_pieces = la.vector(joints, 1, np.int64)
    joint_pieces.array[cells] = mine[:, None]
    here = joint_pieces.array[owned:].copy()
    joint_pieces.scatter_forward()
    shared = np.unique(cells[cells >= owned]) - owned
    meeting = np.unique(np.stack([here, joint_pieces.array[owned:]])[:, shared], axis=1)
    joined = connected(np.hstack([*comm.allgather(meeting), np.tile(np.arange(pieces.total), (2, 1))]).T, pieces.total)
    part = joined[-pieces.total :]
    first = np.full(int(part.max()) + 1, np.iinfo(np.int64).max)
    np.minimum.at(first, part[mine], topology.original_cell_index)
    comm.Allreduce(MPI.IN_PLACE, first, MPI.MIN)
    return len(first), np.argsort(np.argsort(first))[part[mine]]
