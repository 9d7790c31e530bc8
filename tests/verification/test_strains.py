"""Heat, growth and contraction of a neo-Hookean cube: free, where nothing resists, and confined, where all does.

An inelastic stretch ``F_g`` leaves ``F_e = F F_g⁻¹`` to the law, ``ψ = J_g ψ_e(F_e)``, so that ``P = J_g P_e F_g⁻ᵀ``.
"""

from __future__ import annotations

from math import log
from typing import Any

import numpy as np
import pytest
from helpers.closed_forms import LAM, MU, NEO_HOOKEAN, root
from helpers.homogeneous import check, solve
from helpers.verification import box

from hpcinv.base.parallel.runtime import MPI

HEAT = {"effect": "thermal-expansion", "coefficient": "3e-3 1/K", "temperature_change": "60 K"}
HOT = 1.18
GROWTH = {"effect": "growth", "fibre": "muscle", "along": 1.3, "across": 0.9}
ACTIVE = {"effect": "active-stress", "fibre": "muscle", "stress": "4 kPa"}
NOTHING = np.zeros((3, 3))
HELD = [{"region": "boundary", "fix": ["x", "y", "z"]}]

both_ways = pytest.mark.parametrize("direction", ["forward", "inverse"])


def along(*direction: float, given_on: str = "reference") -> dict[str, Any]:
    """The family of fibres 'muscle'."""
    return {"muscle": {"direction": list(direction), "given_on": given_on}}


@pytest.mark.everyday("inverse")
@both_ways
def test_a_free_cube_expands_without_stress(direction: str, comm: MPI.Intracomm) -> None:
    check(solve(direction, comm, effects=[HEAT]), HOT * np.eye(3), NOTHING)


@pytest.mark.release
@both_ways
def test_an_incompressible_cube_expands_too(direction: str, comm: MPI.Intracomm) -> None:
    material = NEO_HOOKEAN | {"lam": "incompressible"}
    solved = solve(direction, comm, effects=[HEAT], material=material, discretisation={}, mesh=box((1, 1, 1)))
    check(solved, HOT * np.eye(3), NOTHING)


@pytest.mark.everyday("forward")
@both_ways
def test_a_confined_cube_is_under_pressure_from_heat(direction: str, comm: MPI.Intracomm) -> None:
    pressure = MU * (HOT**3 - HOT) + 3 * LAM * HOT**3 * log(HOT)
    check(solve(direction, comm, effects=[HEAT], supports=HELD), np.eye(3), -pressure * np.eye(3))


@pytest.mark.everyday("inverse")
@both_ways
def test_heat_and_growth_together_multiply(direction: str, comm: MPI.Intracomm) -> None:
    solved = solve(direction, comm, effects=[HEAT, {"effect": "growth", "stretch": 0.9}])
    check(solved, HOT * 0.9 * np.eye(3), NOTHING)


@pytest.mark.everyday("forward")
@both_ways
def test_a_free_cube_grows_along_its_fibres(direction: str, comm: MPI.Intracomm) -> None:
    solved = solve(direction, comm, effects=[GROWTH], fibres=along(2, 0, 0))
    check(solved, np.diag([1.3, 0.9, 0.9]), NOTHING)


@pytest.mark.everyday("inverse-current")
@pytest.mark.parametrize("given_on", ["reference", "current"])
@both_ways
def test_oblique_fibres_grow_without_stress_if_the_boundary_follows(
    direction: str, given_on: str, comm: MPI.Intracomm
) -> None:
    a = np.array([2, -1, 2]) / 3
    F = 0.9 * np.eye(3) + 0.4 * np.outer(a, a)
    H = F - np.eye(3) if direction == "forward" else np.eye(3) - np.linalg.inv(F)
    formulas = [" + ".join(f"({h!r})*{axis}" for h, axis in zip(row, "xyz", strict=True)) for row in H.tolist()]
    supports = [{"region": "boundary", "displacement": formulas}]
    fibres = along(2, -1, 2, given_on=given_on)
    check(solve(direction, comm, effects=[GROWTH], fibres=fibres, supports=supports), F, NOTHING)


@pytest.mark.everyday("inverse")
@both_ways
def test_a_confined_cube_is_strained_by_growth(direction: str, comm: MPI.Intracomm) -> None:
    """``σ_i = J_g (mu (1/g_i² - 1) - lam ln J_g)``."""
    g = np.array([0.9, 1.3, 0.9])
    stress = g.prod() * (MU * (g**-2 - 1) - LAM * log(g.prod()))
    solved = solve(direction, comm, effects=[GROWTH], fibres=along(0, 1, 0), supports=HELD)
    check(solved, np.eye(3), np.diag(stress))


@pytest.mark.everyday("forward")
@both_ways
def test_a_free_muscle_contracts_until_it_strains_itself_as_much(direction: str, comm: MPI.Intracomm) -> None:
    """``P_11 + T λ = P_22 = 0``: so ``(mu + T) λ² = mu λ_t²``, and ``mu (λ_t² - 1) + lam ln(λ λ_t²) = 0``."""
    ratio = np.sqrt(1 + 4e3 / MU)
    stretch = root(lambda s: MU * ((ratio * s) ** 2 - 1) + LAM * log(ratio**2 * s**3), 0.5, 1.0)
    lateral = ratio * stretch
    solved = solve(direction, comm, effects=[ACTIVE], fibres=along(0, 0, 5))
    print(f"λ = {stretch:.6f}, λ_t = {lateral:.6f}")
    check(solved, np.diag([lateral, lateral, stretch]), NOTHING)


@pytest.mark.everyday("inverse")
@both_ways
def test_a_muscle_held_at_rest_pulls_with_its_active_stress(direction: str, comm: MPI.Intracomm) -> None:
    a = np.array([2, -1, 2]) / 3
    solved = solve(direction, comm, effects=[ACTIVE], fibres=along(2, -1, 2), supports=HELD)
    check(solved, np.eye(3), 4e3 * np.outer(a, a))
