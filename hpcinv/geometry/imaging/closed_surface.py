"""Closed surfaces of triangles as fine voxels, which are meshed as images are.

A surface that is filled with voxels needs no repair where triangles are long, small or cut each other a little, as in
surfaces of scans; cells cannot be worse for it.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import pyvista
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from hpcinv.base.quantity.arrays import Booleans
from hpcinv.base.quantity.units import readable
from hpcinv.errors import MeshError
from hpcinv.geometry.imaging.label_image import LabelImage
from hpcinv.geometry.imaging.specks import check_extent
from hpcinv.mesh.io.surface_files import read_triangles
from hpcinv.mesh.source import Floats, Ints
from hpcinv.mesh.topology import unique_rows

_VOXELS = 8  # along the size of a cell
_MARGIN = 3  # voxels around the body, which is not cut by the border of an image
_MOST = 200e6  # bytes, one for each voxel
_SAME = 0.01  # relative difference of the volumes of triangles and voxels from which on the surface cuts itself
_MOST_PARTS = 1000


def fill(
    parts: Mapping[str, Sequence[Path]], size: float, unit: float
) -> tuple[LabelImage, list[float], pyvista.PolyData]:
    """Fill closed surfaces in files with voxels; return them, the volumes (m³) of the regions, and all triangles (m).

    A region is what an odd number of its surfaces encloses. Where regions overlap, one must lie in the other, from
    which it is cut out.

    Args:
        parts: files of the surfaces of each region.
        size: of the cells (m).
        unit: length unit (m) of the files.

    Raises:
        MeshError: one cannot be read, is open, or cuts itself or another.
    """
    surfaces = [_together(paths) for paths in parts.values()]
    first = next(iter(parts.values()))[0]
    bounds = np.array([surface.bounds for surface in surfaces])
    low, high = bounds[:, ::2].min(axis=0), bounds[:, 1::2].max(axis=0)
    extent = (high - low) * unit
    voxel = size / _VOXELS
    counts = np.ceil(extent / voxel).astype(int) + 2 * _MARGIN
    check_extent(first, extent, size, fits=np.prod(counts, dtype=float) <= _MOST)
    # Walls have four voxels at least, if there is room for them: twice the volume by the area is their thickness.
    thickness = min(2 * abs(signed_volume(surface)) / max(surface.area, 1e-300) for surface in surfaces) * unit
    affordable = float(np.prod(extent + 2 * _MARGIN * voxel) / _MOST) ** (1 / 3)
    voxel = min(voxel, max(0.25 * thickness, affordable))
    counts = np.ceil(extent / voxel).astype(int) + 2 * _MARGIN
    grid = pyvista.ImageData(dimensions=counts, spacing=[voxel / unit] * 3, origin=low - (_MARGIN - 0.5) * voxel / unit)
    masks = [_voxels(paths[0], surface, grid, unit) for paths, surface in zip(parts.values(), surfaces, strict=True)]
    order = sorted(range(len(masks)), key=lambda i: -int(masks[i].sum()))
    _check_nested([list(parts)[i] for i in order], [masks[i] for i in order], first)
    voxels = np.zeros(counts, dtype=np.int16)
    for i in order:  # the smaller one is cut out of the larger one
        voxels[masks[i]] = i + 1
    volumes = []
    for i, (mask, surface) in enumerate(zip(masks, surfaces, strict=True), start=1):
        kept = np.count_nonzero(voxels == i) / np.count_nonzero(mask)
        volumes.append(float(signed_volume(surface) * unit**3 * kept))
    origin = np.array(grid.origin) * unit
    triangles = surfaces[0] if len(surfaces) == 1 else pyvista.merge(surfaces, merge_points=False)
    return LabelImage(first, tuple(parts), voxels, np.full(3, voxel), origin, np.eye(3)), volumes, triangles.scale(unit)


def _voxels(path: Path, surface: pyvista.PolyData, grid: pyvista.ImageData, unit: float) -> Booleans:
    """Return which voxels are inside of a surface; ``MeshError`` if their volume is not the triangles'."""
    voxel = float(grid.spacing[0])
    volume = signed_volume(surface)
    if not volume > 0 or not np.isfinite(volume):
        raise MeshError(f"{path}: encloses no volume", "Is it the surface of a body?")
    mask = np.asarray(surface.voxelize_binary_mask(reference_volume=grid)["mask"])
    voxel_volume = np.count_nonzero(mask) * voxel**3
    if abs(voxel_volume / volume - 1) > _SAME + 2 * voxel * surface.area / volume * 0.05:
        raise MeshError(
            f"{path}: the triangles enclose {readable(volume * unit**3, 'm^3')}, but points inside fill"
            f" {readable(voxel_volume * unit**3, 'm^3')}",
            "Mend the surface where it cuts itself (Blender, MeshLab), or make mesh.size smaller.",
        )
    return (mask > 0).reshape(grid.dimensions, order="F")


