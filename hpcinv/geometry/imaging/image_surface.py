"""Surface of labels in a segmented image, with the volume of their voxels."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyvista
from scipy import ndimage

from hpcinv.base.quantity.arrays import Booleans
from hpcinv.errors import MeshError
from hpcinv.geometry.imaging.label_image import read_labels
from hpcinv.mesh.source import Floats

_SMOOTH = 0.7  # standard deviation of the smoothing, in voxels
_MARGIN = 4  # voxels around the body, so that surfaces are closed where the image ends
_STEPS = 12  # of bisection
_RIGHT = 1e-3  # relative error of the volume


def image_surface(path: Path, labels: Sequence[int], unit: float) -> pyvista.PolyData:
    """Return the closed surface (m) of labels together, where an image ends flat.

    It is the surface where the smoothed voxels have the value at which it encloses their volume.

    Args:
        labels: numbers of the voxels; by default all but 0.
        unit: length unit (m) of spacing and origin in the file.

    Raises:
        MeshError: the image cannot be read, or lacks a label.
    """
    image = read_labels(path, {"body": labels} if labels else None, unit)
    places = np.argwhere(image.voxels)
    low, high = places.min(axis=0), places.max(axis=0) + 1
    mask = np.pad(image.voxels[tuple(map(slice, low, high))] > 0, _MARGIN)
    surface = surface_around(path, mask)
    points: Floats = (np.asarray(surface.points, dtype=np.float64) + low - _MARGIN) * image.spacing
    triangles = surface.regular_faces
    if np.linalg.det(image.axes) < 0:  # mirrored
        triangles = triangles[:, ::-1]
    return pyvista.PolyData.from_regular_faces(image.positions(points), triangles)


def surface_around(path: Path, mask: Booleans) -> pyvista.PolyData:
    """Return the surface (voxels) that encloses the volume of the voxels in a mask, whose margin is empty.

    Raises:
        MeshError: they are too few.
    """
    field = ndimage.gaussian_filter(mask.astype(np.float32), _SMOOTH)
    volume = np.count_nonzero(mask)
    least, most = 0.02, 0.98
    for _ in range(_STEPS):
        level = (least + most) / 2
        surface = _contour(field, level)
        error = abs(surface.volume) / volume - 1 if surface.n_cells else -1.0
        if abs(error) < _RIGHT:
            break
        least, most = (level, most) if error > 0 else (least, level)
    if not surface.n_cells:
        raise MeshError(f"{path}: the label is too small for a surface", "Give an image with smaller voxels.")
    return surface


def _contour(field: Floats, level: float) -> pyvista.PolyData:
    """Surface in voxels, with normals outwards."""
    grid = pyvista.ImageData(dimensions=field.shape)
    grid.point_data["inside"] = field.ravel(order="F")
    surface = grid.contour([level], scalars="inside", method="flying_edges")
    if not surface.n_cells:
        return surface
    return surface.triangulate().clean().compute_normals(auto_orient_normals=True, split_vertices=False)
