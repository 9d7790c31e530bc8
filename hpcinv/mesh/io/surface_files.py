"""Files of surfaces and of clouds of points (STL, PLY, OBJ, VTP, VTK), read by VTK in a process of its own."""

from pathlib import Path

import numpy as np
import pyvista

from hpcinv.errors import MeshError
from hpcinv.mesh.io.isolated import Arrays, read_isolated
from hpcinv.mesh.source import Floats

_FORMATS = "Formats are STL, PLY, OBJ, VTP and VTK."


def read_points(path: Path) -> Floats:
    """Read the distinct points (n, 3) of a surface or of a cloud of points.

    Raises:
        MeshError: it cannot be read, or has no points with finite coordinates.
    """
    return np.unique(np.asarray(_read(path)["points"], dtype=np.float64), axis=0)


def read_triangles(path: Path) -> pyvista.PolyData:
    """Read a surface as triangles, with coinciding nodes as one.

    Raises:
        MeshError: it cannot be read, or is not a surface.
    """
    arrays = _read(path)
    if not len(arrays.get("triangles", ())):
        raise MeshError(f"{path}: has no triangles", _FORMATS)
    surface = pyvista.PolyData.from_regular_faces(arrays["points"], arrays["triangles"]).clean(tolerance=1e-9)
    if not surface.is_all_triangles:  # triangles without an area have become lines and points
        surface = pyvista.PolyData(surface.points, faces=surface.faces)
    return surface


def _read(path: Path) -> Arrays:
    return read_isolated("surface", path, "cannot be read as a surface", _FORMATS)[1]
