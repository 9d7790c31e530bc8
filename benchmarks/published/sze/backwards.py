"""Sze, Liu and Lo's eight shells at full load, and back: ``python -m benchmarks.published.sze.backwards [CASE ...]``.

Each is solved forward, and its shape file then backwards: without a start, and the panels once more from a cylinder
whose radius is 10 % too large. The table shows the largest distance of the recovered surface from the unloaded one
relative to its diagonal, and the unstable directions of the loaded body; or why there is none.

Moment and point loads are arrays at the nodes. A formula of the unknown body, such as ``atan2(X, Z)``, would be another
load all along the path, and right only at its end.

Source: Sze, Liu & Lo 2004, doi:10.1016/j.finel.2003.11.001.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.spatial import cKDTree

import hpcinv
from hpcinv.errors import HpcinvError
from hpcinv.mesh.cell_count import MeshingMonitor
from hpcinv.mesh.io.gmsh_model import save_msh
from hpcinv.mesh.readers import build_python, read_surface
from hpcinv.mesh.source import DataArray

SZE = Path(__file__).parent
sys.path[:0] = [str(Path(__file__).parents[3] / "tests")]

from helpers.sheets import flat, save_sheet  # noqa: E402

ARC = {"strategy": "arc-length", "limit_points": 2, "initial_step": 0.1}
CLAMPED = [{"region": "x0", "fix": ["x", "y", "z"]}]
ROUGH = 1.1  # radius of the start by the unloaded one, at the same arc lengths
OUTPUT = {"fields": False, "report": False, "unit_warnings": False}


@dataclass(frozen=True)
class BackwardCase:
    """A job, and the radius (m) of its unloaded cylinder, if it is one."""

    job: dict[str, Any]
    radius: float = 0.0


def _strip(directory: Path, length: float, cells: int, **data: Any) -> dict[str, Any]:
    path = save_sheet(directory / f"strip-{length:g}.msh", cells, 1, flat(length, 1))
    return {"mesh": {"file": str(path), "shell": {"thickness": 0.1}}, "supports": CLAMPED} | data


def _ring(directory: Path) -> dict[str, Any]:
    def place(s: np.ndarray, t: np.ndarray) -> np.ndarray:
        return np.column_stack([(6 + 4 * s) * np.cos(2 * np.pi * t), (6 + 4 * s) * np.sin(2 * np.pi * t), 0 * s])

    path = save_sheet(directory / "ring.msh", 4, 24, place)
    return {
        "mesh": {"file": str(path), "shell": {"thickness": 0.03}},
        "material": {"law": "st-venant-kirchhoff", "young": 21e6, "poisson": 0},
        "effects": [{"effect": "traction", "region": "y1", "traction": [0, 0, 0.8 / 0.03], "area_in": "reference"}],
        "supports": [{"region": "y0", "fix": ["x", "y", "z"]}],
    }


def _published(name: str) -> dict[str, Any]:
    job: dict[str, Any] = yaml.safe_load((SZE / f"{name}.yaml").read_text())
    job["mesh"]["file"] = str(SZE / job["mesh"]["file"])
    return job


def _panel(
    directory: Path, name: str, force: float, thickness: float, solver: Mapping[str, Any], cells: int = 0
) -> BackwardCase:
    """Return a published panel with a force (N, upwards) on the node at its origin, as an array of the mesh.

    Args:
        cells: of each edge; 0 for the job's.
    """
    job = _published(name)
    if cells:
        job["mesh"]["parameters"] |= {"nx": cells, "ny": cells}
    units = {"mm": 1e-3, "m": 1.0}
    texts = {key: str(value).split() for key, value in job["mesh"]["parameters"].items()}
    numbers = {key: float(text[0]) * units[[*text, "m"][1]] for key, text in texts.items()}
    surface = build_python(Path(job["mesh"]["file"]), numbers, None, MeshingMonitor(10**6), is_surface=True)
    radius = numbers["radius"]
    cell = (numbers["angle"] - numbers.get("strip", 0.0) / radius) / numbers.get("nx", 8)
    s = np.arctan2(surface.points[:, 0], radius - surface.points[:, 2]) / cell
    traction = np.where(s < 1 + 1e-9, force / (thickness * radius * cell) * (9 - 36 * s + 30 * s**2), 0.0)
    path = directory / f"{name}.msh"
    data = {"force": DataArray("force", "nodes", traction[:, None])}
    save_msh(path, replace(surface, data=data, unit=1.0), surface.points)
    load = {"effect": "traction", "region": "corner", "traction": [0, 0, {"data": "force"}], "area_in": "reference"}
    mesh = {"file": str(path), "shell": job["mesh"]["shell"]}
    rest = {key: value for key, value in job.items() if key != "let"}
    return BackwardCase({**rest, "mesh": mesh, "effects": [load], "solver": dict(solver)}, radius=radius)


def cases(directory: Path) -> dict[str, BackwardCase]:
    """Return the cases by section of the article and name."""
    young = 1.2e6
    linear = {"law": "st-venant-kirchhoff", "young": young, "poisson": 0.0}
    shear = {"effect": "traction", "region": "x1", "traction": [0, 0, 4 * young * 1e-2 / 1200], "area_in": "reference"}
    bent = _strip(
        directory,
        12,
        24,
        material=linear,
        supports=[*CLAMPED, {"region": "y0", "fix": ["y"]}],  # free to leave its plane, it is not stable
        effects=[{"effect": "edge-moment", "region": "x1", "moment": [0, -young * 0.1**3 / 12 * 2 * np.pi / 12, 0]}],
    )
    return {
        "3.1 cantilever, end force of 4 E I/L²": BackwardCase(
            _strip(directory, 10, 16, material=linear, effects=[shear])
        ),
        "3.2 cantilever, end moment, full ring": BackwardCase(bent),
        "3.3 slit ring, 0.8 N/m": BackwardCase(_ring(directory)),
        "3.4 hemisphere with a hole, 400 N": BackwardCase(_published("hemisphere")),
        "3.5 open cylinder, 40 kN": _panel(directory, "cylinder", -40e3 / 4, 94e-3, ARC),
        "3.6 cylinder between diaphragms, 12 kN": _panel(directory, "pinched", 12e3 / 4, 1e-3, {}, cells=40),
        "3.7 half cylinder, 2 kN": _panel(directory, "semi", 2e3 / 2, 30e-3, {}),
        "3.8 roof of 12.7 mm, 2.89 kN": _panel(directory, "roof", 0.9643 * 3e3 / 4, 12.7e-3, ARC),
        "3.8 roof of three plies, 2.35 kN": _panel(directory, "laminate", 0.7829 * 3e3 / 4, 12.7e-3, ARC),
    }


def rows(name: str, case: BackwardCase, directory: Path) -> None:
    """Print the rows of a case, which start from the shape file of the loaded surface, with its faces as data."""
    loaded = directory / name.split(",")[0].replace(" ", "-")
    there = {**case.job, "analysis": "forward", "output": {**OUTPUT, "mesh": ["msh"]}, "certificate": {"level": "off"}}
    try:
        forward = hpcinv.run(there, progress=False, directory=loaded).solutions[0]
    except HpcinvError as error:
        print(f"| {name} | | forward: {error}".splitlines()[0], "| | |", flush=True)
        return
    size = float(np.linalg.norm(np.ptp(forward.mesh_nodes, axis=0)))
    largest = np.linalg.norm(forward.u, axis=1).max() / size
    unloaded = cKDTree(forward.mesh_nodes)
    for start in ["", "rough cylinder"] if case.radius else [""]:
        back = {
            **there,
            **way_back(case, loaded / "shape.msh", is_rough=bool(start)),
            "quantities": [],
            "output": {**OUTPUT, "mesh": []},
            "certificate": {"estimate": False, "round_trip": "off", "overlap": False},
        }
        try:
            result = hpcinv.run(back, progress=False)
            distance = f"{unloaded.query(result.solutions[0].other_nodes)[0].max() / size:.1e}"
            line = next(line for line in result.certificate.lines if line.name.startswith("stability"))
            unstable = line.verdict.value if line.value is None else f"{line.value:.0f} ({line.verdict.value})"
        except HpcinvError as error:
            distance, unstable = str(error).splitlines()[0], ""
        print(f"| {name} | {start} | {distance} | {largest:.2f} | {unstable} |", flush=True)


def way_back(case: BackwardCase, loaded: Path, *, is_rough: bool = True) -> dict[str, Any]:
    """Return the settings of the way back from a loaded surface: if it is a cylinder, from one of another radius."""
    shell = {"director": "data"} | {k: v for k, v in case.job["mesh"]["shell"].items() if k == "layers"}
    solver: dict[str, Any] = {}
    if case.radius and is_rough:
        start = _rough(Path(case.job["mesh"]["file"]), case.radius)
        solver = {"start_shape": str(start), "initial_step": 0.05}
    return {"analysis": "inverse", "mesh": {"file": str(loaded), "shell": shell}, "solver": solver}


def _rough(path: Path, radius: float) -> Path:
    """Write the cylinder of another radius on the cells of a panel, and return its file."""
    surface, other = read_surface(path), ROUGH * radius
    x, y, z = surface.points.T
    angle = np.arctan2(x, radius - z) / ROUGH
    points = np.column_stack([other * np.sin(angle), y, other * (1 - np.cos(angle))])
    rough = path.with_stem(f"{path.stem}-rough")
    save_msh(rough, replace(surface, points=points, data={}), points)
    return rough


def main(chosen: list[str]) -> None:
    """Print the rows of each case."""
    print("| case | start | distance, relative to the size | largest displacement | stability: unstable directions |")
    print("|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as directory:
        os.environ.setdefault("OMP_NUM_THREADS", "1")
        for name, case in cases(Path(directory)).items():
            if not chosen or any(name.startswith(section) for section in chosen):
                rows(name, case, Path(directory))


if __name__ == "__main__":
    main(sys.argv[1:])
