"""Closed surfaces of triangles as fine voxels, from which they are meshed as images are.

A surface that is filled with voxels needs no repair where triangles are long, small or cut each other a little, as in
surfaces of scans; cells cannot be worse for it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyvista

from hpcinv.errors import MeshError
from hpcinv.mesh.imaging.label_image import LabelImage
from hpcinv.quantity.units import readable

BODY = "body"
"""name of the region inside a surface"""
_VOXELS = 8  # along the size of a cell
_MARGIN = 3  # voxels around the body, which is not cut by the border of an image
_MOST = 200e6  # bytes, one for each voxel
_SAME = 0.01  # relative difference of the volumes of triangles and voxels from which on the surface cuts itself


def fill(path: Path, size: float, unit: float) -> tuple[LabelImage, float]:
    """Fill the closed surface in a file (STL, PLY, OBJ, VTP) with voxels; return them and its volume (m³).

    Args:
        size: of the cells (m).
        unit: length unit (m) of the file.

    Raises:
        MeshError: it cannot be read, is open, or cuts itself.
    """
    surface = read_closed(path)
    volume = abs(_signed_volume(surface)) * unit**3
    extent = np.array(surface.bounds_size) * unit
    if not volume > 0 or not np.isfinite(volume):
        raise MeshError(f"{path}: encloses no volume", "Is it the surface of a body?")
    voxel = size / _VOXELS
    counts = np.ceil(extent / voxel).astype(int) + 2 * _MARGIN
    if np.prod(counts, dtype=float) > _MOST:
        raise MeshError(
            f"{path}: the body of {' x '.join(readable(float(length), 'm') for length in extent)} is too large for"
            f" cells of {readable(size, 'm')}",
            "Make mesh.size larger. Is mesh.unit right?",
        )
    grid = pyvista.ImageData(
        dimensions=counts,
        spacing=[voxel / unit] * 3,
        origin=np.array(surface.bounds[::2]) - (_MARGIN - 0.5) * voxel / unit,
    )
    inside = np.asarray(surface.voxelize_binary_mask(reference_volume=grid)["mask"])
    voxels = (inside > 0).astype(np.int64).reshape(counts, order="F")
    if abs(voxels.sum() * voxel**3 / volume - 1) > _SAME + 2 * voxel * surface.area * unit**2 / volume * 0.05:
        raise MeshError(
            f"{path}: the triangles enclose {readable(volume, 'm^3')}, but the points inside are"
            f" {readable(float(voxels.sum()) * voxel**3, 'm^3')}: the surface cuts itself, or the body is thin for"
            " these cells",
            "Repair the surface (Blender, MeshLab), or make mesh.size smaller.",
        )
    origin = np.array(grid.origin) * unit
    return LabelImage(path, (BODY,), voxels, np.full(3, voxel), origin, np.eye(3)), volume


def read_closed(path: Path) -> pyvista.PolyData:
    """Read a surface of triangles, whose coinciding nodes are one, and check that it is closed."""
    try:
        surface = pyvista.read(path)
    except Exception as error:  # readers of VTK raise various errors
        raise MeshError(
            f"{path}: cannot be read as a surface: {error}", "Formats are STL, PLY, OBJ and VTP."
        ) from error
    if not isinstance(surface, pyvista.PolyData) or not surface.n_cells:
        raise MeshError(f"{path}: has no triangles", "Formats are STL, PLY, OBJ and VTP.")
    surface = surface.triangulate().clean(tolerance=1e-9)
    if not np.isfinite(surface.points).all():
        raise MeshError(f"{path}: has coordinates that are not finite numbers")
    facets = surface.regular_faces
    edges = np.sort(np.concatenate([facets[:, [0, 1]], facets[:, [1, 2]], facets[:, [2, 0]]]), axis=1)
    _, shared = np.unique(edges, axis=0, return_counts=True)
    if (count := int(np.count_nonzero(shared == 1))) or not len(facets):
        raise MeshError(f"{path}: the surface is open: {count} edges have one triangle", "Close its holes.")
    return surface.compute_normals(
        cell_normals=True, point_normals=False, consistent_normals=True, auto_orient_normals=True, split_vertices=False
    )


def _signed_volume(surface: pyvista.PolyData) -> float:
    a, b, c = (np.asarray(surface.points, dtype=np.float64)[surface.regular_faces[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)
