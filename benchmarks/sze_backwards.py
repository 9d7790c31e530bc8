"""Sze, Liu and Lo's eight shells at their full loads, and back: ``python benchmarks/sze_backwards.py [CASE ...]``.

Each is solved forward, and its shape file then backwards, without a start. The table shows the largest distance of the
recovered surface from the unloaded one, relative to its diagonal, or why there is none. Where
``benchmarks/published/sze`` has a job of shells, it is used.

Source: Sze, Liu & Lo 2004, doi:10.1016/j.finel.2003.11.001.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.spatial import cKDTree

import hpcinv
from hpcinv.errors import HpcinvError

SZE = Path(__file__).parent / "published" / "sze"
sys.path[:0] = [str(Path(__file__).parents[1] / "tests")]

from helpers.sheets import flat, save_sheet  # noqa: E402

ARC = {"strategy": "arc-length", "limit_points": 2, "initial_step": 0.1}
CLAMPED = [{"region": "x0", "fix": ["x", "y", "z"]}]
ROOF_LOAD = 0.9643  # of 3 kN: the last one of Sze's table


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


def _published(name: str, share: float = 1.0, solver: Mapping[str, Any] | None = None, **shell: Any) -> dict[str, Any]:
    job: dict[str, Any] = yaml.safe_load((SZE / f"{name}.yaml").read_text())
    job["mesh"]["file"] = str(SZE / job["mesh"]["file"])
    if "share" in job.get("let", {}):
        job["let"]["share"] = share
    job["mesh"]["shell"] |= shell
    return job | ({"solver": dict(solver)} if solver else {})


def jobs(directory: Path) -> dict[str, dict[str, Any]]:
    """Return the jobs by section of the article and name."""
    young = 1.2e6
    linear = {"law": "st-venant-kirchhoff", "young": young, "poisson": 0.0}
    largest = np.pi * 0.1 / 12
    moment = f"1.2 MPa*(strain - 1.5*(strain**2 - {largest:.17g}**2/3))"
    shear = {"effect": "traction", "region": "x1", "traction": [0, 0, 4 * young * 1e-2 / 1200], "area_in": "reference"}
    return {
        "3.1 cantilever, end force of 4 E I/L²": _strip(directory, 10, 16, material=linear, effects=[shear]),
        "3.2 cantilever, end moment, full ring": _strip(
            directory,
            12,
            24,
            material=linear,
            let={"strain": "2*pi*Z/(12 m)"},
            effects=[{"effect": "pressure", "region": "x1", "pressure": moment}],
        ),
        "3.3 slit ring, 0.8 N/m": _ring(directory),
        "3.4 hemisphere with a hole, 400 N": _published("hemisphere"),
        "3.5 open cylinder, 40 kN": _published("cylinder", solver=ARC),
        "3.6 cylinder between diaphragms, 12 kN": _published("pinched", solver=ARC),
        "3.7 half cylinder, 2 kN": _published("semi"),
        "3.8 roof of 12.7 mm, 2.89 kN": _published("roof", ROOF_LOAD, ARC),
        "3.8 roof of three plies, 2.35 kN": _published("laminate", 0.7829, ARC),
    }


def distance(name: str, job: Mapping[str, Any], directory: Path) -> str:
    """Return the distance of both unloaded bodies by the diagonal, and the largest displacement, or the reason of none.

    The way back starts from the shape file of the loaded surface, with its faces as data.
    """
    loaded = directory / name.split(",")[0].replace(" ", "-")
    output: dict[str, Any] = {"fields": False, "report": False, "unit_warnings": False}
    there = {**job, "analysis": "forward", "certificate": {"level": "off"}, "output": {**output, "mesh": ["msh"]}}
    try:
        forward = hpcinv.run(there, progress=False, directory=loaded).solutions[0]
    except HpcinvError as error:
        return f"forward: {error}".splitlines()[0] + " | "
    shell: dict[str, Any] = {"director": "data"} | {k: v for k, v in job["mesh"]["shell"].items() if k == "layers"}
    mesh = {"file": str(loaded / "shape.msh"), "shell": shell}
    back = {
        **there,
        "analysis": "inverse",
        "mesh": mesh,
        "solver": {},
        "quantities": [],
        "output": {**output, "mesh": []},
    }
    size = np.linalg.norm(np.ptp(forward.mesh_nodes, axis=0))
    largest = f"{np.linalg.norm(forward.u, axis=1).max() / size:.2f}"
    try:
        inverse = hpcinv.run(back, progress=False).solutions[0]
    except HpcinvError as error:
        return f"back: {error}".splitlines()[0] + f" | {largest}"
    return f"{cKDTree(forward.mesh_nodes).query(inverse.other_nodes)[0].max() / size:.1e} | {largest}"


def main(chosen: list[str]) -> None:
    """Print a row of each case."""
    print("| case | distance, relative to the size | largest displacement |\n|---|---|---|")
    with tempfile.TemporaryDirectory() as directory:
        os.environ.setdefault("OMP_NUM_THREADS", "1")
        for name, job in jobs(Path(directory)).items():
            if not chosen or any(name.startswith(case) for case in chosen):
                print(f"| {name} | {distance(name, job, Path(directory))} |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
