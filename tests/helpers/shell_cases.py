"""Jobs of shells, and what their tests measure."""

from pathlib import Path
from typing import Any

import numpy as np

import hpcinv
from helpers.sheets import Place
from hpcinv.base.parallel.runtime import MPI
from hpcinv.output.result import Result

YOUNG = 1.2e6
LINEAR = {"law": "st-venant-kirchhoff", "young": YOUNG, "poisson": 0.0}
CLAMPED = {"region": "x0", "fix": ["x", "y", "z"]}


def job(path: Path, thickness: float, **data: Any) -> dict[str, Any]:
    mesh = {"file": str(path), "shell": {"thickness": thickness}}
    return {"mesh": mesh, "material": LINEAR, "certificate": {"level": "quick"}} | data


def solve(path: Path, thickness: float, comm: MPI.Intracomm = MPI.COMM_SELF, **data: Any) -> Result:
    return hpcinv.run(job(path, thickness, **data), comm, progress=False)


def gap(result: Result) -> float:
    """Largest distance between both bodies of a round trip."""
    there, back = (solution.u for solution in result.solutions)
    return float(np.abs(there - back).max())


def cylinder(radius: float, height: float, angle: float) -> Place:
    """Return the places of a part of a cylinder around the z axis, from the x axis on."""
    return lambda s, t: np.column_stack([radius * np.cos(angle * s), radius * np.sin(angle * s), height * t])


def weight(acceleration: float) -> dict[str, Any]:
    return {"effect": "gravity", "density": 1000, "acceleration": [0, 0, acceleration], "density_in": "reference"}
