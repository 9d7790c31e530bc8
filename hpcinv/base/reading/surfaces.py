"""Surfaces and clouds of points (STL, PLY, OBJ, VTP, VTK): points and triangles."""

import importlib
from pathlib import Path
from typing import Any

import numpy as np

from hpcinv.base.reading.door import admitted
from hpcinv.base.reading.fault import Fault
from hpcinv.base.reading.suffix import suffix_of
from hpcinv.base.reading.surface_structure import check_structure
from hpcinv.base.reading.vtk_files import fault_of_header

_FORMATS = "Formats are STL, PLY, OBJ, VTP and VTK."
_MEMORY = 8  # bytes of memory for each byte of a binary file; surfaces that would fit are refused if raised
_FARTHEST = 1e60  # coordinate; products of three larger ones overflow


def read_surface(path: Path, memory: float) -> dict[str, Any]:
    """Return ``points`` (n, 3) and, if there are polygons, ``triangles`` (m, 3).

    Args:
        memory: bytes that are available.
    """
    if (needed := _MEMORY * path.stat().st_size) > memory:
        raise Fault(
            f"reading it takes about {needed / 1e9:.1f} GB of memory, but {memory / 1e9:.1f} GB are available",
            "Coarsen the surface: triangles below an eighth of the cells' size are not seen.",
        )
    expected = check_structure(path)
    data = _read(path)
    arrays = {"points": _checked_points(data)}
    _check_cells(data, len(arrays["points"]))
    if expected is not None and data.GetNumberOfPolys() != expected:
        raise Fault(f"has {expected:,} polygons, but {data.GetNumberOfPolys():,} can be read", _FORMATS)
    if data.IsA("vtkUnstructuredGrid") and _is_flat(data):
        from vtkmodules.vtkFiltersGeometry import vtkGeometryFilter

        data = _filtered(vtkGeometryFilter(), data)
        arrays["points"] = _points(data)
    if data.IsA("vtkPolyData") and data.GetNumberOfPolys() + data.GetNumberOfStrips():
        arrays["triangles"] = _triangles(data)
    return arrays


def _checked_points(data: Any) -> Any:
    """Return the points of what VTK read (n, 3); ``Fault`` if there are none, or coordinates are not usable."""
    if data is None or not data.IsA("vtkDataSet") or not data.GetNumberOfPoints():
        raise Fault("has no points", _FORMATS)
    points = _points(data)
    if not np.isfinite(points).all():
        raise Fault("has coordinates that are not finite numbers")
    if abs(points).max() > _FARTHEST:
        raise Fault(f"has coordinates beyond {_FARTHEST:g}")
    return points


def _read(path: Path) -> Any:
    """What VTK reads."""
    if suffix_of(path) == ".vtp" and (fault := fault_of_header(path)):
        raise Fault(f"cannot be read as a surface: {fault}", _FORMATS)
    readers = {
        ".stl": "vtkIOGeometry.vtkSTLReader",
        ".obj": "vtkIOGeometry.vtkOBJReader",
        ".ply": "vtkIOPLY.vtkPLYReader",
        ".vtp": "vtkIOXML.vtkXMLPolyDataReader",
        ".vtk": "vtkIOLegacy.vtkDataSetReader",
    }
    if suffix_of(path) not in readers:
        raise Fault("cannot be read as a surface", _FORMATS)
    module, _, name = readers[suffix_of(path)].partition(".")  # each one takes a tenth of a second to load
    reader: Any = getattr(importlib.import_module(f"vtkmodules.{module}"), name)()
    reader.SetFileName(str(admitted(path)))
    reader.Update()
    return reader.GetOutput()


def _points(data: Any) -> Any:
    from vtkmodules.util import numpy_support

    vtk_to_numpy: Any = numpy_support.vtk_to_numpy
    if data.IsA("vtkPointSet"):
        return vtk_to_numpy(data.GetPoints().GetData())
    return np.array([data.GetPoint(i) for i in range(data.GetNumberOfPoints())])


def _check_cells(data: Any, count: int) -> None:
    """Check that cells have points that exist: filters of VTK crash on others."""
    for cells in _cell_arrays(data):
        offsets, nodes = _arrays(cells)
        is_right = len(offsets) and offsets[0] == 0 and offsets[-1] == len(nodes) and (np.diff(offsets) >= 0).all()
        if not is_right or (len(nodes) and not 0 <= nodes.min() <= nodes.max() < count):
            raise Fault(f"has polygons of points that do not exist; it has {count:,} points", "Is the file complete?")


def _cell_arrays(data: Any) -> list[Any]:
    if data.IsA("vtkPolyData"):
        every = [data.GetVerts(), data.GetLines(), data.GetPolys(), data.GetStrips()]
    else:
        every = [data.GetCells()] if data.IsA("vtkUnstructuredGrid") else []
    return [cells for cells in every if cells is not None and cells.GetNumberOfCells()]


def _arrays(cells: Any) -> tuple[Any, Any]:
    from vtkmodules.util import numpy_support

    vtk_to_numpy: Any = numpy_support.vtk_to_numpy
    offsets, nodes = vtk_to_numpy(cells.GetOffsetsArray()), vtk_to_numpy(cells.GetConnectivityArray())
    return np.asarray(offsets, dtype=np.int64), np.asarray(nodes, dtype=np.int64)


def _is_flat(data: Any) -> bool:
    """Whether all cells are two-dimensional."""
    return {data.GetCell(i).GetCellDimension() for i in range(data.GetNumberOfCells())} == {2}


def _triangles(data: Any) -> Any:
    """The polygons as triangles."""
    offsets, nodes = _arrays(data.GetPolys()) if data.GetNumberOfPolys() else (np.zeros(1), np.zeros(0))
    if data.GetNumberOfStrips() or not (np.diff(offsets) == 3).all():
        from vtkmodules.vtkFiltersCore import vtkTriangleFilter

        divide = vtkTriangleFilter()
        divide.PassVertsOff()
        divide.PassLinesOff()
        data = _filtered(divide, data)
        _, nodes = _arrays(data.GetPolys()) if data.GetNumberOfPolys() else (offsets, np.zeros(0))
    return nodes.reshape(-1, 3)


def _filtered(step: Any, data: Any) -> Any:
    step.SetInputData(data)
    step.Update()
    return step.GetOutput()
