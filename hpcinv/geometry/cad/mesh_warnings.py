"""What the mesh of a CAD file warns of: small rounded faces, whose edges make it large, and walls of one cell."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from hpcinv.base.quantity.units import readable
from hpcinv.mesh.cell_count import rounded
from hpcinv.mesh.cells import sub_entities, vertex_count
from hpcinv.mesh.source import Floats, Ints, MeshSource
from hpcinv.mesh.topology import FacetTable, find_rows, unique_rows

_MANY = 5000
"""Cells from which features are looked for; smaller meshes are solved in seconds."""
_TIMES = 10.0
"""Cells relative to a mesh of equal cells from which features are named; thin walls alone make 3 to 8."""
_REGULAR = 6 * math.sqrt(2)
"""Regular tetrahedra in the cube of their edge."""

_OPPOSITE = -0.7
"""cosine between the outward normals of a wall's sides; raised, edges across corners count as walls"""
_ALONG = 0.7
"""cosine between an edge through a wall and the normals; lowered, slanted edges count, which do not cross it"""


def report_small_features(gmsh: Any, size: float, grade: float, unit: float, report: Callable[[str], None]) -> None:
    """Report the smallest rounded face of a meshed model, if such faces make most of its cells.

    Args:
        size: largest edge, in the unit of the file.
        grade: ``size`` over the smallest edge.
        unit: of the file, in m.
    """
    cells = sum(len(tags) for tags in gmsh.model.mesh.getElements(3)[1])
    volume = sum(gmsh.model.occ.getMass(3, tag) for _, tag in gmsh.model.getEntities(3))
    times = cells / max(volume / size**3 * _REGULAR, 1.0)
    if cells < _MANY or times < _TIMES or grade <= 1:
        return
    radii = {tag: _radius(gmsh, tag) for _, tag in gmsh.model.getEntities(2)}
    face = min(radii, key=lambda tag: radii[tag])
    if not radii[face] < size:
        return
    names = [gmsh.model.getPhysicalName(2, group) for group in gmsh.model.getPhysicalGroupsForEntity(2, face)]
    coarser = max(grade / 2, 1.0)
    report(
        f"{rounded(cells)} cells, {times:.0f} times as many as equal cells of mesh.size: rounded faces such as "
        f"{next(iter(names), f'face {face}')} (radius {readable(radii[face] * unit, 'm')}) have edges down to "
        f"{readable(size / grade * unit, 'm')}. Where they do not matter, take mesh.grade {coarser:.3g}: edges of "
        f"{readable(size / coarser * unit, 'm')} and more"
    )


def _radius(gmsh: Any, face: int) -> float:
    """Return the smallest radius of curvature in the middle of a face; infinite if it is plane."""
    if gmsh.model.getType(2, face) == "Plane":
        return math.inf
    low, high = (np.array(ends) for ends in gmsh.model.getParametrizationBounds(2, face))
    largest, smallest, _, _ = gmsh.model.getPrincipalCurvatures(face, list((low + high) / 2))
    curvature = max(abs(float(largest[0])), abs(float(smallest[0])))
    return 1 / curvature if curvature > 0 else math.inf


def report_thin_walls(source: MeshSource, report: Callable[[str], None]) -> None:
    """Report where edges of single cells go from one side of a wall to the other; points are in m."""
    edges = edges_through_walls(source)
    if len(edges):
        lengths = np.linalg.norm(source.points[edges[:, 1]] - source.points[edges[:, 0]], axis=1)
        first = int(lengths.argmin())
        place = ", ".join(f"{x:.4g}" for x in source.points[edges[first]].mean(axis=0))
        size = readable(float(lengths[first]) / 2, "m")
        report(f"warning: walls have one cell through them, as near ({place}) m: take mesh.size {size} for two there")


def edges_through_walls(source: MeshSource) -> Ints:
    """Return the vertices (n, 2) of the edges that lead from a boundary to the opposite one through the body."""
    vertices = source.cells[:, : vertex_count(source.kind)]
    table = FacetTable.build(source.kind, vertices)
    boundary = np.flatnonzero(table.sharing == 1)
    normals = _normals(source, vertices, table, boundary)
    edges, _ = unique_rows(np.sort(vertices[:, sub_entities(source.kind, 1)].reshape(-1, 2), axis=1))
    owners = table.owners(boundary)
    local = sub_entities(source.kind, 2)
    faces = vertices[owners[:, 0, None], local[owners[:, 1]]]
    order = [0, 1, 2] if faces.shape[1] == 3 else [0, 1, 3, 2]
    sides = np.stack([faces[:, order], np.roll(faces[:, order], -1, axis=1)], axis=2).reshape(-1, 2)
    is_inside = find_rows(edges, unique_rows(np.sort(sides, axis=1))[0]) < 0
    a, b = edges.T
    steps = source.points[b] - source.points[a]
    lengths = np.linalg.norm(steps, axis=1)
    facing = np.einsum("ni,ni->n", normals[a], normals[b]) < _OPPOSITE
    along = np.abs(np.einsum("ni,ni->n", steps, normals[a])) > _ALONG * lengths
    return np.asarray(edges[is_inside & facing & along])


def _normals(source: MeshSource, vertices: Ints, table: FacetTable, boundary: Ints) -> Floats:
    """Return the mean outward normal of the boundary at each node; zero elsewhere, and short at sharp edges."""
    owners = table.owners(boundary)
    local = sub_entities(source.kind, 2)
    faces = vertices[owners[:, 0, None], local[owners[:, 1]]]
    corners = source.points[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    outward = corners.mean(axis=1) - source.points[vertices[owners[:, 0]]].mean(axis=1)
    normal *= np.sign(np.einsum("ni,ni->n", normal, outward))[:, None]
    total, weight = np.zeros((len(source.points), 3)), np.zeros(len(source.points))
    for column in faces.T:
        np.add.at(total, column, normal)
        np.add.at(weight, column, np.linalg.norm(normal, axis=1))
    return np.asarray(np.divide(total, weight[:, None], out=total, where=weight[:, None] > 0))
