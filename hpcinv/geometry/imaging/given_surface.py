"""A given surface of triangles as the boundary on which nodes lie."""

from dataclasses import dataclass

import numpy as np
import pyvista

from hpcinv.geometry.imaging.label_boundary import Memberships, limit_steps
from hpcinv.mesh.source import Floats, Ints


@dataclass(frozen=True)
class GivenSurface:
    """The triangles from which a body was filled with voxels.

    Attributes:
        surface: all triangles, in m from the first voxel's middle.
        memberships: of the voxels, which determine on which side a label is.
    """

    surface: pyvista.PolyData
    memberships: Memberships

    def nearest(self, points: Floats, lower: Ints, upper: Ints, reach: float) -> tuple[Floats, Floats]:
        """Points (n, 3) of the surface nearest to the given ones, at most ``reach`` (m) away, and normals (n, 3) from
        label ``upper`` into ``lower``."""
        _, normals = self.memberships.nearest(points, lower, upper, reach)
        _, closest = self.surface.find_closest_cell(points, return_closest_point=True)
        return limit_steps(points, np.reshape(closest, (-1, 3)), reach), normals
