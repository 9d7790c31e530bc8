"""Tetrahedra between smooth surfaces of labels: much faster than by coarsening a lattice, where surfaces are clean."""

from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
from scipy import ndimage
from scipy.sparse import coo_array

from hpcinv.base.parallel.signals import handlers_restored
from hpcinv.base.parallel.standard_output import muted_output
from hpcinv.geometry.imaging.image_files import package
from hpcinv.geometry.imaging.label_boundary import Memberships, limit_steps, two_label_nodes
from hpcinv.geometry.imaging.lattice import Lattice, interfaces, lattice_of
from hpcinv.geometry.imaging.wall_sizes import WallSizes
from hpcinv.mesh.cells import sub_entities
from hpcinv.mesh.io.gmsh_model import session
from hpcinv.mesh.source import Floats, Ints
from hpcinv.mesh.topology import connected, unique_rows, vertex_sets

MMG = "images are meshed by MMG (mmgpy)"
_ROUNDS = 4  # of smoothing
_WITHIN = 0.08  # distance by which MMG may move surfaces, relative to the size of cells
_FINEST = 0.4  # smallest edge of surfaces, relative to the size of cells
_HXT = 10
_COARSE = 1.2  # edges of surfaces whose tetrahedra are as large as the ones MMG makes


def cells_between_surfaces(
    labels: Ints, begin: Floats, spacing: float, memberships: Memberships, sizes: WallSizes
) -> tuple[Lattice | None, str]:
    """Return cells between the smooth surfaces of labels, or why there are none.

    The surfaces of labelled cubes are smoothed, MMG makes triangles of good shape of them, and gmsh's HXT fills them.

    Args:
        labels: labels of cubes, (nx, ny, nz), 0 on all sides.
        begin: corner of the first one (m).
        spacing: of the cubes (m).

    Raises:
        SystemPartMissing: MMG is not installed.
    """
    mmgpy = package("mmgpy", MMG)
    parts, label_of = _parts(_fill_touching_edges(labels))
    lattice = lattice_of(parts, spacing, parts > 0)
    facets, pairs = interfaces(lattice.cells, lattice.labels)
    used, compact = np.unique(facets, return_inverse=True)
    facets = compact.reshape(-1, 3)
    nodes, lower, upper = two_label_nodes(facets, pairs, len(used), len(label_of))
    if len(nodes) < len(used):
        return None, "labels meet along curves or in points"
    if not _is_manifold(facets):
        return None, "parts of labels touch each other in edges of voxels"
    points = _smoothed(lattice.points[used] + begin, facets, label_of[lower], label_of[upper], memberships, spacing)
    shells, shell = unique_rows(np.column_stack([pairs, connected(facets, len(used))]))
    scale = 1 / sizes.size
    mesh = mmgpy.MmgMeshS()
    mesh.set_mesh_size(vertices=len(points), triangles=len(facets))
    mesh.set_vertices(points * scale)
    mesh.set_triangles(facets.astype(np.int32), refs=shell + 1)
    if sizes.is_graded:
        mesh.set_field("metric", _COARSE * scale * sizes.interpolate(points)[:, None])
    least = min(_FINEST, sizes.least * scale)
    try:
        with handlers_restored():  # MMG removes the handlers of SIGTERM and SIGINT
            mesh.remesh(hmax=_COARSE, hmin=least, hausd=_WITHIN, hgrad=1.5, ar=60.0, verbose=-1)
        triangles, refs = mesh.get_triangles_with_refs()[:2]
        filled = _filled(
            np.asarray(mesh.get_vertices()) / scale, np.asarray(triangles), np.asarray(refs) - 1, shells[:, :2]
        )
        return replace(filled, labels=label_of[filled.labels]), ""
    except Exception as error:  # neither MMG nor gmsh raises anything narrower
        return None, f"their smooth surfaces cannot be filled ({str(error).strip() or type(error).__name__})"


def _fill_touching_edges(labels: Ints) -> Ints:
    """The labels with cubes filled where others of one label would touch in an edge only."""
    labels = labels.copy()
    for _ in range(_ROUNDS):
        changed = False
        for first_axis, second_axis in combinations(range(3), 2):
            a, b, c, d = (labels[_shifted(first_axis, i, second_axis, j)] for i in (0, 1) for j in (0, 1))
            for first, second, third in ((a, b, c), (b, a, d)):
                fourth = d if first is a else c
                filled = (first == fourth) & (first > second) & (first != third)
                second[filled] = first[filled]
                changed |= bool(filled.any())
                filled = (first == fourth) & (first > third) & (first != second)
                third[filled] = first[filled]
                changed |= bool(filled.any())
        if not changed:
            break
    return labels


