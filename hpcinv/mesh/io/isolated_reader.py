"""Program that reads one mesh file with a library that crashes, or prints messages, if the file is damaged.

``python isolated_reader.py vtu PATH`` writes the arrays of a VTU file to standard output: a line of JSON with the
names, types and shapes of arrays, then their bytes in this order. ``python isolated_reader.py msh PATH`` lets gmsh read
a file and writes nothing. It imports nothing from the package, whose mesh modules load MPI, and VTK, whose import takes
as long as gmsh's, for VTU files only.
"""

import contextlib
import json
import resource
import sys
from pathlib import Path
from typing import Any
from xml.parsers import expat

import numpy as np

MOST_COMPRESSED = 1100  # largest ratio of compression; that of zlib is 1032


def read_msh(path: str) -> None:
    """Read the file with gmsh, and all data that the package asks for; errors are reported where it is read again."""
    import gmsh

    limit_memory()
    gmsh.initialize(argv=[], readConfigFiles=False, run=False, interruptible=False)
    with contextlib.suppress(Exception):  # gmsh raises nothing narrower
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("General.NumThreads", 1)
        gmsh.model.add("rehearsal")
        gmsh.merge(path)
        if gmsh.model.getNumberOfPartitions():
            gmsh.model.mesh.unpartition()
        gmsh.model.mesh.getNodes()
        for dim, tag in gmsh.model.getEntities():
            gmsh.model.mesh.getElements(dim, tag)
        for dim, tag in gmsh.model.getPhysicalGroups():
            gmsh.model.getEntitiesForPhysicalGroup(dim, tag)
        for view in gmsh.view.getTags():
            last = int(gmsh.view.option.getNumber(view, "NbTimeStep")) - 1
            gmsh.view.getHomogeneousModelData(view, last)
    gmsh.finalize()


def read_vtu(path: str) -> None:
    """Write the arrays of the file to standard output, with names of the types of cells in it."""
    from vtkmodules.util import numpy_support
    from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridReader

    vtk_to_numpy: Any = numpy_support.vtk_to_numpy
    if fault := fault_of_header(Path(path)):
        sys.exit(f"ERR| {fault}")
    limit_memory()
    reader = vtkXMLUnstructuredGridReader()
    reader.SetFileName(path)
    reader.Update()
    grid = reader.GetOutput()
    arrays: dict[str, np.ndarray] = {}
    names: dict[int, str] = {}
    if grid is not None and grid.GetNumberOfCells() and grid.GetCells() is not None:
        cells = grid.GetCells()
        arrays["points"] = vtk_to_numpy(grid.GetPoints().GetData())
        arrays["types"] = vtk_to_numpy(grid.GetCellTypes())
        arrays["offsets"] = vtk_to_numpy(cells.GetOffsetsArray())
        arrays["connectivity"] = vtk_to_numpy(cells.GetConnectivityArray())
        arrays |= dict(data_of(grid.GetPointData(), "nodes"))
        arrays |= dict(data_of(grid.GetCellData(), "cells"))
        arrays |= dict(data_of(grid.GetFieldData(), "field"))
        names = {number: name_of(number) for number in np.unique(arrays["types"]).tolist()}
    arrays = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    shapes = [(name, array.dtype.str, array.shape) for name, array in arrays.items()]
    sys.stdout.buffer.write(json.dumps({"names": names, "arrays": shapes}).encode() + b"\n")
    for array in arrays.values():
        if array.size:
            sys.stdout.buffer.write(array.data.cast("B"))


class _HeaderRead(Exception):
    pass


def fault_of_header(path: Path) -> str | None:
    """Impossible array size in the XML header, if there is one: VTK allocates memory for it before it reads data."""
    size, faults = path.stat().st_size, list[str]()
    most = [size]  # each value takes at least one byte

    def begins(tag: str, attributes: dict[str, str]) -> None:
        if tag == "VTKFile" and "compressor" in attributes:
            most[0] = size * MOST_COMPRESSED
        elif tag == "AppendedData":  # what follows may not be XML
            raise _HeaderRead
        for name in ("NumberOfPoints", "NumberOfCells", "NumberOfComponents", "NumberOfTuples"):
            text = attributes.get(name, "0").strip()
            if not text.isdecimal() or int(text[:20]) > most[0]:
                faults.append(f"{name} is {text[:40]} in a file of {size} bytes")

    parser = expat.ParserCreate()
    parser.StartElementHandler = begins
    with contextlib.suppress(_HeaderRead, expat.ExpatError), path.open("rb") as file:  # VTK reports invalid XML
        parser.ParseFile(file)
    return faults[0] if faults else None


def data_of(attributes: Any, on: str) -> Any:
    """Numeric arrays of the nodes, cells or fields, with their names."""
    from vtkmodules.util import numpy_support

    vtk_to_numpy: Any = numpy_support.vtk_to_numpy
    for i in range(attributes.GetNumberOfArrays()):
        array = attributes.GetArray(i)  # None for text
        if array is not None:
            yield f"{on}:{attributes.GetArrayName(i) or ''}", vtk_to_numpy(array)


def name_of(number: int) -> str:
    """Name of a type of cells in VTK."""
    from vtkmodules import vtkCommonDataModel

    name = str(vtkCommonDataModel.vtkCellTypes.GetClassNameFromTypeId(number))
    return name.removeprefix("vtk") if name != "UnknownClass" else f"of the type {number}"


def limit_memory() -> None:
    """Limit the memory of this process to the available memory, in case of wrong array sizes."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    free = [line.split()[1] for line in Path("/proc/meminfo").read_text().splitlines() if "MemAvailable" in line]
    taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    limit = taken + 1024 * int(free[0])
    resource.setrlimit(resource.RLIMIT_AS, (limit if hard == resource.RLIM_INFINITY else min(limit, hard), hard))


if __name__ == "__main__":
    if sys.argv[1] == "vtu":
        read_vtu(sys.argv[2])
    else:
        read_msh(sys.argv[2])
