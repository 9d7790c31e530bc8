"""Regions of a mesh by their names."""

from __future__ import annotations

from hpcinv.errors import OutputError
from hpcinv.mesh.source import Group, MeshSource


def group_of(mesh: MeshSource, region: str, dim: int = 2) -> Group:
    """Return a region of facets, or of cells (``dim`` 3).

    Raises:
        OutputError: the mesh file has none of this name.
    """
    for group in mesh.groups:
        if (group.name, group.dim) == (region, dim):
            return group
    raise OutputError(
        f"{mesh.path}: has no region '{region}' of {dim} dimensions",
        "Name a group of the mesh, or define it in the job.",
    )
