"""Files of VTK's XML formats: unstructured grids (VTU) and images (VTI)."""

import contextlib
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from hpcinv.base.reading.door import admitted
from hpcinv.base.reading.fault import Fault
from hpcinv.base.reading.voxels import VoxelGrid
from hpcinv.base.reading.vtk_headers import elements_of, parse

MOST_COMPRESSED = 1100  # largest ratio of compression; zlib reaches 1032
_SIZES = ("NumberOfPoints", "NumberOfCells", "NumberOfComponents", "NumberOfTuples")
_SIZES_OF_SURFACES = ("NumberOfVerts", "NumberOfLines", "NumberOfStrips", "NumberOfPolys")
_FORMATS = "Save it again by the program that made it."


def read_vtu(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the names of the types of cells, and the arrays of an unstructured grid."""
    from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridReader

    if fault := fault_of_header(path):
        raise Fault(f"VTK cannot read it: {fault}", "Is it a complete .vtu file?")
    reader = vtkXMLUnstructuredGridReader()
    reader.SetFileName(str(admitted(path)))
    reader.Update()
    return _content(reader.GetOutput())


def read_vtk(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the same of a file in VTK's legacy format, as text or binary."""
    from vtkmodules.vtkIOLegacy import vtkUnstructuredGridReader

    with admitted(path).open("rb") as file:
        head = file.read(4096)
    if not head.startswith(b"# vtk DataFile"):
        raise Fault("is not a legacy file of VTK", "Its first line is '# vtk DataFile Version'.")
    if (match := re.search(rb"^DATASET\s+(\w+)", head, re.M | re.I)) and match[1].upper() != b"UNSTRUCTURED_GRID":
        raise Fault(f"is {match[1].decode('ascii', 'replace')}, not UNSTRUCTURED_GRID", "Save the cells of the body.")
    reader = vtkUnstructuredGridReader()
    reader.SetFileName(str(admitted(path)))
    for kind in ("Scalars", "Vectors", "Tensors", "Fields"):
        getattr(reader, f"ReadAll{kind}On")()
    reader.Update()
    head_of_grid, arrays = _content(reader.GetOutput())
    offsets, connectivity = (arrays.get(name, np.zeros(0)) for name in ("offsets", "connectivity"))
    if len(offsets) and (len(connectivity) != offsets[-1] or (np.diff(offsets) < 1).any()):
        raise Fault("its cells do not have the nodes that their sizes say", "Is the file complete?")
    return head_of_grid, arrays


def _content(grid: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    from vtkmodules.util import numpy_support

    vtk_to_numpy: Any = numpy_support.vtk_to_numpy
    arrays: dict[str, Any] = {}
    names: dict[int, str] = {}
    if grid is not None and grid.GetNumberOfCells() and grid.GetCells() is not None:
        cells = grid.GetCells()
        arrays["points"] = vtk_to_numpy(grid.GetPoints().GetData())
        arrays["types"] = vtk_to_numpy(grid.GetCellTypes())
        arrays["offsets"] = vtk_to_numpy(cells.GetOffsetsArray())
        arrays["connectivity"] = vtk_to_numpy(cells.GetConnectivityArray())
        arrays |= dict(_data_of(grid.GetPointData(), "nodes"))
        arrays |= dict(_data_of(grid.GetCellData(), "cells"))
        arrays |= dict(_data_of(grid.GetFieldData(), "field"))
        names = {number: _name_of(number) for number in np.unique(arrays["types"]).tolist()}
    return {"names": names}, arrays


def read_vti(path: Path) -> VoxelGrid:
    """Read VTK image data: labels of its points or of its cells, which are voxels then; their frame is taken as LPS."""
    from vtkmodules.util import numpy_support
    from vtkmodules.vtkIOXML import vtkXMLImageDataReader

    vtk_to_numpy: Any = numpy_support.vtk_to_numpy
    _check_image_header(path)
    reader = vtkXMLImageDataReader()
    reader.SetFileName(str(admitted(path)))
    reader.Update()
    image = reader.GetOutput()
    array, owner = _array_of_labels(image)
    if (count := array.GetNumberOfComponents()) > 1:
        raise Fault(f"has {count} numbers in each voxel", "Give a segmentation, with one number in each voxel.")
    values = np.asarray(vtk_to_numpy(array))
    spacing, extent = np.array(image.GetSpacing()), np.array(image.GetExtent())
    matrix = image.GetDirectionMatrix()
    axes = np.array([[matrix.GetElement(i, j) for j in range(3)] for i in range(3)])
    is_of_cells = owner is image.GetCellData() or len(values) == image.GetNumberOfCells()
    shape = np.array(image.GetDimensions()) - is_of_cells
    if len(values) != np.prod(shape, dtype=object):
        raise Fault(f"has {len(values):,} numbers for {' x '.join(map(str, shape))} voxels", "Is the file complete?")
    first = extent[::2] + 0.5 * is_of_cells
    origin = np.array(image.GetOrigin()) + axes @ (first * spacing)
    return VoxelGrid(values.reshape(shape, order="F"), spacing, origin, axes)


def _array_of_labels(image: Any) -> tuple[Any, Any]:
    """Return the only array of an image, or the active one, and the data of points or cells that has it."""
    arrays = [
        (array, owner)
        for owner in (image.GetCellData(), image.GetPointData())
        for i in range(owner.GetNumberOfArrays())
        if (array := owner.GetArray(i)) is not None and array.GetNumberOfTuples()
    ]
    if not arrays:
        raise Fault("has no voxels with numbers", _FORMATS)
    chosen = arrays if len(arrays) == 1 else [entry for entry in arrays if entry[1].GetScalars() is entry[0]]
    if len(chosen) != 1:
        names = ", ".join(repr(array.GetName() or "") for array, _ in arrays)
        raise Fault(f"has several arrays: {names}", "Write it with the one of the labels only.")
    return chosen[0]


def _check_image_header(path: Path) -> None:
    """Check the grid of an image: its size, and that its pieces fill it. VTK leaves memory unset where they do not."""
    if fault := fault_of_header(path):
        raise Fault(f"cannot be read as an image: {fault}", _FORMATS)
    whole, pieces = list[list[int]](), list[list[int]]()
    for tag, attributes in elements_of(path):
        if tag == "Piece":
            pieces.append(_extent(attributes.get("Extent", "")))
        elif tag == "ImageData":
            whole.append(_extent(attributes.get("WholeExtent", "")))
            _check_axes(attributes)
    if len(whole) != 1 or not pieces:
        raise Fault("cannot be read as an image: is it VTK image data?", _FORMATS)
    # VTK takes memory for the whole grid before it reads: of each voxel there is a byte at least.
    if (voxels := _cells(whole[0], 1)) > path.stat().st_size * MOST_COMPRESSED:
        raise Fault(f"its header says {voxels:,} points in a file of {path.stat().st_size:,} bytes", _FORMATS)
    is_whole = pieces == whole if len(pieces) == 1 else sum(_cells(piece, 0) for piece in pieces) == _cells(whole[0], 0)
    if not is_whole:
        raise Fault("its pieces do not fill the grid that its header says: voxels are missing", "Is the file complete?")


def _extent(text: str) -> list[int]:
    """Return the first and last point along each axis."""
    extent = [int(word) for word in text.split()] if re.fullmatch(r"\s*(-?\d{1,9}\s+){5}-?\d{1,9}\s*", text) else []
    if not extent or any(high < low for low, high in zip(extent[::2], extent[1::2], strict=True)):
        raise Fault(f"its header says the extent '{text[:60]}'", _FORMATS)
    return extent


def _check_axes(attributes: dict[str, str]) -> None:
    if "Spacing" not in attributes:
        raise Fault("its header does not say 'Spacing'", _FORMATS)
    for key, count in (("Spacing", 3), ("Origin", 3), ("Direction", 9)):
        if key in attributes and not _are_numbers(attributes[key], count):
            raise Fault(f"'{key}' in its header is '{attributes[key][:60]}', not {count} numbers", _FORMATS)


def _are_numbers(text: str, count: int) -> bool:
    try:
        return len([float(word) for word in text.split()]) == count
    except ValueError:
        return False


def _cells(extent: list[int], more: int) -> int:
    """Number of cells (``more``: 0) or points (1) in an extent."""
    x, y, z = (high - low + more for low, high in zip(extent[::2], extent[1::2], strict=True))
    return x * y * z


def fault_of_header(path: Path) -> str | None:
    """Impossible size of an array, or more numbers in text than it has, if there are such.

    VTK allocates memory for arrays before it reads data, and passes over numbers that are too many: one of them in the
    middle gives all points after it the coordinates of others.
    """
    size = path.stat().st_size
    most = size  # each value takes at least one byte
    for tag, attributes in elements_of(path):
        if tag == "VTKFile" and "compressor" in attributes:
            most = size * MOST_COMPRESSED
        for name in (*_SIZES, *_SIZES_OF_SURFACES):
            text = attributes.get(name, "0").strip()
            if not text.isdecimal() or int(text[:20]) > most:
                return f"{name} is {text[:40]} in a file of {size} bytes"
    numbers = _NumbersInText()
    parse(path, numbers.begins, numbers.text.append, numbers.ends)
    return numbers.fault


class _NumbersInText:
    """Counts the numbers of arrays in text, and compares them with the sizes that their piece says."""

    def __init__(self) -> None:
        self.fault: str | None = None
        self.text = list[str]()
        self._piece = dict[str, int]()
        self._section = ""
        self._array: dict[str, str] = {}
        self._lengths = dict[str, int]()  # of the section, by name
        self._last = 0.0  # number of its offsets

    def begins(self, tag: str, attributes: dict[str, str]) -> None:
        if tag == "Piece":
            self._piece = {name: int(attributes.get(name, "0")) for name in (*_SIZES, *_SIZES_OF_SURFACES)}
            self._piece["cells"] = self._piece["NumberOfCells"] + sum(self._piece[name] for name in _SIZES_OF_SURFACES)
            extent = attributes.get("Extent", "").split()
            if len(extent) == 6 and all(re.fullmatch(r"-?\d{1,9}", word) for word in extent):
                numbers = [int(word) for word in extent]
                self._piece["NumberOfPoints"], self._piece["cells"] = _cells(numbers, 1), _cells(numbers, 0)
        elif tag == "DataArray":
            self._array = attributes
        else:
            self._section, self._lengths, self._last = tag, {}, 0.0
        self.text.clear()

    def ends(self, tag: str) -> None:
        if tag == "DataArray" and self._array.get("format") == "ascii" and self._array.get("type") != "String":
            self._count(self._array, "".join(self.text))
        if tag == self._section and self._lengths.get("connectivity", 0) > self._last > 0:
            self._complain("connectivity", self._lengths["connectivity"], int(self._last))
        self.text.clear()

    def _count(self, attributes: dict[str, str], text: str) -> None:
        name, words = attributes.get("Name", ""), np.frombuffer(text.encode(), dtype=np.uint8) > ord(" ")
        count = int(np.count_nonzero(words[1:] & ~words[:-1]) + words[:1].sum())
        components = int(attributes.get("NumberOfComponents", "1"))
        self._lengths[name] = count
        if self._section in ("Points", "PointData"):
            expected = self._piece.get("NumberOfPoints", 0) * (3 if self._section == "Points" else components)
        elif self._section == "CellData":
            expected = self._piece.get("cells", 0) * components
        elif name in ("offsets", "types"):
            section_count = self._piece.get(f"NumberOf{self._section}", 0)
            expected = self._piece["NumberOfCells"] if self._section == "Cells" else section_count
            if name == "offsets" and count:
                with contextlib.suppress(ValueError):  # VTK reports it
                    self._last = float(text.split()[-1])
        else:
            return
        if count > expected:
            self._complain(name, count, expected)

    def _complain(self, name: str, count: int, expected: int) -> None:
        self.fault = self.fault or f"'{name}' has {count:,} numbers, but the file says {expected:,}"


def _data_of(attributes: Any, place: str) -> Iterator[tuple[str, Any]]:
    """Numeric arrays of the nodes, cells or fields, with their names."""
    from vtkmodules.util import numpy_support

    vtk_to_numpy: Any = numpy_support.vtk_to_numpy
    for i in range(attributes.GetNumberOfArrays()):
        array = attributes.GetArray(i)  # None for text
        if array is not None:
            yield f"{place}:{attributes.GetArrayName(i) or ''}", vtk_to_numpy(array)


def _name_of(number: int) -> str:
    """Name of a type of cells in VTK."""
    from vtkmodules import vtkCommonDataModel

    name = str(vtkCommonDataModel.vtkCellTypes.GetClassNameFromTypeId(number))
    return name.removeprefix("vtk") if name != "UnknownClass" else f"of the type {number}"
