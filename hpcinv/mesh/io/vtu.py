"""VTU files: cells, facets of groups as surface cells, an integer array for each region, and data arrays."""

import json
import math
import re
import signal
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hpcinv.errors import MeshError
from hpcinv.mesh.cells import FACET_KIND, degree_of, no_cells, vtk_order
from hpcinv.mesh.io.isolated import run_isolated
from hpcinv.mesh.io.length_unit import FIELD, as_unit
from hpcinv.mesh.source import Floats, Group, Ints, MeshSource, Place, data_arrays

# Of degree 1, of degree 2, of any degree; the last two have the same node order.
VTK_TYPES = {
    "triangle": ("TRIANGLE", "QUADRATIC_TRIANGLE", "LAGRANGE_TRIANGLE"),
    "quadrilateral": ("QUAD", "BIQUADRATIC_QUAD", "LAGRANGE_QUADRILATERAL"),
    "tetrahedron": ("TETRA", "QUADRATIC_TETRA", "LAGRANGE_TETRAHEDRON"),
    "hexahedron": ("HEXAHEDRON", "TRIQUADRATIC_HEXAHEDRON", "LAGRANGE_HEXAHEDRON"),
}
REGION = "region:"  # cell arrays "region:NAME" have the tag of the region on its cells and 0 elsewhere
NODE_TAG, CELL_TAG = "node_tag", "cell_tag"
OF_VTK = "vtk"  # prefix of names reserved by VTK, such as vtkGhostType


def read_vtu(path: Path) -> MeshSource:
    """Read an unstructured grid; the cells where an array ``region:NAME`` is not 0 are a physical group.

    Other arrays are data. VTK reads the file in a separate process, which may crash on a damaged file.

    Raises:
        MeshError: the file cannot be read, or is not a mesh.
    """
    names, arrays = _read(path)
    if "types" not in arrays:
        raise MeshError(f"{path}: has no unstructured grid with cells", "Save the mesh as VTU (unstructured grid).")
    types, points = arrays["types"], np.asarray(arrays["points"], dtype=np.float64)
    kind = _solid_kind(path, sorted(names.values()))
    rows = {
        dim: np.flatnonzero(np.isin(types, [t for t, name in names.items() if name in VTK_TYPES[k]]))
        for dim, k in ((3, kind), (2, FACET_KIND[kind]))
    }
    cells = _connectivity(path, arrays, kind, rows[3])
    degree = degree_of(path, kind, cells.shape[1])
    facets = (
        _connectivity(path, arrays, FACET_KIND[kind], rows[2]) if len(rows[2]) else no_cells(FACET_KIND[kind], degree)
    )
    if degree_of(path, FACET_KIND[kind], facets.shape[1]) != degree:
        raise MeshError(f"{path}: surface cells and solid cells are of different degree", "Save both with one degree.")

    groups = []
    for name in arrays:
        if name.startswith(f"cells:{REGION}"):
            marks = _whole_numbers(path, name.removeprefix("cells:"), arrays[name], len(types))
            for dim, of in rows.items():
                values = marks[of]
                members = np.flatnonzero(values)
                if len(members):
                    short = name.removeprefix(f"cells:{REGION}")
                    groups.append(Group(short, dim, int(values[members[0]]), members))
    node_tags = _tags(path, NODE_TAG, arrays.get(f"nodes:{NODE_TAG}"), len(points))
    cell_tags = _tags(path, CELL_TAG, arrays.get(f"cells:{CELL_TAG}"), len(types))[rows[3]]
    facets, named = _named(facets, groups)
    data, unit = data_arrays(_data(arrays, rows[3])), _unit(arrays)
    return MeshSource(path, kind, degree, points, node_tags, cells, cell_tags, facets, named, data=data, unit=unit)