def _parts(labels: Ints) -> tuple[Ints, Ints]:
    """Numbers of connected parts of labels, and the label of each; the first part is the outside."""
    parts, label_of = np.zeros_like(labels), [0]
    for label in range(1, int(labels.max()) + 1):
        numbers, count = ndimage.label(labels == label)
        parts[numbers > 0] = numbers[numbers > 0] + len(label_of) - 1
        label_of += count * [label]
    return parts, np.array(label_of)


def _shifted(first_axis: int, i: int, second_axis: int, j: int) -> tuple[slice, ...]:
    """All but the last, or but the first, along two axes."""
    ends = {first_axis: i, second_axis: j}
    return tuple(slice(ends[k], -1 + ends[k] or None) if k in ends else slice(None) for k in range(3))


def _is_manifold(facets: Ints) -> bool:
    """Return whether each edge has two triangles."""
    _, edge = unique_rows(vertex_sets(facets, sub_entities("triangle", 1)))
    return bool((np.bincount(edge) == 2).all())


def _smoothed(
    points: Floats, facets: Ints, lower: Ints, upper: Ints, memberships: Memberships, spacing: float
) -> Floats:
    """Nodes of all facets between the means of their neighbours and the smooth boundary."""
    edges = np.concatenate([facets[:, [0, 1]], facets[:, [1, 2]], facets[:, [2, 0]]])
    edges = np.concatenate([edges, edges[:, ::-1]])
    touch = coo_array((np.ones(len(edges)), edges.T), shape=(len(points),) * 2).tocsr()
    touch.data[:] = 1.0
    share = 1 / touch.sum(axis=1)
    moved = points
    for _ in range(_ROUNDS):
        middles = 0.5 * (moved + share[:, None] * (touch @ moved))
        moved, _ = memberships.nearest(limit_steps(points, middles, spacing), lower, upper, 0.6 * spacing)
    return moved


def _filled(points: Floats, facets: Ints, shell: Ints, pairs: Ints) -> Lattice:
    """Fill surfaces with tetrahedra.

    Args:
        facets: triangles (n, 3).
        shell: row of ``pairs`` of each.
        pairs: parts on both sides of each closed shell, (m, 2), the smaller one first.
    """
    with session("surfaces") as gmsh:
        surfaces = [gmsh.model.addDiscreteEntity(2) for _ in pairs]
        tags = np.arange(1, len(points) + 1)
        gmsh.model.mesh.addNodes(2, surfaces[0], tags, points.ravel())
        for i, surface in enumerate(surfaces):
            gmsh.model.mesh.addElementsByType(surface, 2, [], (facets[shell == i] + 1).ravel())
        gmsh.model.mesh.reclassifyNodes()
        volumes = []
        for part in range(1, int(pairs.max()) + 1):
            enclosing = [surface for surface, pair in zip(surfaces, pairs, strict=True) if part in pair]
            volumes.append(gmsh.model.geo.addVolume([gmsh.model.geo.addSurfaceLoop(enclosing)]))
        gmsh.model.geo.synchronize()
        options: dict[str, Any] = {
            "Mesh.Algorithm3D": _HXT,
            "Mesh.MeshSizeExtendFromBoundary": 1,
            "Mesh.Optimize": 1,
        }
        for name, value in options.items():
            gmsh.option.setNumber(name, value)
        with muted_output():  # HXT prints where surfaces cross
            gmsh.model.mesh.generate(3)
        numbers, coordinates, _ = gmsh.model.mesh.getNodes()
        place = np.zeros(int(numbers.max()) + 1, dtype=np.int64)
        place[numbers.astype(np.int64)] = np.arange(len(numbers))
        cells, labels = list[Ints](), list[Ints]()
        for part, volume in enumerate(volumes, start=1):
            _, corners = gmsh.model.mesh.getElementsByType(4, volume)
            cells.append(place[corners.astype(np.int64)].reshape(-1, 4))
            labels.append(np.full(len(cells[-1]), part))
        if not all(map(len, cells)):
            raise ValueError("no cells")
    used, compact = np.unique(np.concatenate(cells), return_inverse=True)
    filled = Lattice(np.asarray(coordinates).reshape(-1, 3)[used], compact.reshape(-1, 4), np.concatenate(labels))
    if filled.volumes().min() <= 0:
        raise ValueError("inverted cells")
    return filled
