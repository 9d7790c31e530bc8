"""Prestrain: homogeneous states against numpy, an artery cut open against its radial quadrature, and what is refused.

A stress-free stretch ``F0`` leaves ``F_e = F F0⁻¹`` to the law, with the energy ``det F0 psi(F_e)`` per reference
volume, so that ``P = det F0 P_e F0⁻ᵀ``.
"""

from __future__ import annotations

from math import log
from typing import Any

import numpy as np
import pytest
from helpers.closed_forms import LAM, MU, NEO_HOOKEAN, neo_hookean_stress, root
from helpers.homogeneous import SYMMETRY, check, solve
from helpers.verification import Solved, box

from hpcinv.parallel.runtime import MPI

NOTHING = np.zeros((3, 3))
F0 = np.array([[1.15, 0.1, 0.0], [-0.05, 0.9, 0.08], [0.12, 0.0, 1.05]])
F = np.array([[1.05, -0.1, 0.04], [0.1, 1.1, 0.0], [0.0, 0.06, 0.92]])

both_ways = pytest.mark.parametrize("direction", ["forward", "inverse"])


def prestrain(tensor: Any, given_on: str = "reference") -> dict[str, Any]:
    return {"effect": "prestrain", "tensor": np.asarray(tensor).tolist(), "given_on": given_on}


def boundary(direction: str, F: np.ndarray) -> list[dict[str, Any]]:
    """The whole boundary follows ``x = F X``, whichever body is given."""
    H = F - np.eye(3) if direction == "forward" else np.eye(3) - np.linalg.inv(F)
    formulas = [" + ".join(f"({h!r})*{axis}" for h, axis in zip(row, "xyz", strict=True)) for row in H.tolist()]
    return [{"region": "boundary", "displacement": formulas}]


def cauchy(F: np.ndarray, F0: np.ndarray) -> np.ndarray:
    """Cauchy stress from the elastic part."""
    elastic = F @ np.linalg.inv(F0)
    return neo_hookean_stress(elastic) @ elastic.T / np.linalg.det(elastic)


def energy(F: np.ndarray, F0: np.ndarray) -> float:
    """Energy per reference volume: of the stress-free volume, times ``det F0``."""
    elastic = F @ np.linalg.inv(F0)
    ln_J = log(np.linalg.det(elastic))
    psi = MU / 2 * (np.trace(elastic.T @ elastic) - 3) - MU * ln_J + LAM / 2 * ln_J**2
    return float(np.linalg.det(F0) * psi)


def on_the_reference(given_on: str, F: np.ndarray, tensor: np.ndarray) -> np.ndarray:
    """The tensor of the reference body."""
    return tensor if given_on == "reference" else np.linalg.inv(F) @ tensor @ F


def check_energy(solved: Solved, density: float, F: np.ndarray) -> None:
    """The energy of a unit cube, which is the reference body or, in an inverse analysis, the current one."""
    volume = 1.0 if solved.kinematics.direction == "forward" else 1 / np.linalg.det(F)
    assert solved.strain_energy == pytest.approx(density * volume, rel=1e-12, abs=1e-12 * MU)


def check_prestrain_stress(solved: Solved, expected: np.ndarray) -> None:
    found = solved.scene.means.prestrain_stress
    assert found is not None
    values = found().x.array.reshape(-1, 3, 3) * solved.model.scales.stress
    assert np.abs(values - expected).max() < 1e-12 * MU


@pytest.mark.parametrize("given_on", ["reference", "current"])
@both_ways
def test_a_cube_has_the_stress_and_the_energy_of_the_elastic_part(
    direction: str, given_on: str, comm: MPI.Intracomm
) -> None:
    """Held in its shape, in the shape of its prestrain (without stress), and in a third one."""
    for deformed in (np.eye(3), F0, F):
        own = on_the_reference(given_on, deformed, F0)
        supports = boundary(direction, deformed)
        solved = solve(direction, comm, effects=[prestrain(F0, given_on)], supports=supports)
        check(solved, deformed, cauchy(deformed, own))
        check_energy(solved, energy(deformed, own), deformed)
        check_prestrain_stress(solved, cauchy(np.eye(3), own))
    assert np.abs(cauchy(F0, F0)).max() < 1e-12 * MU


@both_ways
def test_a_free_cube_takes_the_shape_of_its_prestrain(direction: str, comm: MPI.Intracomm) -> None:
    U = np.diag([1.2, 0.85, 1.1])
    check(solve(direction, comm, effects=[prestrain(U)]), U, NOTHING)
    # Heat multiplies it, and a rotation has no effect.
    turned = np.array([[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1]]) @ U
    check(solve(direction, comm, effects=[prestrain(turned)]), U, NOTHING)


def test_a_bar_between_rigid_ends_is_pulled_by_its_prestrain(comm: MPI.Intracomm) -> None:
    """``F_e = diag(1/a, e, e)`` with ``e = s/b``; no lateral stress, ``mu (e² - 1) + lam ln J_e = 0``."""
    a, b = 0.8, 1.1
    e = root(lambda e: MU * (e**2 - 1) + LAM * log(e**2 / a), 0.5, 1.5)
    deformed, own = np.diag([1, e * b, e * b]), np.diag([a, b, b])
    supports = [*SYMMETRY, {"region": "x1", "fix": ["x"]}]
    stress = cauchy(deformed, own)
    assert stress[0, 0] > MU / 10
    for direction in ("forward", "inverse"):
        solved = solve(direction, comm, effects=[prestrain(own)], supports=supports)
        check(solved, deformed, np.diag([stress[0, 0], 0, 0]))


@both_ways
def test_an_incompressible_cube_has_the_volume_of_its_prestrain(direction: str, comm: MPI.Intracomm) -> None:
    U = np.diag([1.2, 0.95, 1.1])
    given_on = {"forward": "current", "inverse": "reference"}[direction]
    material = NEO_HOOKEAN | {"lam": "incompressible"}
    effects = [prestrain(U, given_on)]
    solved = solve(direction, comm, effects=effects, material=material, discretisation={}, mesh=box((1, 1, 1)))
    check(solved, U, NOTHING)
    inverse = np.linalg.inv(U)
    stress = MU * inverse @ inverse * np.linalg.det(U)  # the law's, mu F_e F_eᵀ / J_e and a pressure
    check_prestrain_stress(solved, stress - np.trace(stress) / 3 * np.eye(3))
