"""Traction, pressure and springs on a neo-Hookean cube, per area at rest or per area as it is."""

from __future__ import annotations

from math import log
from typing import Any

import numpy as np
import pytest
from helpers.closed_forms import LAM, MU, NEO_HOOKEAN, neo_hookean_stress, root, uniaxial
from helpers.homogeneous import SYMMETRY, check, solve
from helpers.resultants import Loaded, bend, wave
from helpers.verification import box, job

from hpcinv.base.parallel.runtime import MPI

PULL, STIFFNESS = 3e3, 20e3  # Pa, Pa/m
CONFIGURATIONS = ("reference", "current")

both_ways = pytest.mark.parametrize("direction", ["forward", "inverse"])


def pulled(area_in: str, region: str = "x1", traction: tuple[float, ...] = (PULL, 0, 0)) -> dict[str, Any]:
    return {"effect": "traction", "region": region, "traction": list(traction), "area_in": area_in}


def springs(area_in: str, region: str = "x0", **stiffness: float) -> dict[str, Any]:
    return {"effect": "elastic-foundation", "region": region, "area_in": area_in, **stiffness}


def cauchy(F: np.ndarray) -> np.ndarray:
    stress: np.ndarray = neo_hookean_stress(F) @ F.T / np.linalg.det(F)
    return stress


def lateral(stretch: float) -> float:
    """Stretch across a bar whose sides are free: ``mu (λ_t² - 1) + lam ln(λ λ_t²) = 0``."""
    return root(lambda s: MU * (s**2 - 1) + LAM * log(stretch * s**2), 0.5, 1.5)


@pytest.mark.everyday("forward-reference", "inverse-current")
@pytest.mark.parametrize(("traction_in", "springs_in"), [("reference", "current"), ("current", "reference")])
@both_ways
def test_a_bar_pulled_against_springs(direction: str, traction_in: str, springs_in: str, comm: MPI.Intracomm) -> None:
    """Dead traction ``P = t``, spatial one ``P = t λ_t²``; springs give way by ``P/k`` or by ``P/(k λ_t²)``."""

    def nominal(stretch: float) -> float:
        return PULL * (lateral(stretch) ** 2 if traction_in == "current" else 1)

    def excess(stretch: float) -> float:
        return float(neo_hookean_stress(uniaxial(stretch, lateral(stretch)))[0, 0]) - nominal(stretch)

    stretch = root(excess, 1.0, 1.5)
    F = uniaxial(stretch, lateral(stretch))
    way = nominal(stretch) / STIFFNESS / (lateral(stretch) ** 2 if springs_in == "current" else 1)
    print(f"λ = {stretch:.6f}, springs give way by {way:.6f} m")
    effects = [pulled(traction_in), springs(springs_in, normal=STIFFNESS)]
    check(solve(direction, comm, effects=effects, supports=SYMMETRY[1:]), F, cauchy(F), (way, 0, 0))


@pytest.mark.everyday("inverse")
@both_ways
def test_a_confined_bar_pulled_against_springs(direction: str, comm: MPI.Intracomm) -> None:
    """``u = t/k`` and the stretch of the bar; springs along the surface have nothing to do."""
    stretch = root(lambda s: float(neo_hookean_stress(uniaxial(s))[0, 0]) - PULL, 1.0, 1.5)
    F = uniaxial(stretch)
    effects = [pulled("reference"), springs("reference", normal=STIFFNESS, tangential=1e6)]
    supports = [{"region": "boundary", "fix": ["y", "z"]}]
    check(solve(direction, comm, effects=effects, supports=supports), F, cauchy(F), (PULL / STIFFNESS, 0, 0))


@both_ways
def test_a_sheared_block_slides_on_springs(direction: str, comm: MPI.Intracomm) -> None:
    """``u_x = t/k + t/mu Z``; springs along the normal have nothing to do."""
    F = np.eye(3)
    F[0, 2] = PULL / MU
    effects = [pulled("reference", "z1"), springs("reference", "z0", normal=1e6, tangential=STIFFNESS)]
    if direction == "inverse":  # sides that are upright as they are bear the normal stress of simple shear
        normal = PULL**2 / MU
        effects += [pulled("current", "x0", (-normal, 0, 0)), pulled("current", "x1", (normal, 0, 0))]
    supports = [{"region": "boundary", "fix": ["y", "z"]}]
    check(solve(direction, comm, effects=effects, supports=supports), F, cauchy(F), (PULL / STIFFNESS, 0, 0))


@pytest.mark.parametrize("area_in", CONFIGURATIONS)
@both_ways
def test_springs_all_around_a_cube_pull_it_back_by_their_directions(direction: str, area_in: str) -> None:
    """Moved as it is, by ``u``: two of six unit faces have their normal along each axis."""
    u = np.array([0.1, -0.2, 0.3])
    cube = job(
        mesh=box((1, 1, 1)),
        material=NEO_HOOKEAN,
        effects=[springs(area_in, "boundary", normal=7e3, tangential=2e3)],
        supports=[],
    )
    loaded = Loaded(cube, direction, lambda points: np.broadcast_to(u, points.shape))
    np.testing.assert_allclose(loaded.force, -(2 * 7e3 + 4 * 2e3) * u, rtol=1e-12)


@pytest.mark.everyday("forward-tetrahedra", "inverse-hexahedra")
@pytest.mark.parametrize("hexahedra", [False, True], ids=["tetrahedra", "hexahedra"])
@both_ways
def test_a_pressure_all_around_has_no_resultant_and_works_against_the_volume(direction: str, hexahedra: bool) -> None:
    """``-p ∫ n·v da = -p δV`` for every ``v``: nothing for a rigid one, and ``-3 p V`` for ``v = x``."""
    pressure = 5e3
    body = job(
        mesh=box((2, 1, 1), hexahedra=hexahedra) | {"geometry_degree": 2},
        material=NEO_HOOKEAN,
        effects=[{"effect": "pressure", "region": "boundary", "pressure": pressure}],
        supports=[{"region": "z0", "fix": ["x", "y", "z"]}],
        discretisation={"quadrature": 8},
    )
    loaded = Loaded(body, direction, wave, bend)
    unloaded = Loaded(body.model_copy(update={"effects": ()}), direction, wave, bend)
    np.testing.assert_allclose(loaded.force, 0, atol=1e-12 * pressure)
    np.testing.assert_allclose(loaded.torque(), 0, atol=1e-12 * pressure)
    volume, _ = loaded.volume()
    assert loaded.swelling - unloaded.swelling == pytest.approx(-3 * pressure * volume, rel=1e-12)
