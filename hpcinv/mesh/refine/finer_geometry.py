"""True geometry of a body: the same cells with a geometry of higher degree.

It is known for generators, which put the nodes of a higher degree on the CAD surfaces, and for mesh files of degree 2
that a job reads as degree 1.
"""

import dataclasses
from collections.abc import Callable

import basix
import dolfinx
import numpy as np
from dolfinx import fem

from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import MeshError
from hpcinv.mesh.cells import (
    FACET_KIND,
    coordinate_element,
    jacobians,
    no_cells,
    scalar_element,
    sub_entities,
    vertex_count,
)
from hpcinv.mesh.checks import CHUNK, determinants
from hpcinv.mesh.regions import Mesh
from hpcinv.mesh.source import NO_CAD, CadSurface, FinerGeometry, Floats, Ints, MeshSource
from hpcinv.mesh.topology import FacetTable, find_rows, unique_rows, vertex_sets

SAME = (
    1e-6  # distance of nodes, relative to the cell size, up to which they count as the same (rounding of the generator)
)
ROUNDING = 1e-14  # distance from the surface, relative to the body, up to which a node stays where it is
EDGE = 0.0025  # smallest ratio of eigenvalues of the sum of n⊗n at an edge: about 0.1 rad between normals
# Share of its least determinant that each cell of this degree must keep. Cubic displacements cannot turn cells of
# degree 4 without strain, which matters where these differ much from cells of degree 2.
KEPT = {1: 0.0, 2: 0.5}
INVERTED = "cells with a geometry of degree {} would be inverted, or nearly so"
OTHER_CELLS = "its generator or file gives other cells"


def file_geometry(source: MeshSource, read: Callable[[], MeshSource]) -> FinerGeometry:
    """Geometry of a mesh file, which ``read`` returns, beyond the degree of ``source``; not collective."""
    try:
        whole = read()
    except MeshError as error:
        return FinerGeometry(f"the mesh file could not be read again: {error}")
    if whole.degree <= source.degree:
        return FinerGeometry(NO_CAD)
    corners = [s.points[s.cells[:, : vertex_count(s.kind)]] for s in (source, whole)]
    alike = corners[0].shape == corners[1].shape
    if not alike or np.abs(corners[0] - corners[1]).max() > SAME * _sizes(corners[0]).min():
        return FinerGeometry("" if _agrees(1, corners[1], whole) else OTHER_CELLS)
    if _agrees(source.degree, source.points[source.cells], whole):
        return FinerGeometry()
    return FinerGeometry(source=whole) if _least(whole).min() > 0 else FinerGeometry(INVERTED.format(whole.degree))


def surface_geometry(source: MeshSource) -> FinerGeometry:
    """Geometry of the CAD model that a generator meshed, for its mesh or a refinement of that; not collective.

    Cells of degree 1 become cells of degree 2, and cells of degree 2 become cells of degree 4, whose nodes inside the
    body are where the given cells have them. The cells of a refined mesh are others; their geometry is the true one
    only if all faces of the body are flat.
    """
    surface, kind = source.surface, source.kind
    if surface is None or not _is_closed(kind, surface):
        return FinerGeometry(NO_CAD)
    if _is_flat(kind, surface):
        return FinerGeometry()
    table = FacetTable.build(kind, source.cells[:, : vertex_count(kind)])
    vertices = find_rows(surface.vertices.reshape(-1, 1), source.node_tags[:, None]).reshape(surface.vertices.shape)
    facets = np.where((vertices < 0).any(axis=1), -1, table.find(vertices))
    has_cell = facets >= 0
    corners = source.points[vertices[has_cell]]
    moved = np.abs(corners - surface.nodes[has_cell, : corners.shape[1]]).max(initial=0.0)
    covered = np.isin(np.flatnonzero(table.sharing == 1), facets).all()
    if not covered or moved > SAME * _sizes(corners).min():
        return FinerGeometry(OTHER_CELLS)
    given = _raise_geometry(source, surface.degree)
    return _admissible(given, _points_on_surface(given, surface, table, facets), KEPT[source.degree])


