"""One VTU file from all ranks, with shared nodes: array after array through rank 0, which never holds a whole field."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from types import MappingProxyType
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from hpcinv.base.parallel.runtime import MPI

_TYPES = {"float64": "Float64", "float32": "Float32", "int64": "Int64", "int32": "Int32", "uint8": "UInt8"}
_TAG = 71
_LAGRANGE = range(68, 75)
"""VTK's numbers of cells of any degree"""
_WHITE = str.maketrans({"\n": "&#10;", "\r": "&#13;", "\t": "&#9;"})


def attribute(text: str) -> str:
    """Return a text as the value of an attribute in XML, in quotes."""
    return f'"{escape(text).translate(_WHITE)}"'  # xml.sax.saxutils has this, but imports HTTP


@dataclass(frozen=True)
class Array:
    """Values at the nodes or in the cells that this rank owns, (n,) or (n, components), with their unit."""

    name: str
    values: npt.NDArray[Any]
    unit: str = ""


@dataclass(frozen=True)
class Grid:
    """The part of a grid that this rank owns.

    Attributes:
        points: of its nodes, (n, 3), which are numbered consecutively in the order of the ranks.
        cells: numbers of the nodes of its cells in the order of VTK, (c, k), for each kind of cell with VTK's number
            of that kind.
    """

    points: npt.NDArray[np.float64]
    cells: Sequence[tuple[npt.NDArray[np.int64], int]]


def write_vtu(
    path: Path,
    comm: MPI.Intracomm,
    grid: Grid,
    node_arrays: Sequence[Array],
    cell_arrays: Sequence[Array],
    numbers: Mapping[str, float] = MappingProxyType({}),
) -> OSError | None:
    """Write a file; collective.

    Args:
        cell_arrays: in the order of the kinds of cells.
        numbers: of the whole grid, by name.

    Returns:
        The error that stopped it, on all ranks, or ``None``.
    """
    connectivity = np.concatenate([nodes.astype(np.int64).ravel() for nodes, _ in grid.cells])
    widths = np.concatenate([np.full(len(nodes), nodes.shape[1], dtype=np.int64) for nodes, _ in grid.cells])
    structure = [
        Array("connectivity", connectivity),
        Array("offsets", (comm.exscan(len(connectivity)) or 0) + np.cumsum(widths)),
        Array("types", np.concatenate([np.full(len(nodes), kind, dtype=np.uint8) for nodes, kind in grid.cells])),
    ]
    places = {
        "PointData": node_arrays,
        "CellData": cell_arrays,
        "Points": [Array("points", grid.points.astype(np.float64))],
        "Cells": structure,
    }
    every = [array for arrays in places.values() for array in arrays]
    sizes = [comm.allreduce(array.values.nbytes) for array in every]
    counts = comm.allreduce(len(grid.points)), comm.allreduce(len(widths))
    stream = _Stream(path, comm)
    # meshio refuses versions above 1.0. Lagrange cells need 2.2: VTK numbers their nodes by it.
    version = "2.2" if any(kind in _LAGRANGE for _, kind in grid.cells) else "1.0"
    stream.write_text(_head(version, places, sizes, counts, numbers))
    for array, size in zip(every, sizes, strict=True):
        stream.write_array(array.values, size)
    stream.write_text("\n</AppendedData>\n</VTKFile>\n")
    failed: OSError | None = comm.bcast(stream.close())
    return failed


def _head(
    version: str,
    places: dict[str, Sequence[Array]],
    sizes: Sequence[int],
    counts: tuple[int, int],
    numbers: Mapping[str, float],
) -> str:
    lines = [
        '<?xml version="1.0"?>',
        f'<VTKFile type="UnstructuredGrid" version="{version}" byte_order="LittleEndian" header_type="UInt64">',
        "<UnstructuredGrid><FieldData>",
    ]
    lines += [
        f'<DataArray type="Float64" Name={attribute(name)} NumberOfTuples="1" format="ascii">{value!r}</DataArray>'
        for name, value in numbers.items()
    ]
    lines.append(f'</FieldData><Piece NumberOfPoints="{counts[0]}" NumberOfCells="{counts[1]}">')
    offset, left = 0, iter(sizes)
    for place, arrays in places.items():
        lines.append(f"<{place}>")
        for array in arrays:
            components = 1 if array.values.ndim == 1 else array.values.shape[1]
            lines.append(
                f'<DataArray type="{_TYPES[array.values.dtype.name]}" Name={attribute(array.name)}'
                f' NumberOfComponents="{components}" format="appended" offset="{offset}">'
            )
            if array.unit:
                lines.append(
                    f'<InformationKey name="UNITS_LABEL" location="vtkDataArray">{array.unit}</InformationKey>'
                )
            lines.append("</DataArray>")
            offset += 8 + next(left)
        lines.append(f"</{place}>")
    lines.append('</Piece></UnstructuredGrid>\n<AppendedData encoding="raw">\n_')
    return "\n".join(lines)


class _Stream:
    """A file that rank 0 writes; after an error nothing more is written, and all ranks go on."""

    def __init__(self, path: Path, comm: MPI.Intracomm) -> None:
        self._comm = comm
        self._error: OSError | None = None
        self._file: BinaryIO | None = None
        if comm.rank == 0:
            try:
                self._file = path.open("wb")
            except OSError as error:
                self._error = error

    def write_text(self, text: str) -> None:
        if self._comm.rank == 0:
            self._write(text.encode())

    def write_array(self, values: npt.NDArray[Any], size: int) -> None:
        """Write the parts of all ranks after their size in bytes."""
        mine = np.ascontiguousarray(values)
        if self._comm.rank != 0:
            self._comm.send(mine, dest=0, tag=_TAG)
            return
        self._write(np.uint64(size).tobytes())
        for rank in range(self._comm.size):
            part = mine if rank == 0 else self._comm.recv(source=rank, tag=_TAG)
            self._write(part.tobytes())

    def close(self) -> OSError | None:
        if self._file is not None:
            try:
                self._file.close()
            except OSError as error:
                self._error = self._error or error
        return self._error

    def _write(self, content: bytes) -> None:
        if self._file is None or self._error is not None:
            return
        try:
            self._file.write(content)
        except OSError as error:
            self._error = error
