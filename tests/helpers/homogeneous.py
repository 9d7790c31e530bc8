"""Homogeneous states of a unit cube, which every discretisation must give exactly."""

from __future__ import annotations

from typing import Any

import numpy as np

from helpers.closed_forms import MU, NEO_HOOKEAN
from helpers.verification import Solved, box, job
from hpcinv.base.parallel.runtime import MPI
from hpcinv.model.quadrature_values import CellMeans

SYMMETRY = [{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"]


def solve(direction: str, comm: MPI.Intracomm, **data: Any) -> Solved:
    """A cube of linear tetrahedra, held on three planes unless it is said otherwise."""
    common: dict[str, Any] = {
        "mesh": box((2, 1, 1)),
        "material": NEO_HOOKEAN,
        "supports": SYMMETRY,
        "discretisation": {"displacement": 1},
        "solver": {"tolerance": 1e-14},
    }
    return Solved(job(analysis=direction, **(common | data)), comm)


def check(solved: Solved, F: np.ndarray, stress: np.ndarray, origin: tuple[float, ...] = (0, 0, 0)) -> None:
    """``∂x/∂X = F``, the displacement (m) at the origin of the given cube, and the Cauchy stress (Pa)."""
    H = F - np.eye(3) if solved.kinematics.direction == "forward" else np.eye(3) - np.linalg.inv(F)
    displacement, length = solved.model.unknowns.displacement(), solved.body.length_scale
    u, points = displacement.x.array.reshape(-1, 3), displacement.function_space.tabulate_dof_coordinates()
    means = CellMeans(solved.weak_form.cauchy_stress, solved.body.mesh, solved.model.quadrature_degree)()
    sigma = means.x.array.reshape(-1, 3, 3) * solved.model.scales.stress
    errors = {
        "displacement": np.abs((u - points @ H.T) * length - origin).max(),
        "stress / mu": np.abs(sigma - stress).max() / MU,
    }
    print(f"{solved.kinematics.direction}:", ", ".join(f"{name} {error:.1e}" for name, error in errors.items()))
    assert max(errors.values()) < 1e-12