def _read(path: Path) -> tuple[dict[int, str], dict[str, npt.NDArray[Any]]]:
    """Names of the cell types in a file, and its arrays: ``points``, …, and data ``nodes:NAME`` or ``cells:NAME``."""
    wanted = [name for kinds in VTK_TYPES.values() for name in kinds]
    with path.open("rb"):  # raises OSError if the file cannot be opened
        done = run_isolated("vtu", path, *wanted)
    complaints = [match[1] for match in _COMPLAINT.finditer(done.stderr.decode(errors="replace"))]
    if done.returncode or complaints:
        reason = complaints[0] if complaints else f"it crashed ({_ending(done.returncode)})"
        raise MeshError(f"{path}: VTK cannot read it: {reason}", "Is it a complete .vtu file?")
    head, _, content = done.stdout.partition(b"\n")
    listed = json.loads(head)
    arrays, start = {}, 0
    for name, code, shape in listed["arrays"]:
        dtype = np.dtype(code)
        count = math.prod(shape)
        arrays[name] = np.frombuffer(content, dtype, count, start).reshape(shape)
        start += count * dtype.itemsize
    return {int(number): name for number, name in listed["names"].items()}, arrays


_COMPLAINT = re.compile(r"ERR\|\s*(?:\w+ \(0x[0-9a-f]+\): )?(.*?)\s*(?:\x1b\[0m)?$", re.MULTILINE)


def _ending(code: int) -> str:
    return signal.Signals(-code).name if code < 0 else f"exit code {code}"


def _tags(path: Path, name: str, values: npt.NDArray[Any] | None, count: int) -> Ints:
    return np.arange(1, count + 1) if values is None else _whole_numbers(path, name, values, count)


def _whole_numbers(path: Path, name: str, values: npt.NDArray[Any], count: int) -> Ints:
    if values.shape != (count,) or values.dtype.kind not in "iuf":
        raise MeshError(f"{path}: the array '{name}' is not one number for each entity", "Correct or remove it.")
    with np.errstate(invalid="ignore"):
        whole = values.astype(np.int64)
    if not (whole == values).all():
        raise MeshError(f"{path}: the array '{name}' has values that are not integers", "Correct or remove it.")
    return np.asarray(whole)


def _data(arrays: Mapping[str, npt.NDArray[Any]], solids: Ints) -> Iterator[tuple[str, Place, npt.NDArray[np.generic]]]:
    """Data arrays: those without a special meaning here or for VTK; rows of cells for the ``solids`` only."""
    for key, values in arrays.items():
        on, _, name = key.partition(":")
        if on == "nodes" and name != NODE_TAG and not name.startswith(OF_VTK):
            yield name, "nodes", values
        elif on == "cells" and name != CELL_TAG and not name.startswith((OF_VTK, REGION)):
            yield name, "cells", values[solids]


def _unit(arrays: Mapping[str, npt.NDArray[Any]]) -> float | None:
    """Length unit (m) that the file states, or ``None``."""
    stated = arrays.get(f"field:{FIELD}", np.zeros(0))
    return as_unit(float(stated[0])) if stated.shape == (1,) else None


def _solid_kind(path: Path, names: list[str]) -> str:
    """Kind of the solid cells among the VTK cell types of a file; raises ``MeshError`` if there is not exactly one."""
    solid = {k for k in FACET_KIND for n in names if n in VTK_TYPES[k]}
    flat = {n for k in FACET_KIND.values() for n in VTK_TYPES[k]} | {"VERTEX", "LINE", "QUADRATIC_EDGE", "POLY_LINE"}
    other = [n for n in names if n not in flat and not any(n in VTK_TYPES[k] for k in FACET_KIND)]
    if len(solid) == 1 and not other:
        return solid.pop()
    if not solid and not other:
        raise MeshError(
            f"{path}: no solid cells", "Save the tetrahedra or hexahedra of the body, not only its surface."
        )
    raise MeshError(
        f"{path}: cells are {' and '.join(n for n in names if n not in flat)}",
        "Use one kind of cell in a mesh: all tetrahedra (4 or 10 nodes) or all hexahedra (8 or 27 nodes).",
    )


