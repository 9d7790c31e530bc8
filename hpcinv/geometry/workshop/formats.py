"""Files of solids for printers, mills and CAD programs: STL, PLY, 3MF and faceted STEP."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from hpcinv.base.files.atomic import write_output
from hpcinv.base.files.names import check_directory_of
from hpcinv.base.mesh_formats import MESHES
from hpcinv.base.reading.suffix import suffix_of
from hpcinv.errors import OutputError
from hpcinv.geometry.workshop.solid import Solid
from hpcinv.geometry.workshop.step import step_content

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
    if suffix_of(path) not in WRITERS:
        text = f"{path}: the formats of solids are {', '.join(WRITERS)}"
        raise OutputError(text, f"--to also writes meshes of cells: {', '.join(MESHES)}.")
    if suffix_of(path) == ".3mf" and unit not in UNITS_OF_3MF:
        raise OutputError(f"{path}: 3MF knows no unit '{unit}'", f"Its units are {', '.join(UNITS_OF_3MF)}.")
    check_directory_of(path)


def write(path: Path, solid: Solid, unit: str) -> None:
    """Write a solid, whose points are in a unit that only 3MF files state (STEP: mm), completely or not at all.

    Raises:
        OutputError: it cannot be written.
    """
    try:
        content = WRITERS[suffix_of(path)](solid.round_to_single(), unit)
    except OutputError as error:
        raise OutputError(f"{path}: {error.message}", error.advice) from None
    write_output(path, content, "Is the directory writable, and space left?")


def _stl(solid: Solid, _unit: str) -> bytes:
    corners = solid.points[solid.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facets = np.zeros(len(corners), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    facets["normal"] = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(float).tiny)
    facets["corners"] = corners
    return b"hpcinv".ljust(80) + len(facets).to_bytes(4, "little") + facets.tobytes()


def _ply(solid: Solid, _unit: str) -> bytes:
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(solid.points)}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {len(solid.triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    faces = np.empty(len(solid.triangles), [("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, solid.triangles
    return header.encode() + solid.points.astype("<f4").tobytes() + faces.tobytes()


def _3mf(solid: Solid, unit: str) -> bytes:
    import lib3mf

    wrapper = lib3mf.get_wrapper()
    model = wrapper.CreateModel()
    model.SetUnit(lib3mf.ModelUnit[UNITS_OF_3MF[unit]])
    mesh = model.AddMeshObject()
    mesh.SetGeometry(
        [lib3mf.Position((x, y, z)) for x, y, z in solid.points.tolist()],
        [lib3mf.Triangle((a, b, c)) for a, b, c in solid.triangles.tolist()],
    )
    model.AddBuildItem(mesh, wrapper.GetIdentityTransform())
    return bytes(model.QueryWriter("3mf").WriteToBuffer())


WRITERS: dict[str, Callable[[Solid, str], bytes]] = {
    ".stl": _stl,
    ".ply": _ply,
    ".3mf": _3mf,
    ".step": step_content,
    ".stp": step_content,
}
"""Contents of files by their suffix, made in memory: on a full disk VTK leaves half of a PLY, and lib3mf aborts."""
