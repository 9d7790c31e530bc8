"""One VTU file from all ranks, with shared nodes: array after array through rank 0, which never holds a whole field."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO
from xml.sax.saxutils import quoteattr

import numpy as np
import numpy.typing as npt

from hpcinv.parallel.runtime import MPI

_TYPES = {"float64": "Float64", "float32": "Float32", "int64": "Int64", "int32": "Int32", "uint8": "UInt8"}
_TAG = 71


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
        points: of its nodes, (n, 3) m, which are numbered consecutively in the order of the ranks.
        cells: numbers of the nodes of its cells in the order of VTK, (c, k).
        cell_type: number of the kind of cell in VTK.
    """

    points: npt.NDArray[np.float64]
    cells: npt.NDArray[np.int64]
    cell_type: int


def write_vtu(
    path: Path, comm: MPI.Intracomm, grid: Grid, at_nodes: Sequence[Array], in_cells: Sequence[Array]
) -> OSError | None:
    """Write a file; collective.

    Returns:
        The error that stopped it, on all ranks, or ``None``.
    """
    first = comm.exscan(len(grid.cells)) or 0
    width = grid.cells.shape[1]
    structure = [
        Array("connectivity", grid.cells.astype(np.int64).reshape(-1)),
        Array("offsets", (first + np.arange(1, len(grid.cells) + 1, dtype=np.int64)) * width),
        Array("types", np.full(len(grid.cells), grid.cell_type, dtype=np.uint8)),
    ]
    places = {
        "PointData": at_nodes,
        "CellData": in_cells,
        "Points": [Array("points", grid.points.astype(np.float64))],
        "Cells": structure,
    }
    every = [array for arrays in places.values() for array in arrays]
    sizes = [comm.allreduce(array.values.nbytes) for array in every]
    counts = comm.allreduce(len(grid.points)), comm.allreduce(len(grid.cells))
    stream = _Stream(path, comm)
    stream.write_text(_head(places, sizes, counts))
    for array, size in zip(every, sizes, strict=True):
        stream.write_array(array.values, size)
    stream.write_text("\n</AppendedData>\n</VTKFile>\n")
    failed: OSError | None = comm.bcast(stream.close())
    return failed


def _head(places: dict[str, Sequence[Array]], sizes: Sequence[int], counts: tuple[int, int]) -> str:
    lines = [
        '<?xml version="1.0"?>',
        '<VTKFile type="UnstructuredGrid" version="2.2" byte_order="LittleEndian" header_type="UInt64">',
        f'<UnstructuredGrid><Piece NumberOfPoints="{counts[0]}" NumberOfCells="{counts[1]}">',
    ]
    offset, left = 0, iter(sizes)
    for place, arrays in places.items():
        lines.append(f"<{place}>")
        for array in arrays:
            components = 1 if array.values.ndim == 1 else array.values.shape[1]
            lines.append(
                f'<DataArray type="{_TYPES[array.values.dtype.name]}" Name={quoteattr(array.name)}'
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