def _check_nested(names: Sequence[str], masks: Sequence[Booleans], path: Path) -> None:
    """Check two regions, the larger one first: the smaller is in the other or apart from it."""
    for i, mask in enumerate(masks):
        for j in range(i + 1, len(masks)):
            both, whole = np.count_nonzero(mask & masks[j]), np.count_nonzero(masks[j])
            if _SAME * whole < both < (1 - _SAME) * whole:
                raise MeshError(
                    f"{path}: the surfaces of '{names[i]}' and '{names[j]}' cut each other: {both / whole:.0%} of"
                    f" '{names[j]}' is in '{names[i]}'",
                    "One must lie inside the other, or outside.",
                )


def read_closed(path: Path) -> pyvista.PolyData:
    """Read a surface of triangles, check that it is closed, and turn its normals out of the body.

    Coinciding nodes become one, triangles that occur twice are kept once, and double walls, as where two bodies touch,
    are removed. The body is between a shell and those in it.

    Raises:
        MeshError: it cannot be read, is open, or has too many shells.
    """
    surface = read_triangles(path)
    count, place = 0, np.zeros(3)
    for facets in _distinct_facets(surface.regular_faces.astype(np.int64)):
        edges, shared = _edges(facets)
        odd = np.flatnonzero(shared % 2)
        if len(facets) and not len(odd):
            break
        if len(odd) > count:
            row, corner = divmod(int(edges[shared[: odd[0]].sum()]), 3)
            count, place = len(odd), surface.points[facets[row, [corner, (corner + 1) % 3]]].mean(axis=0)
    else:
        coordinates = ", ".join(f"{x:.6g}" for x in place)
        raise MeshError(
            f"{path}: the surface is open: {count} edges have an odd number of triangles, first at ({coordinates})",
            "Close its holes (Blender, MeshLab).",
        )
    pairs = edges[np.repeat(shared == 2, shared)].reshape(-1, 2) // 3  # triangles that share a manifold edge
    graph = coo_array((np.ones(len(pairs), dtype=np.int8), pairs.T), shape=(len(facets),) * 2)
    count, shell = connected_components(graph, directed=False)
    if count > _MOST_PARTS:
        raise MeshError(f"{path}: has {count:,} separate shells", "Is it the surface of a body?")
    return _turned(np.asarray(surface.points, dtype=np.float64), facets, shell, pairs, count)


def _together(paths: Sequence[Path]) -> pyvista.PolyData:
    """The surfaces in some files as one; the body is between a shell and the surfaces in it."""
    surfaces = [read_closed(path) for path in paths]
    if len(surfaces) == 1:
        return surfaces[0]
    begins = np.cumsum([0, *(surface.n_points for surface in surfaces)])
    facets = np.concatenate([s.regular_faces + b for s, b in zip(surfaces, begins[:-1], strict=True)]).astype(np.int64)
    shell = np.repeat(np.arange(len(surfaces)), [s.n_cells for s in surfaces])
    points = np.concatenate([np.asarray(s.points) for s in surfaces])
    return _nested(points, facets, shell, len(surfaces))