def _connectivity(path: Path, arrays: Mapping[str, npt.NDArray[Any]], kind: str, rows: Ints) -> Ints:
    start = arrays["offsets"].astype(np.int64)
    sizes = np.unique(start[rows + 1] - start[rows])
    if len(sizes) > 1:
        raise MeshError(f"{path}: {kind}s of {' and '.join(map(str, sizes))} nodes", "Save them all with one degree.")
    size = int(sizes[0])
    nodes: Ints = arrays["connectivity"].astype(np.int64)[start[rows][:, None] + np.arange(size)]
    return nodes[:, vtk_order(kind, degree_of(path, kind, size))]


def _named(facets: Ints, groups: list[Group]) -> tuple[Ints, tuple[Group, ...]]:
    """Facets that are in a group, and the groups with indices of these."""
    named = np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *(g.members for g in groups if g.dim == 2)]))
    kept = [g if g.dim == 3 else Group(g.name, 2, g.tag, np.searchsorted(named, g.members)) for g in groups]
    return facets[named], tuple(kept)


def save_vtu(path: Path, source: MeshSource, points: Floats) -> None:
    """Write topology, tags, groups and data of ``source`` at ``points`` (n, 3) in ``source.unit``; not collective."""
    # VTK itself: pyvista takes a second to import, as long as a small job takes to solve.
    from vtkmodules import vtkCommonDataModel
    from vtkmodules.util import numpy_support
    from vtkmodules.vtkCommonCore import vtkPoints
    from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridWriter

    vtk: Any = vtkCommonDataModel
    support: Any = numpy_support  # without types

    def array(name: str, values: npt.NDArray[np.integer] | Floats) -> Any:
        converted = support.numpy_to_vtk(values, deep=True)
        converted.SetName(name)
        return converted

    kinds = (source.kind, FACET_KIND[source.kind])
    types, sizes, connectivity = [], [], []
    for kind, nodes in zip(kinds, (source.cells, source.facets), strict=True):
        connectivity.append(nodes[:, np.argsort(vtk_order(kind, source.degree))].ravel())
        sizes.append(np.full(len(nodes), nodes.shape[1]))
        name = VTK_TYPES[kind][source.degree - 1]
        types.append(np.full(len(nodes), getattr(vtk, f"VTK_{name}"), dtype=np.uint8))
    offsets = np.concatenate([[0], np.cumsum(np.concatenate(sizes))])

    cells = vtk.vtkCellArray()
    cells.SetData(
        *(
            support.numpy_to_vtkIdTypeArray(np.asarray(a, np.int64), deep=True)
            for a in (offsets, np.concatenate(connectivity))
        )
    )
    positions = vtkPoints()
    positions.SetData(support.numpy_to_vtk(points, deep=True))
    grid = vtk.vtkUnstructuredGrid()
    grid.SetPoints(positions)
    grid.SetCells(support.numpy_to_vtk(np.concatenate(types), deep=True), cells)

    for name, data in source.data.items():  # before the arrays below, which replace data arrays of the same name
        if data.on == "nodes":
            grid.GetPointData().AddArray(array(name, data.values))
        else:
            on_facets = np.full((len(source.facets), data.values.shape[1]), np.nan)
            grid.GetCellData().AddArray(array(name, np.concatenate([data.values, on_facets])))
    grid.GetPointData().AddArray(array(NODE_TAG, source.node_tags))
    beyond = source.cell_tags.max() + 1 + np.arange(len(source.facets))
    grid.GetCellData().AddArray(array(CELL_TAG, np.concatenate([source.cell_tags, beyond])))
    for name in dict.fromkeys(g.name for g in source.groups):
        marks = np.zeros(len(offsets) - 1, dtype=np.int32)
        for group in source.groups:
            if group.name == name:
                marks[group.members + (0 if group.dim == 3 else len(source.cells))] = group.tag
        grid.GetCellData().AddArray(array(REGION + name, marks))

    grid.GetFieldData().AddArray(array(FIELD, np.array([source.unit or 1.0])))

    writer = vtkXMLUnstructuredGridWriter()
    writer.SetFileName(str(path))
    writer.SetInputData(grid)
    if not writer.Write():
        raise OSError(f"VTK error {writer.GetErrorCode()}")
