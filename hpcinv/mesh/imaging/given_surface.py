"""A given surface of triangles as the boundary on which nodes lie."""

import numpy as np
import pyvista
import vtk

from hpcinv.mesh.imaging.boundary import Memberships, within
from hpcinv.mesh.source import Floats, Ints


class GivenSurface:
    """The triangles from which a body was filled with voxels.

    Args:
        surface: all triangles, in m from the first voxel's middle.
        memberships: of the voxels, which determine on which side a label is.
    """

    def __init__(self, surface: pyvista.PolyData, memberships: Memberships) -> None:
        self._memberships = memberships
        self._locator = vtk.vtkStaticCellLocator()
        self._locator.SetDataSet(surface)
        self._locator.BuildLocator()

    def nearest(self, points: Floats, one: Ints, other: Ints, reach: float) -> tuple[Floats, Floats]:
        """Points (n, 3) of the surface nearest to the given ones, at most ``reach`` (m) away, and normals (n, 3) from
        label ``other`` into ``one``."""
        _, normals = self._memberships.nearest(points, one, other, reach)
        found, cell, part, square = np.empty_like(points), vtk.reference(0), vtk.reference(0), vtk.reference(0.0)
        closest = [0.0, 0.0, 0.0]
        for i, point in enumerate(points.tolist()):
            self._locator.FindClosestPoint(point, closest, cell, part, square)
            found[i] = closest
        return within(points, found, reach), normals
