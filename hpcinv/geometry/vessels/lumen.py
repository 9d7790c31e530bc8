"""Surface of the lumen of a vessel from a segmented image, from a surface, or from centrelines with radii."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyvista
from scipy import ndimage

from hpcinv.base.quantity.arrays import Booleans
from hpcinv.base.reading.suffix import suffix_of
from hpcinv.errors import MeshError
from hpcinv.geometry.imaging.closed_surface import read_closed, signed_volume
from hpcinv.geometry.imaging.image_surface import surface_around
from hpcinv.geometry.imaging.label_image import read_labels
from hpcinv.geometry.vessels.centrelines import read_centrelines, surface_of_tubes
from hpcinv.geometry.vessels.flat_ends import open_edges, rims_of, without_caps
from hpcinv.job.mesh_section import CENTRELINE, MeshSpec
from hpcinv.mesh.io.surface_files import read_triangles
from hpcinv.mesh.source import Floats

_BEYOND = 5  # voxels by which a lumen goes on behind its flat ends; fewer round the edges of ends
_INSIDE = 2  # voxels between the sections that are compared
_LIKE = 0.8  # least area of the last section of a flat end, relative to the one before; round ends have 0.3
_PASS_BAND = 0.1  # of the smoothing of voxels; lower values smooth more
_SWEEPS = 20


@dataclass(frozen=True)
class Lumen:
    """Surface (m) of a lumen with normals out of it, and the planes by which it is cut.

    Attributes:
        cuts: points of planes, and unit normals out of the vessel.
        frame: of the positions, for reports.
    """

    surface: pyvista.PolyData
    cuts: tuple[tuple[Floats, Floats], ...] = ()
    frame: str = ""


def read_lumen(path: Path, spec: MeshSpec) -> Lumen:
    """Read the surface of a lumen on this process, open at the ends that are flat already.

    Raises:
        MeshError: it cannot be read, or is not a surface with an inside.
        SystemPartMissing: the packages for images are not installed.
    """
    assert spec.size is not None
    if spec.is_image:
        return _lumen_of_image(path, spec)
    if suffix_of(path) == CENTRELINE:
        branches = read_centrelines(path, spec.metres)
        surface, cuts = surface_of_tubes(path, branches, spec.size)
        return Lumen(surface, cuts)
    surface = read_triangles(path)
    if len(open_edges(surface.regular_faces.astype(np.int64))):
        return Lumen(_turned_outwards(surface.scale(spec.metres), path))
    return Lumen(without_caps(read_closed(path).scale(spec.metres)))


def _turned_outwards(surface: pyvista.PolyData, path: Path) -> pyvista.PolyData:
    """Return an open surface with consistent normals that point out of its inside."""
    surface = surface.compute_normals(
        cell_normals=True, point_normals=False, consistent_normals=True, split_vertices=False
    )
    points, triangles = np.asarray(surface.points, dtype=np.float64), surface.regular_faces.astype(np.int64)
    edges = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]))
    if np.unique(edges, axis=0, return_counts=True)[1].max() > 2:
        raise MeshError(f"{path}: the surface has edges of three triangles", "Repair it (Blender, MeshLab).")
    surface = pyvista.PolyData.from_regular_faces(points, triangles)
    rims = rims_of(surface, path)
    closed = triangles
    open_pairs = open_edges(triangles)
    for rim in rims:  # a fan around its middle
        pairs = open_pairs[np.isin(open_pairs[:, 0], rim.nodes)]
        closed = np.concatenate([closed, np.column_stack([pairs, np.full(len(pairs), len(points))])])
        points = np.concatenate([points, rim.middle[None]])
    hull = pyvista.PolyData.from_regular_faces(points, closed).compute_normals(
        cell_normals=True, point_normals=False, consistent_normals=True, split_vertices=False
    )
    volume = signed_volume(hull)
    first = set(triangles[0].tolist())
    (place,) = [i for i, cell in enumerate(hull.regular_faces) if set(cell.tolist()) == first][:1]
    a, b, _ = triangles[0].tolist()
    cell = hull.regular_faces[place].tolist()
    same = cell[(cell.index(a) + 1) % 3] == b
    if (volume > 0) != same:
        triangles = triangles[:, ::-1]
    return pyvista.PolyData.from_regular_faces(np.asarray(surface.points), triangles)


def _lumen_of_image(path: Path, spec: MeshSpec) -> Lumen:
    image = read_labels(path, spec.labels, spec.metres, spec.orientation)
    places = np.argwhere(image.voxels)
    low, high = places.min(axis=0), places.max(axis=0) + 1
    margin = _BEYOND + 4
    mask = np.pad(image.voxels[tuple(map(slice, low, high))] > 0, margin)
    parts, count = ndimage.label(mask)
    if count > 1:
        mask = parts == np.bincount(parts[mask]).argmax()
    longer, cuts = _continued(mask)
    surface = surface_around(path, longer).smooth_taubin(n_iter=_SWEEPS, pass_band=_PASS_BAND)
    triangles = surface.regular_faces
    if np.linalg.det(image.axes) < 0:  # mirrored
        triangles = triangles[:, ::-1]

    def position(points: Floats) -> Floats:
        return image.positions((np.asarray(points, dtype=np.float64) + low - margin) * image.spacing)

    planes = tuple((position(point[None])[0], image.axes @ normal) for point, normal in cuts)
    return Lumen(pyvista.PolyData.from_regular_faces(position(surface.points), triangles), planes, image.frame)


def _continued(mask: Booleans) -> tuple[Booleans, list[tuple[Floats, Floats]]]:
    """Return voxels that go on behind the flat ends of others, and the planes (in voxels) of these ends.

    An end is flat where a whole section ends at once, which is about as large as the section two voxels before.
    """
    longer, planes = mask.copy(), list[tuple[Floats, Floats]]()
    for axis in range(3):
        for step in (1, -1):
            slices = np.moveaxis(mask, axis, 0)[::step]
            extended = np.moveaxis(longer, axis, 0)[::step]
            for k in range(_INSIDE, len(slices) - _BEYOND - 1):
                last = slices[k] & ~slices[k + 1]
                if not last.any():
                    continue
                patches, count = ndimage.label(last)
                before, _ = ndimage.label(slices[k - _INSIDE])
                here, _ = ndimage.label(slices[k])
                for number in range(1, count + 1):
                    patch = patches == number
                    section = here == here[patch][0]
                    whole = before == np.bincount(before[patch], minlength=1).argmax()
                    area = np.count_nonzero(patch)
                    if not before[patch].any() or area < _LIKE * np.count_nonzero(whole):
                        continue
                    if area < _LIKE * np.count_nonzero(section) or area < 4:
                        continue
                    extended[k + 1 : k + 1 + _BEYOND] |= section
                    middle = np.insert(np.argwhere(section).mean(axis=0), axis, 0.0)
                    middle[axis] = k + 0.5 if step > 0 else mask.shape[axis] - 1 - k - 0.5
                    normal = np.zeros(3)
                    normal[axis] = step
                    planes.append((middle, normal))
    return longer, planes
