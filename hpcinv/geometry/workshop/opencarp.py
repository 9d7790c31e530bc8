"""The cells of a shape as a mesh of openCARP: points (``.pts``), elements (``.elem``) and fibres (``.lon``).

Each file begins with a number: of points in µm, of elements, of directions in each element. An element is ``Tt``, its
nodes from 0, and the number of its region. Source: openCARP user manual, "Meshes" (opencarp.org/documentation).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hpcinv.base.files.atomic import write_output
from hpcinv.base.files.names import check_directory_of
from hpcinv.errors import OutputError
from hpcinv.mesh.cells import vertex_count
from hpcinv.mesh.source import DataArray, Floats, Ints, MeshSource

_MICROMETRES = 1e6
_UNIT_LENGTH = 1e-3
"""Deviation of the lengths of an array from 1 up to which it is a direction; raised, displacements may be taken."""
_MOST = 2  # directions of an element: fibre and sheet
_FIBRE = ("fib", "f0")  # parts of the name of the first direction, if the order of the file does not decide


@dataclass(frozen=True)
class Written:
    """What the files hold.

    Attributes:
        volume: of the straight tetrahedra, m³.
        regions: names by their number in ``.elem``; 0 is outside of them.
        directions: names of the arrays in ``.lon``; empty if it has the x axis, since there is none.
    """

    cells: int
    volume: float
    regions: dict[int, str]
    directions: tuple[str, ...]


def write_opencarp(path: Path, source: MeshSource, cells: Ints | None, scale: float) -> Written:
    """Write ``NAME.pts``, ``NAME.elem`` and ``NAME.lon``; curved cells become straight.

    Args:
        source: shape in m.
        cells: rows of the cells to write, ``None`` for all.
        scale: factor of all lengths about the origin.

    Raises:
        OutputError: the cells are hexahedra, or a file cannot be written.
    """
    if source.kind != "tetrahedron":
        raise OutputError(
            f"{path}: meshes of openCARP are written of tetrahedra, and these cells are hexahedra",
            "Mesh the body by tetrahedra, or export .vtu and convert it by meshtool.",
        )
    check_directory_of(path)
    rows = np.arange(len(source.cells)) if cells is None else np.sort(cells)
    corners = source.cells[rows][:, : vertex_count(source.kind)]
    used, numbers = np.unique(corners, return_inverse=True)
    numbers = numbers.reshape(corners.shape)
    points = source.points[used] * scale
    volumes = _volumes(points[numbers])
    numbers[volumes < 0] = numbers[volumes < 0][:, [0, 2, 1, 3]]
    labels = source.labels(3)[rows] + 1
    arrays = directions_of(source)[:_MOST]
    axes = np.hstack([_in_cells(source, array)[rows] for array in arrays] or [np.tile([1.0, 0.0, 0.0], (len(rows), 1))])
    elements = (f"Tt {' '.join(map(str, row))}" for row in np.column_stack([numbers, labels]).tolist())
    _write(path.with_suffix(".lon"), str(max(len(arrays), 1)), _numbers(axes))
    _write(path.with_suffix(".elem"), str(len(rows)), elements)
    _write(path, str(len(points)), _numbers(points * _MICROMETRES))
    regions = {int(label): source.groups[label - 1].name for label in np.unique(labels) if label}
    return Written(len(rows), float(np.abs(volumes).sum()), regions, tuple(array.name for array in arrays))


def directions_of(source: MeshSource) -> list[DataArray]:
    """Return the arrays of unit vectors of a shape, fibres first."""
    found = [
        array
        for array in source.data.values()
        if array.values.shape[1:] == (3,) and np.allclose(np.linalg.norm(array.values, axis=1), 1.0, atol=_UNIT_LENGTH)
    ]
    return sorted(found, key=lambda array: not any(part in array.name.lower() for part in _FIBRE))


def _in_cells(source: MeshSource, array: DataArray) -> Floats:
    """Return the directions (m, 3) in all cells: of nodes the mean of the vertices, whose signs may differ."""
    if array.place == "cells":
        return array.values
    of_vertices = array.values[source.cells[:, : vertex_count(source.kind)]]
    signs = np.where(np.einsum("mvi,mi->mv", of_vertices, of_vertices[:, 0]) < 0, -1.0, 1.0)
    mean = np.einsum("mvi,mv->mi", of_vertices, signs)
    return np.asarray(mean / np.linalg.norm(mean, axis=1, keepdims=True))


def _volumes(corners: Floats) -> Floats:
    a, b, c = (corners[:, i] - corners[:, 0] for i in (1, 2, 3))
    return np.asarray(np.einsum("mi,mi->m", np.cross(a, b), c) / 6)


def _numbers(rows: Floats) -> Iterator[str]:
    return (" ".join(map(repr, row)) for row in rows.tolist())


def _write(path: Path, head: str, lines: Iterator[str]) -> None:
    write_output(path, "\n".join([head, *lines, ""]).encode(), "Is the directory writable, and space left?")
