"""Jobs on meshes of the paper's repository, in the clone that ``HPCINV_MAZIER`` names.

Names are ``beam`` and ``sofa-CELLS``, each also with ``-unloaded``, from the loaded mesh that the repository stores.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from hpcinv.mesh.io.vtu import save_vtu
from hpcinv.mesh.source import MeshSource

from ..runs import Missing

if TYPE_CHECKING:
    import numpy.typing as npt

    Floats = npt.NDArray[np.float64]
    Ints = npt.NDArray[np.int64]

FOLDER = "HPCINV_MAZIER"
UNLOADED = "-unloaded"
"""End of the name of an inverse job."""
LAST_STEP = {"7675": 66, "12724": 66, "23665": 66, "52979": 70}
"""Of SOFA's results, by the number of cells."""
SOFA = "cylinderPDMS_{0}_MjedMR_mesh_convergence"
COMMON: dict[str, Any] = {"certificate": "quick", "output": {"fields": False, "mesh": []}}
WEIGHT = {"effect": "gravity", "acceleration": [0, "-9.81 m/s^2", 0], "density": "963 kg/m^3"}


def job_file(name: str, store: Path) -> Path:
    """Write mesh and job of a name, and return the job's file; raises `Missing`."""
    body, inverse = name.removesuffix(UNLOADED), name.endswith(UNLOADED)
    points, cells, job = _beam(inverse) if body == "beam" else _sofa(body.removeprefix("sofa-"), inverse)
    corners = points[cells]
    turned = np.linalg.det(corners[:, 1:] - corners[:, :1]) < 0  # DOLFIN sorts the nodes of a cell
    cells[turned] = cells[turned][:, [0, 1, 3, 2]]
    directory = store / "jobs" / name
    directory.mkdir(parents=True, exist_ok=True)
    mesh, path = directory / "mesh.vtu", directory / f"{name}.yaml"
    tags = np.arange(1, len(points) + 1), np.arange(1, len(cells) + 1)
    source = MeshSource(mesh, "tetrahedron", 1, points, tags[0], cells, tags[1], np.empty((0, 3), dtype=np.int64))
    save_vtu(mesh, source, points)
    analysis = {"job": name, "analysis": "inverse" if inverse else "forward", "mesh": {"file": mesh.name}}
    path.write_text(yaml.safe_dump({**analysis, **COMMON, **job}, sort_keys=False, width=120))
    return path


def _file(name: str) -> Path:
    folder = os.environ.get(FOLDER)
    if folder is None:
        raise Missing(f"the paper's repository is not here: set {FOLDER} to a clone of Ziemnono/fenics-inverseFEM")
    if not (path := Path(folder) / name).exists():
        raise Missing(f"{path} is missing ({FOLDER})")
    return path


def _beam(inverse: bool) -> tuple[Floats, Ints, dict[str, Any]]:
    """Return mesh and settings of the beam in displacement and pressure."""
    import h5py

    with h5py.File(_file("examples/meshes/Beam2k.h5")) as file:
        straight, cells = file["data0"][...], file["data1"][...].astype(np.int64)
    with h5py.File(_file("examples/Beam/results/forward_deformed_configurationBeam2k.h5")) as file:
        loaded = file["Mesh/mesh/geometry"][...]
    points = loaded if inverse else straight
    nodes = {"upper": 22, "lower": 8, "inner": 1143}
    return (
        points,
        cells,
        _settings(points, nodes, "x", inverse)
        | {
            "material": {"law": "mooney-rivlin", "c1": 101709.668, "c2": 151065.460, "d1": 7.965272689e8},
            "effects": [WEIGHT | {"density_in": "current" if inverse else "reference"}],
        },
    )


def _sofa(cells_of: str, inverse: bool) -> tuple[Floats, Ints, dict[str, Any]]:
    """Return mesh and settings of SOFA's linear tetrahedra."""
    straight, cells = _vtk(_file(f"sofa_scenes/inData/cylinderPDMS{cells_of}Vol.vtk"))
    end = SOFA.format(cells_of)
    points = straight
    if inverse:
        points = _vtk(_file(f"sofa_scenes/outData/{end}/{end}_{LAST_STEP[cells_of]}.vtk"))[0]
    top = int(np.linalg.norm(straight - [0, 0.00425, 0.182], axis=1).argmin())
    law = {"law": "mooney-rivlin", "c1": 151065.460, "c2": 101709.668, "d1": 5e6, "volumetric": "logarithmic"}
    return (
        points,
        cells,
        _settings(points, {"top": top}, "z", inverse)
        | {
            "material": law,
            "effects": [WEIGHT | {"density_in": "reference"}],
            "discretisation": {"displacement": 1, "formulation": "displacement"},
        },
    )


def _settings(points: Floats, nodes: dict[str, int], axis: str, inverse: bool) -> dict[str, Any]:
    """Return clamp and quantities: coordinates of some nodes in the other body."""
    places = "XYZ" if inverse else "xyz"
    return {
        "regions": {"clamp": f"{axis} < 1 um"},
        "supports": [{"region": "clamp", "fix": ["x", "y", "z"]}],
        "quantities": [
            {"name": f"{name}-{place.lower()}", "of": place, "at": points[node].tolist()}
            for name, node in nodes.items()
            for place in places
        ],
    }


def _vtk(path: Path) -> tuple[Floats, Ints]:
    """Return points and tetrahedra of a legacy VTK file of SOFA."""
    words = path.read_text().split()
    start, cells = words.index("POINTS"), words.index("CELLS")
    points = np.array(words[start + 3 : start + 3 + 3 * int(words[start + 1])], dtype=float).reshape(-1, 3)
    numbers = np.array(words[cells + 3 : cells + 3 + int(words[cells + 2])], dtype=np.int64)
    return points, numbers.reshape(-1, 5)[:, 1:]