def signed_volume(surface: pyvista.PolyData) -> float:
    """Volume in a closed surface of triangles, negative with normals inwards."""
    return float(_moments(np.asarray(surface.points, dtype=np.float64), surface.regular_faces).sum())


def _moments(points: Floats, facets: Ints) -> Floats:
    """Volumes between triangles and the middle of the points, where differences of large coordinates are exact."""
    a, b, c = (points[facets[:, i]] - points.mean(axis=0) for i in range(3))
    return np.asarray(np.einsum("ij,ij->i", a, np.cross(b, c)) / 6)


def _distinct_facets(facets: Ints) -> Iterator[Ints]:
    """Triangles with those that occur twice kept once, and without them: then they were walls between two bodies."""
    distinct, place = unique_rows(np.sort(facets, axis=1))
    yield facets if len(distinct) == len(facets) else facets[np.sort(np.unique(place, return_index=True)[1])]
    if len(distinct) < len(facets):
        yield facets[np.bincount(place)[place] == 1]


def _edges(facets: Ints) -> tuple[Ints, Ints]:
    """Places in ``facets.ravel()`` where edges begin, sorted by edges, and the number of each edge."""
    tail, head = facets.ravel(), np.roll(facets, -1, axis=1).ravel()
    key = np.minimum(tail, head) * (int(facets.max(initial=0)) + 1) + np.maximum(tail, head)
    order = np.argsort(key, kind="stable")
    key = key[order]
    starts = np.flatnonzero(np.concatenate([[True], key[1:] != key[:-1]])) if len(key) else np.zeros(0, dtype=np.int64)
    return order, np.diff(np.append(starts, len(key)))


def _turned(points: Floats, facets: Ints, shell: Ints, pairs: Ints, count: int) -> pyvista.PolyData:
    """The surface with normals out of the body."""
    if len(pairs) and not _agree(facets, pairs):
        surface = pyvista.PolyData.from_regular_faces(points, facets)
        surface.cell_data["row"] = np.arange(len(facets))
        surface = surface.compute_normals(
            cell_normals=True, point_normals=False, consistent_normals=True, split_vertices=False
        )
        shell, facets = shell[surface.cell_data["row"]], surface.regular_faces.astype(np.int64)
    return _nested(points, facets, shell, count)


def _agree(facets: Ints, pairs: Ints) -> bool:
    """Return whether neighbours pass their common edge in opposite directions."""
    first, second = facets[pairs[:, 0]], facets[pairs[:, 1]]
    same = np.zeros(len(pairs), dtype=bool)
    for i in range(3):
        for j in range(3):
            same |= (first[:, i] == second[:, j]) & (first[:, (i + 1) % 3] == second[:, (j + 1) % 3])
    return not same.any()


def _nested(points: Floats, facets: Ints, shell: Ints, count: int) -> pyvista.PolyData:
    """Shells of consistent triangles, turned so that normals point out of the body between a shell and those in it."""
    volumes = np.bincount(shell, weights=_moments(points, facets), minlength=count)
    depth = np.zeros(count, dtype=np.int64)
    if count > 1:
        first = np.unique(shell, return_index=True)[1]
        inner = points[facets[first, 0]]
        low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
        for corner in range(3):
            np.minimum.at(low, shell, points[facets[:, corner]])
            np.maximum.at(high, shell, points[facets[:, corner]])
        for outer in range(count):
            may = ((low > low[outer]) & (high < high[outer])).all(axis=1)
            if may.any():
                hull = pyvista.PolyData.from_regular_faces(points, facets[shell == outer]).clean()
                enclosed = pyvista.PolyData(inner[may]).select_interior_points(hull)
                depth[np.flatnonzero(may)] += np.asarray(enclosed["selected_points"], dtype=np.int64)
    turn = ((volumes < 0) ^ (depth % 2 == 1))[shell]
    facets = np.where(turn[:, None], facets[:, ::-1], facets)
    return pyvista.PolyData.from_regular_faces(points, facets)
