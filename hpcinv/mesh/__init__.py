"""Meshes: read or generated on rank 0, checked and partitioned, or read in parts; distributed as a ``Body``."""

import hpcinv.base.parallel.runtime  # noqa: F401  (first: it fixes the import order)

# isort: split
from hpcinv.mesh.body import Body, build_body, read_source, reorder_to_source
from hpcinv.mesh.mesh_files import write_mesh
from hpcinv.mesh.source import MeshSource

__all__ = ["Body", "MeshSource", "build_body", "read_source", "reorder_to_source", "write_mesh"]
