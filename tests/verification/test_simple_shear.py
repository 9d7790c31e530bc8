"""Simple shear u = (k y, 0, 0) on the whole boundary: homogeneous, so every discretisation must give it exactly.

The closed forms are from the paper (Mazier et al. 2022, doi:10.1007/s00366-021-01597-z) for Mooney–Rivlin; for
neo-Hookean σ = μ (F Fᵀ - I) and ψ = μ k²/2, since J = 1.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import ufl
from helpers.verification import Solved, box, job

from hpcinv.base.parallel.runtime import MPI

C1, C2, MU = 1.0e5, 1.5e5, 3.0e4
NEARLY, FULLY, SOFT = 5.0e7, "incompressible", 5.0e5


def mooney_rivlin_stress(k: float) -> np.ndarray:
    s00, s11, s22 = k**2 * (2 * C2 + 4 * C1) / 3, -(k**2) * (4 * C2 + 2 * C1) / 3, k**2 * (2 * C2 - 2 * C1) / 3
    s01 = k * (2 * C1 + 2 * C2)
    return np.array([[s00, s01, 0], [s01, s11, 0], [0, 0, s22]])


def neo_hookean_stress(k: float) -> np.ndarray:
    return MU * np.array([[k**2, k, 0], [k, 0, 0], [0, 0, 0]])


MOONEY_RIVLIN = (mooney_rivlin_stress, lambda k: k**2 * (C1 + C2))
NEO_HOOKEAN = (neo_hookean_stress, lambda k: MU * k**2 / 2)

CASES: list[tuple[str, dict[str, Any], Any, dict[str, Any], dict[str, Any]]] = [
    ("displacement form", {"law": "mooney-rivlin", "c1": C1, "c2": C2, "d1": SOFT}, MOONEY_RIVLIN, box(), {}),
    ("mixed form", {"law": "mooney-rivlin", "c1": C1, "c2": C2, "d1": NEARLY}, MOONEY_RIVLIN, box(), {}),
    ("neo-Hookean", {"law": "neo-hookean", "mu": MU, "lam": 4 * MU}, NEO_HOOKEAN, box((3, 2, 1)), {}),
    ("neo-Hookean, mixed", {"law": "neo-hookean", "mu": MU, "lam": 1e3 * MU}, NEO_HOOKEAN, box(), {}),
    (
        "hexahedra",
        {"law": "mooney-rivlin", "c1": C1, "c2": C2, "d1": NEARLY},
        MOONEY_RIVLIN,
        box(hexahedra=True),
        {},
    ),
    (
        "linear elements",
        {"law": "mooney-rivlin", "c1": C1, "c2": C2, "d1": SOFT},
        MOONEY_RIVLIN,
        box(),
        {"displacement": 1},
    ),
    (
        "cubic elements on curved cells",
        {"law": "neo-hookean", "mu": MU, "lam": 4 * MU},
        NEO_HOOKEAN,
        box((2, 1, 1)) | {"geometry_degree": 2},
        {"displacement": 3},
    ),
]


def solve(direction: str, k: float, material: Any, mesh: Any, discretisation: Any, comm: MPI.Intracomm) -> Solved:
    return Solved(
        job(
            analysis=direction,
            mesh=mesh,
            material=material,
            discretisation=discretisation,
            supports=[{"region": "boundary", "displacement": ["k*y", "0", "0"], "constants": {"k": k}}],
        ),
        comm,
    )


def check(solved: Solved, k: float, stress: Any, energy: Any) -> None:
    y = solved.x[1]
    errors = {
        "stress": solved.relative_error(solved.cauchy_stress, solved.constant(stress(k))),
        "energy": abs(solved.strain_energy / energy(k) - 1),
        "displacement": solved.relative_error(solved.displacement, ufl.as_vector([solved.constant(k) * y, 0, 0])),
    }
    print(f"k = {k}:", ", ".join(f"{name} {error:.1e}" for name, error in errors.items()))
    assert max(errors["energy"], errors["displacement"]) < 1e-12
    assert errors["stress"] < 1e-11  # a pressure of up to 1000 shear moduli times the rounding of the volume ratio


@pytest.mark.everyday(
    "linear elements-inverse",
    "hexahedra-inverse",
    "neo-Hookean-forward",
    "neo-Hookean, mixed-inverse",
)
@pytest.mark.parametrize("direction", ["forward", "inverse"])
@pytest.mark.parametrize(("name", "material", "exact", "mesh", "discretisation"), CASES, ids=[c[0] for c in CASES])
def test_stress_energy_and_shape_are_exact(
    direction: str, name: str, material: Any, exact: Any, mesh: Any, discretisation: Any, comm: MPI.Intracomm
) -> None:
    check(solve(direction, 0.4, material, mesh, discretisation, comm), 0.4, *exact)


@pytest.mark.release
@pytest.mark.parallel([3])
def test_shears_are_exact_on_more_ranks(comm: MPI.Intracomm) -> None:
    """A small shear of one case, and a large one of another, in different directions."""
    for direction, k, case in (("forward", 1e-6, CASES[1]), ("inverse", 1.0, CASES[2])):
        _, material, exact, mesh, discretisation = case
        check(solve(direction, k, material, mesh, discretisation, comm), k, *exact)
