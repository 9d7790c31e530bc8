"""Files of surfaces and of clouds of points (STL, PLY, OBJ, VTP, VTK), read by VTK in this process."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pyvista
import vtk

from hpcinv.errors import MeshError
from hpcinv.parallel.available_memory import available
from hpcinv.parallel.runtime import MPI

_FORMATS = "Formats are STL, PLY, OBJ, VTP and VTK."
_MEMORY = 8  # bytes of memory for each byte of a binary file


def read_dataset(path: Path) -> pyvista.DataSet:
    """Read a file with points.

    Raises:
        MeshError: it cannot be read, or has no points with finite coordinates.
    """
    if path.is_file() and (needed := _MEMORY * path.stat().st_size) > (free := available(MPI.COMM_SELF)):
        raise MeshError(
            f"{path}: reading it takes about {needed / 1e9:.1f} GB of memory, but {free / 1e9:.1f} GB are available",
            "Coarsen the surface: triangles below an eighth of the cells' size are not seen.",
        )
    with without_messages_of_vtk():
        try:
            found = pyvista.read(path)
        except Exception as error:  # readers of VTK raise various errors
            raise MeshError(f"{path}: cannot be read as a surface: {error}", _FORMATS) from error
    if not isinstance(found, pyvista.DataSet) or not found.n_points:
        raise MeshError(f"{path}: has no points", _FORMATS)
    if not np.isfinite(found.points).all():
        raise MeshError(f"{path}: has coordinates that are not finite numbers")
    return found


def read_triangles(path: Path) -> pyvista.PolyData:
    """Read a surface as triangles, with coinciding nodes as one.

    Raises:
        MeshError: it cannot be read, or is no surface.
    """
    surface = read_dataset(path)
    if isinstance(surface, pyvista.UnstructuredGrid) and {c.dimension for c in surface.distinct_cell_types} == {2}:
        surface = surface.extract_surface(algorithm=None)
    if not isinstance(surface, pyvista.PolyData) or not surface.n_cells:
        raise MeshError(f"{path}: has no triangles", _FORMATS)
    if not surface.is_all_triangles:
        surface = surface.triangulate()
    surface = surface.clean(tolerance=1e-9)
    if not surface.is_all_triangles:  # triangles without an area have become lines and points
        surface = pyvista.PolyData(surface.points, faces=surface.faces)
    return surface


@contextmanager
def without_messages_of_vtk() -> Iterator[None]:
    """Context in which VTK prints nothing; faults of a file are exceptions."""
    before = vtk.vtkObject.GetGlobalWarningDisplay()
    vtk.vtkObject.GlobalWarningDisplayOff()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        vtk.vtkObject.SetGlobalWarningDisplay(before)
