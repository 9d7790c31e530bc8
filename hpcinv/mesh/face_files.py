"""Facets of a mesh by surfaces of triangles in files of their own, such as SimVascular's mesh-surfaces/inlet.vtp."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from hpcinv.errors import MeshError
from hpcinv.mesh.cells import vertex_count
from hpcinv.mesh.facet_groups import add_facets
from hpcinv.mesh.io.isolated import read_isolated
from hpcinv.mesh.source import Floats, Ints, MeshSource
from hpcinv.mesh.topology import FacetTable

_NEAR = 0.01
"""distance of a vertex from a node, relative to the shortest edge of its triangle, up to which they are one; files have
coordinates of 7 digits. Raised, a vertex may be taken for a node next to it."""


def add_face_files(source: MeshSource, faces: Mapping[str, Sequence[Path]], unit: float) -> MeshSource:
    """Return the mesh with a group of facets for each name, whose triangles are in files.

    Args:
        unit: of the coordinates in the files (m).

    Raises:
        MeshError: a file cannot be read, or has triangles that are not facets of the mesh.
    """
    if source.kind != "tetrahedron":
        raise MeshError(f"{source.path}: mesh.faces: has {source.kind}s, and faces are triangles", "Use tetrahedra.")
    vertices = source.cells[:, : vertex_count(source.kind)]
    used = np.unique(vertices)
    table = FacetTable.build(source.kind, vertices)
    sides = {}
    for name, files in faces.items():
        if any(group.name == name for group in source.groups):
            raise MeshError(f"{source.path}: mesh.faces.{name}: is a group of the mesh already", "Choose another name.")
        rows = [_facets_of(source, file, f"mesh.faces.{name}", unit, used, table) for file in files]
        sides[name] = table.owners(np.concatenate(rows))
    return add_facets(source, sides)


def _facets_of(source: MeshSource, file: Path, where: str, unit: float, used: Ints, table: FacetTable) -> Ints:
    """Rows of the facets of the mesh that are the triangles of a file."""
    from scipy.spatial import KDTree  # here, since few runs need it

    _, arrays = read_isolated("surface", file, "cannot be read as a surface", "Is the file complete?")
    triangles = np.asarray(arrays.get("triangles", np.zeros((0, 3))), dtype=np.int64)
    if not len(triangles):
        raise MeshError(f"{file}: {where} has no triangles", "Give the surface of a region in each file.")
    places: Floats = np.asarray(arrays["points"], dtype=np.float64) * unit
    corners = places[triangles]
    shortest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).min(axis=1)
    distance, nearest = KDTree(source.points[used]).query(places)
    rows = table.find(used[nearest][triangles])
    is_far = distance[triangles].max(axis=1) > _NEAR * shortest
    wrong = is_far | (rows < 0)
    if wrong.any():
        first = corners[np.flatnonzero(wrong)[0]].mean(axis=0)
        place = ", ".join(f"{x:g}" for x in first)
        raise MeshError(
            f"{file}: {wrong.sum():,} of {len(wrong):,} triangles of {where} are not facets of the mesh,"
            f" as near ({place}) m",
            f"Give surfaces of this mesh, in its unit; these are {distance[triangles][wrong].max():.3g} m from nodes.",
        )
    return rows
