"""Files of solids for printers and mills: STL, PLY and 3MF."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from hpcinv.errors import OutputError
from hpcinv.workshop.solid import Solid

UNITS_OF_3MF = {
    "um": "MicroMeter",
    "mm": "MilliMeter",
    "cm": "CentiMeter",
    "in": "Inch",
    "ft": "Foot",
    "m": "Meter",
}
"""Units of length that a 3MF file can state, with their names in lib3mf."""


def check(path: Path, unit: str) -> None:
    """Raise ``OutputError`` if a solid cannot be written to this path in this unit."""
    if path.suffix not in WRITERS:
        raise OutputError(f"{path}: the formats of solids are {', '.join(WRITERS)}")
    if path.suffix == ".3mf" and unit not in UNITS_OF_3MF:
        raise OutputError(f"{path}: 3MF knows no unit '{unit}'", f"Its units are {', '.join(UNITS_OF_3MF)}.")
    if not path.parent.is_dir():
        raise OutputError(f"{path}: cannot be written: there is no directory {path.parent}")


def write(path: Path, solid: Solid, unit: str) -> None:
    """Write a solid, whose points are in a unit that only 3MF files state, completely or not at all.

    Raises:
        OutputError: it cannot be written.
    """
    partial = path.with_name(f".{path.stem}.partial{path.suffix}")
    try:
        WRITERS[path.suffix](partial, solid, unit)
        partial.replace(path)
    except OutputError as error:
        raise OutputError(f"{path}: {error.message}", error.advice) from None
    except Exception as error:  # VTK and lib3mf raise nothing narrower
        raise OutputError(
            f"{path}: cannot be written: {error}", "Is the directory writable, and space left?"
        ) from error
    finally:
        partial.unlink(missing_ok=True)


def _write_with_vtk(path: Path, solid: Solid, unit: str) -> None:
    import pyvista

    single = solid.in_single_precision()
    surface = pyvista.PolyData.from_regular_faces(single.points.astype(np.float32), single.triangles)
    surface.save(path, binary=True, recompute_normals=False)


def _write_3mf(path: Path, solid: Solid, unit: str) -> None:
    import lib3mf

    single = solid.in_single_precision()
    wrapper = lib3mf.get_wrapper()
    model = wrapper.CreateModel()
    model.SetUnit(lib3mf.ModelUnit[UNITS_OF_3MF[unit]])
    mesh = model.AddMeshObject()
    mesh.SetGeometry(
        [lib3mf.Position((x, y, z)) for x, y, z in single.points.tolist()],
        [lib3mf.Triangle((a, b, c)) for a, b, c in single.triangles.tolist()],
    )
    model.AddBuildItem(mesh, wrapper.GetIdentityTransform())
    model.QueryWriter("3mf").WriteToFile(str(path))


WRITERS: dict[str, Callable[[Path, Solid, str], None]] = {
    ".stl": _write_with_vtk,
    ".ply": _write_with_vtk,
    ".3mf": _write_3mf,
}
"""Writers by the suffix of a file."""
