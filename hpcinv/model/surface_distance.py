"""Signed distance from a triangulated surface."""

from pathlib import Path

import numpy as np

from hpcinv.base.parallel.runtime import MPI, on_root
from hpcinv.errors import MeshError
from hpcinv.mesh.source import Floats, Ints

_SMOOTH = 30.0  # degrees between triangles, below which their normals are averaged
_FLAT = 1e-6
"""Thickness by the largest extent up to which a surface is flat, as files round. If it is raised, thin closed surfaces
are taken for sheets, and points may pass through them."""
_ROUNDING = 1e-9
"""Height of a triangle by its longest side below which it has no normal. If it is raised, slivers are left out."""


class SurfaceDistance:
    """A triangulated surface that is read on rank 0; collective.

    Args:
        unit: SI value of the length unit of the file.
        flip: whether the normals of the file are reversed.

    Raises:
        MeshError: on all ranks, if the file cannot be read, or has no triangle with an area.
    """

    def __init__(self, path: Path, unit: float, flip: bool, comm: MPI.Intracomm) -> None:
        import pyvista

        def read_on_root() -> tuple[Floats, Ints]:
            from hpcinv.mesh.io.surface_files import read_triangles  # loads VTK

            polygons = read_triangles(path)
            return with_area(path, np.asarray(polygons.points, dtype=np.float64), np.asarray(polygons.regular_faces))

        points, triangles = on_root(comm, read_on_root)
        surface = pyvista.PolyData.from_regular_faces(points * unit, triangles[:, ::-1] if flip else triangles)
        self._surface = surface.compute_normals(
            feature_angle=_SMOOTH,
            split_vertices=True,
            consistent_normals=False,
            auto_orient_normals=False,
            cell_normals=False,
        )
        self._triangles = np.asarray(self._surface.regular_faces)
        self._normals = np.asarray(self._surface.point_data["Normals"], dtype=np.float64)

    @property
    def bounds(self) -> tuple[Floats, Floats]:
        """Least and largest coordinates, (3,) each in m."""
        points = np.asarray(self._surface.points, dtype=np.float64)
        return points.min(axis=0), points.max(axis=0)

    @property
    def half_thickness(self) -> float | None:
        """Half of the least extent along an axis or a principal axis (m), ``None`` of a flat surface."""
        points = np.asarray(self._surface.points, dtype=np.float64)
        arms = points - points.mean(axis=0)
        axes = np.vstack([np.eye(3), np.linalg.eigh(arms.T @ arms)[1].T])
        extents = np.ptp(arms @ axes.T, axis=0)
        return None if extents.min() <= _FLAT * extents.max() else float(extents.min()) / 2

    def __call__(self, points: Floats) -> tuple[Floats, Floats]:
        """Return signed distances (n,) m and normals (n, 3) of the surface at the nearest points; not collective."""
        import pyvista

        if not len(points):
            return np.zeros(0), np.zeros((0, 3))
        cells, nearest = self._surface.find_closest_cell(points, return_closest_point=True)
        corners = self._surface.points[self._triangles[cells]].astype(np.float64)
        normals = np.einsum(
            "nv,nvi->ni", barycentric(corners, np.asarray(nearest)), self._normals[self._triangles[cells]]
        )
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        signed = pyvista.PolyData(points).compute_implicit_distance(self._surface)["implicit_distance"]
        return np.asarray(signed, dtype=np.float64), normals


def with_area(path: Path, points: Floats, triangles: Ints) -> tuple[Floats, Ints]:
    """Return points (n, 3) and those triangles (m, 3) that have an area, and so a normal.

    Raises:
        MeshError: no triangle has an area.
    """
    a, b, c = (points[triangles[:, i]] for i in range(3))
    longest = np.max([np.linalg.norm(side, axis=1) for side in (b - a, c - b, a - c)], axis=0)
    heights = np.linalg.norm(np.cross(b - a, c - a), axis=1) / np.where(longest > 0, longest, 1.0)
    kept = triangles[heights > _ROUNDING * longest]
    if not len(kept):
        raise MeshError(f"{path}: its triangles have no area", "Name a file whose triangles are a surface.")
    return points, kept


def barycentric(corners: Floats, points: Floats) -> Floats:
    """Return barycentric coordinates (n, 3) of points in their triangles (n, 3, 3)."""
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    c = points - corners[:, 0]
    aa, ab, bb, ca, cb = (np.einsum("ni,ni->n", x, y) for x, y in ((a, a), (a, b), (b, b), (c, a), (c, b)))
    size = aa * bb - ab**2
    size = np.where(size > 0, size, 1.0)
    v, w = (bb * ca - ab * cb) / size, (aa * cb - ab * ca) / size
    coordinates: Floats = np.clip(np.stack([1 - v - w, v, w], axis=1), 0.0, 1.0)
    return coordinates
