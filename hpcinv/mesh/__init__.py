"""Meshes: read or generated on rank 0, checked and partitioned, or read in parts; distributed as a ``Body``."""

import hpcinv.parallel.runtime  # noqa: F401  (first: it fixes the import order)

# isort: split
from hpcinv.mesh.body import Body, at_local_nodes, build_body, in_source_order, read_source
from hpcinv.mesh.distributed.partition import Partition
from hpcinv.mesh.export import write_mesh
from hpcinv.mesh.regions import Region
from hpcinv.mesh.source import Group, MeshSource

__all__ = [
    "Body",
    "Group",
    "MeshSource",
    "Partition",
    "Region",
    "at_local_nodes",
    "build_body",
    "in_source_order",
    "read_source",
    "write_mesh",
]
