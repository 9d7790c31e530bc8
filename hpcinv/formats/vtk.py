"""VTK's legacy files of unstructured grids: cell arrays ``region:NAME`` are regions, as in VTU files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from hpcinv.base.reading.mesh_format import Later, MeshFormat

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from hpcinv.mesh.source import Floats, MeshSource
else:
    np = Later("numpy")


class Vtk(MeshFormat):
    suffix = ".vtk"
    action = "vtk"
    reader = "hpcinv.formats.vtk:read_vtk"
    saver = "hpcinv.formats.vtk:save_vtk"


def read_vtk(path: Path) -> MeshSource:
    """Read an unstructured grid, as text or binary, as `hpcinv.mesh.io.vtu.read_vtu` does.

    Raises:
        MeshError: the file cannot be read, or is not a mesh.
    """
    from hpcinv.mesh.io.vtu import read_grid

    return read_grid(path, "vtk")


def save_vtk(path: Path, source: MeshSource, points: Floats) -> None:
    """Write topology, tags, groups and data of ``source`` at ``points`` (n, 3) in ``source.unit``, binary.

    Raises:
        OSError: it cannot be written.
    """
    from hpcinv.formats.readers.elements import check_numbers
    from hpcinv.mesh.io.vtu import content_of

    check_numbers(source)
    cells, node_arrays, cell_arrays, fields = content_of(source)
    count = sum(len(nodes) for nodes, _ in cells)
    size = sum(nodes.size + len(nodes) for nodes, _ in cells)
    with path.open("wb") as file:
        file.write(b"# vtk DataFile Version 3.0\nWritten by hpcinv\nBINARY\nDATASET UNSTRUCTURED_GRID\n")
        _write_fields(file, {name: np.array([value]) for name, value in fields.items()})
        _write(file, f"POINTS {len(points)} double", points)
        rows = [np.column_stack([np.full(len(nodes), nodes.shape[1]), nodes]).ravel() for nodes, _ in cells]
        _write(file, f"CELLS {count} {size}", np.concatenate(rows).astype(np.int32))
        types = np.concatenate([np.full(len(nodes), kind, dtype=np.int32) for nodes, kind in cells])
        _write(file, f"CELL_TYPES {count}", types)
        for head, arrays in ((f"POINT_DATA {len(points)}", node_arrays), (f"CELL_DATA {count}", cell_arrays)):
            file.write(f"{head}\n".encode())
            _write_fields(file, arrays)


def _write_fields(file: IO[bytes], arrays: Mapping[str, npt.NDArray[Any]]) -> None:
    file.write(f"FIELD FieldData {len(arrays)}\n".encode())
    for name, values in arrays.items():
        rows = values.reshape(len(values), -1)
        is_real = rows.dtype.kind == "f"
        kind = "double" if is_real else "int"
        _write(
            file,
            f"{_encoded(name)} {rows.shape[1]} {len(rows)} {kind}",
            rows.astype(np.float64 if is_real else np.int32),
        )


def _write(file: IO[bytes], head: str, values: npt.NDArray[Any]) -> None:
    file.write(f"{head}\n".encode())
    file.write(values.astype(values.dtype.newbyteorder(">")).tobytes())
    file.write(b"\n")


def _encoded(name: str) -> str:
    """Return a name as VTK encodes it, without blanks."""
    special = b" %\"'\t"
    return "".join(chr(c) if 32 < c < 127 and c not in special else f"%{c:02X}" for c in name.encode())