def _is_closed(kind: str, surface: CadSurface) -> bool:
    """Return whether each edge of the facets of a surface has two of them: the mesh of an open one lacks facets."""
    edges = vertex_sets(surface.vertices, sub_entities(FACET_KIND[kind], 1))
    return len(edges) > 0 and int(np.bincount(unique_rows(edges)[1]).min()) > 1


def _is_flat(kind: str, surface: CadSurface) -> bool:
    """Return whether all facets of a surface of cells of this ``kind`` are flat."""
    facet_kind = FACET_KIND[kind]
    shapes = _shapes(facet_kind, 1, scalar_element(facet_kind, surface.degree).points)
    offsets = surface.nodes - shapes @ surface.nodes[:, : surface.vertices.shape[1]]
    return bool((np.linalg.norm(offsets, axis=2).max(axis=1) <= SAME * _sizes(surface.nodes)).all())


def _raise_geometry(source: MeshSource, degree: int) -> MeshSource:
    """The same cells with a geometry of a higher ``degree``; facets and data are lost."""
    kind, vertices = source.kind, np.unique(source.cells[:, : vertex_count(source.kind)])
    corners = np.searchsorted(vertices, source.cells[:, : vertex_count(kind)])
    mesh = dolfinx.mesh.create_mesh(MPI.COMM_SELF, corners, coordinate_element(kind, 1), source.points[vertices])
    numbered = fem.functionspace(mesh, ("Lagrange", degree)).dofmap.list
    cells = np.empty(numbered.shape, dtype=np.int64)
    cells[mesh.topology.original_cell_index] = numbered
    points = np.empty((int(cells.max()) + 1, 3))
    shapes = _shapes(kind, source.degree, scalar_element(kind, degree).points)
    for part in _chunks(np.arange(len(cells))):
        points[cells[part]] = shapes @ source.points[source.cells[part]]
    return dataclasses.replace(
        source,
        degree=degree,
        points=points,
        node_tags=np.arange(1, len(points) + 1),
        cells=cells,
        facets=no_cells(FACET_KIND[kind], degree),
        groups=tuple(group for group in source.groups if group.dim == 3),
        data={},
        surface=None,
        surface_cells=None,
    )


def _points_on_surface(mesh: MeshSource, surface: CadSurface, table: FacetTable, facets: Ints) -> Floats:
    """Points of a mesh of the degree of ``surface``, moved onto that along the normals.

    Degree 3 would be no better than degree 2, because interpolation at equidistant nodes gains an order at even
    degrees. Nodes do not move along the surface: otherwise finite-element spaces would approximate smooth functions on
    the cells of degree 2 less well.

    Args:
        table: of the cells of ``mesh``.
        facets: facet in that table of each one of ``surface``, -1 for none.
    """
    kind, degree, points = mesh.kind, mesh.degree, mesh.points
    element = scalar_element(kind, degree)
    straight = _shapes(FACET_KIND[kind], 1, scalar_element(FACET_KIND[kind], degree).points)
    corners_of = basix.geometry(basix.CellType[kind])[sub_entities(kind, 2)]
    tangent_axes = corners_of[:, 1:3] - corners_of[:, :1]  # two tangents of each facet of the reference cell
    dyads, heights = np.zeros((len(points), 3, 3)), np.zeros_like(points)  # sums of n⊗n, and of n times a height
    facet_cell = np.empty(len(table.vertices), dtype=np.int64)
    facet_cell[table.cell_facets] = np.arange(len(table.cell_facets))[:, None]
    cell = facet_cell[facets]
    for local, vertices in enumerate(sub_entities(kind, 2)):
        dofs = np.array(element.entity_closure_dofs[2][local])
        flat_shapes = _shapes(kind, 1, element.points[dofs])[:, vertices]
        for part in _chunks(np.flatnonzero((facets >= 0) & (table.cell_facets[cell, local] == facets))):
            cells = mesh.cells[cell[part]]
            nodes = cells[:, dofs]
            # A facet may begin with another vertex than the cell's: nodes are matched by their weights of the vertices.
            corners = _nearest(points[cells[:, vertices]], surface.nodes[part, : len(vertices)])
            turns, turn = np.unique(corners, axis=0, return_inverse=True)
            match = _nearest(flat_shapes, straight[:, turns].swapaxes(0, 1))[turn]
            tangents = jacobians(kind, degree, points[cells], element.points[dofs]) @ tangent_axes[local].T
            normal = np.cross(tangents[..., 0], tangents[..., 1])
            normal /= np.linalg.norm(normal, axis=2, keepdims=True)
            height = np.sum(normal * (surface.nodes[part[:, None], match] - points[nodes]), axis=2)
            np.add.at(dyads, nodes, normal[..., :, None] * normal[..., None, :])
            np.add.at(heights, nodes, normal * height[..., None])
    moved_nodes = np.flatnonzero(
        np.abs(heights).max(axis=1) > ROUNDING * np.ptp(surface.nodes.reshape(-1, 3), axis=0).max()
    )
    share, directions = np.linalg.eigh(dyads[moved_nodes])
    used = share > EDGE * share[:, -1:]
    components = np.einsum("nji,nj->ni", directions, heights[moved_nodes]) * used / np.where(used, share, 1.0)
    moved = points.copy()
    moved[moved_nodes] += np.einsum("nij,nj->ni", directions, components)
    return moved


