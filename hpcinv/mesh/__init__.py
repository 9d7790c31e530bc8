"""Meshes: read or generated on rank 0, checked, partitioned, and given to all ranks as a ``Body``."""

from __future__ import annotations

import hpcinv.runtime  # noqa: F401  (its import order first)

# isort: split
from hpcinv.mesh.body import Body, build_body, gather_nodes, read_source
from hpcinv.mesh.export import write_mesh, write_msh, write_vtu
from hpcinv.mesh.partition import Partition
from hpcinv.mesh.regions import Region
from hpcinv.mesh.source import Group, MeshSource

__all__ = [
    "Body",
    "Group",
    "MeshSource",
    "Partition",
    "Region",
    "build_body",
    "gather_nodes",
    "read_source",
    "write_mesh",
    "write_msh",
    "write_vtu",
]
