"""The pressure of a fluid: Archimedes' principle, a wall that is wet to the half, a column under a fluid."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.closed_forms import NEO_HOOKEAN, neo_hookean_stress, root, uniaxial
from helpers.resultants import Loaded, bend, wave
from helpers.verification import Solved, box, digits, job

from hpcinv.base.parallel.runtime import MPI

DENSITY = 1000.0
FACES = ("x0", "x1", "y0", "y1", "z0", "z1")


def fluid(*regions: str, level: list[float], acceleration: tuple[float, ...] = (0, 0, -9.81)) -> list[dict[str, Any]]:
    common = {"density": DENSITY, "acceleration": list(acceleration), "level": level}
    return [{"effect": "hydrostatic-pressure", "region": region, **common} for region in regions]


@pytest.mark.everyday("forward-tetrahedra", "inverse-hexahedra")
@pytest.mark.parametrize("hexahedra", [False, True], ids=["tetrahedra", "hexahedra"])
@pytest.mark.parametrize(
    ("direction", "regions"), [("forward", FACES), ("inverse", ("boundary",))], ids=["forward", "inverse"]
)
def test_a_sunk_body_is_lifted_by_the_weight_of_the_fluid_that_it_displaces(
    direction: str, regions: tuple[str, ...], hexahedra: bool
) -> None:
    """Whatever its shape: a curved body, displaced by anything; the quadrature is exact for it."""
    g = np.array([2.0, -3.0, -9.0])
    sunk = job(
        mesh=box((2, 1, 1), hexahedra=hexahedra) | {"geometry_degree": 2},
        material=NEO_HOOKEAN,
        effects=fluid(*regions, level=[0, 0, 5], acceleration=(2.0, -3.0, -9.0)),
        supports=[{"region": "z0", "fix": ["x", "y", "z"]}],
        discretisation={"quadrature": 8},
    )
    loaded = Loaded(sunk, direction, wave, bend)
    volume, moment = loaded.volume()
    force, torque = -DENSITY * volume * g, -DENSITY * np.cross(moment, g)
    errors = [
        float(np.linalg.norm(resultant - exact) / np.linalg.norm(exact))
        for resultant, exact in ((loaded.force, force), (loaded.torque(), torque))
    ]
    print(f"{direction}, {'hexahedra' if hexahedra else 'tetrahedra'}: errors of force and torque {digits(errors)}")
    assert max(errors) < 1e-12


@pytest.mark.parametrize("direction", ["forward", "inverse"])
def test_a_half_wet_wall_carries_a_triangle_of_pressure(direction: str) -> None:
    """Force ``rho g h²/2`` per width, ``h/3`` above the ground: nothing pulls above the level."""
    dam = job(
        mesh=box((1, 1, 2)),
        material=NEO_HOOKEAN,
        effects=fluid("x0", level=[7, 8, 0.5]),
        supports=[{"region": "z0", "fix": ["x", "y", "z"]}],
    )
    loaded = Loaded(dam, direction, np.zeros_like)
    force = DENSITY * 9.81 * 0.5**2 / 2
    np.testing.assert_allclose(loaded.force, [force, 0, 0], atol=1e-12 * force)
    np.testing.assert_allclose(loaded.torque((0, 0.5, 0.5 / 3)), 0, atol=1e-12 * force)


@pytest.mark.everyday("forward-hexahedra", "inverse-tetrahedra")
@pytest.mark.parametrize("hexahedra", [False, True], ids=["tetrahedra", "hexahedra"])
@pytest.mark.parametrize("direction", ["forward", "inverse"])
def test_a_level_inside_cells_is_integrated(direction: str, hexahedra: bool) -> None:
    """The pressure has a kink there, which the quadrature of the laws misses by up to 1e-3 of the force."""
    height = 0.55
    dam = job(
        mesh=box((6, 1, 6), hexahedra=hexahedra),
        material=NEO_HOOKEAN,
        effects=fluid("x0", level=[7, 8, height]),
        supports=[{"region": "z0", "fix": ["x", "y", "z"]}],
    )
    loaded = Loaded(dam, direction, np.zeros_like)
    force = DENSITY * 9.81 * height**2 / 2
    error = abs(loaded.force[0] / force - 1)
    print(f"{direction}, {'hexahedra' if hexahedra else 'tetrahedra'}: error of the force {error:.1e}")
    assert error < 6e-5
    np.testing.assert_allclose(loaded.torque((0, 0.5, height / 3)), 0, atol=3e-5 * force)


@pytest.mark.parametrize("direction", ["forward", "inverse"])
def test_a_column_sinks_under_a_fluid_whose_level_stays(direction: str, comm: MPI.Intracomm) -> None:
    """Confined, and 1 m high as it is given: ``P(λ) = -rho g (h - λ L)`` at its top, which is deeper then."""
    level, weight = 2.0, DENSITY * 9.81

    def excess(stretch: float) -> float:
        top = stretch if direction == "forward" else 1.0
        return float(neo_hookean_stress(uniaxial(stretch))[0, 0]) + weight * (level - top)

    stretch = root(excess, 0.5, 1.0)
    exact = stretch - 1 if direction == "forward" else 1 - 1 / stretch
    solved = Solved(
        job(
            analysis=direction,
            mesh=box((1, 1, 2)),
            material=NEO_HOOKEAN,
            effects=fluid("z1", level=[0, 0, level]),
            supports=[{"region": "boundary", "fix": ["x", "y"]}, {"region": "z0", "fix": ["z"]}],
            discretisation={"displacement": 1},
        ),
        comm,
    )
    sinking = solved.model.unknowns.displacement().x.array.min() * solved.body.length_scale
    print(f"{direction}: sinks by {-sinking:.7f} m, error {sinking / exact - 1:.1e}")
    assert sinking == pytest.approx(exact, rel=1e-12)