def _nearest(points: Floats, others: Floats) -> Ints:
    """Number (…, n) of the nearest one of ``others`` (…, m, d) to each of some points (…, n, d)."""
    return np.asarray(np.linalg.norm(points[..., :, None, :] - others[..., None, :, :], axis=-1).argmin(axis=-1))


def _admissible(given: MeshSource, points: Floats, least: float) -> FinerGeometry:
    """Geometry of cells whose nodes are moved to ``points``, if each keeps more of its least determinant."""
    is_moved = (points != given.points).any(axis=1)
    affected = dataclasses.replace(given, cells=given.cells[is_moved[given.cells].any(axis=1)])
    if (_least(dataclasses.replace(affected, points=points)) <= least * _least(affected)).any():
        return FinerGeometry(INVERTED.format(given.degree))
    return FinerGeometry(source=dataclasses.replace(given, points=points))


def _least(source: MeshSource) -> Floats:
    """Smallest determinant (c,) of each cell, relative to its size, and positive in cells that are not inverted."""
    least, most = determinants(source)
    return least if np.count_nonzero(least > 0) >= np.count_nonzero(most < 0) else -most


def _agrees(degree: int, nodes: Floats, finer: MeshSource) -> bool:
    """Return whether cells of this ``degree`` with ``nodes`` (c, n, 3) have the geometry of ``finer``."""
    shapes = _shapes(finer.kind, degree, scalar_element(finer.kind, finer.degree).points)
    for start in range(0, len(nodes), CHUNK):
        part = slice(start, start + CHUNK)
        offsets = finer.points[finer.cells[part]] - shapes @ nodes[part]
        if (np.linalg.norm(offsets, axis=2).max(axis=1) > SAME * _sizes(nodes[part])).any():
            return False
    return True


def _sizes(nodes: Floats) -> Floats:
    """Diagonals (c,) of the bounding boxes of cells with nodes (c, n, 3)."""
    return np.asarray(np.linalg.norm(np.ptp(nodes, axis=1), axis=1))


def _shapes(kind: str, degree: int, reference_points: Floats) -> Floats:
    """Shape functions (points, nodes) of the coordinate element at points of the reference cell."""
    return np.asarray(scalar_element(kind, degree).tabulate(0, reference_points)[0, :, :, 0])


def _chunks(cells: Ints) -> list[Ints]:
    return np.array_split(cells, 1 + len(cells) // CHUNK)


def transfer_function(mesh: Mesh, function: fem.Function) -> fem.Function:
    """The function with the same reference coordinates on another mesh of the same cells (see `replace_geometry`)."""
    given = function.function_space
    if given.mesh is mesh:
        return function
    taken = fem.Function(fem.functionspace(mesh, given.ufl_element()), name=function.name)
    here, there = taken.function_space.dofmap, given.dofmap
    taken.x.array.reshape(-1, here.bs)[here.list] = function.x.array.reshape(-1, there.bs)[there.list]
    return taken
