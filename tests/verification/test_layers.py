"""Layers of different laws, parameters or inelastic stretch, incompressible: the pressure jumps from one to the next.

An incompressible sphere of layers keeps its volume, ``r³ = R³ + a³ - A³``, and the radial stress is continuous, so that
the pressure inside is an integral over the wall, to be solved for the radius ``A`` at rest. With growth and thermal
expansion each layer's volume changes by its own factor.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
import ufl
from helpers.closed_forms import root
from helpers.verification import Solved, digits, job

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.output.result import Result

INNER, MIDDLE, OUTER, PRESSURE = 0.5, 0.75, 1.0, 20e3
MU = {"core": 100e3, "elsewhere": 10e3}
A, B = 0.4636286601, 0.9914801828  # of these layers
ESTIMATE = {"round_trip": "off", "stability": False, "overlap": False, "estimate": True}
NONE = {"core": 1.0, "elsewhere": 1.0}
CELLS = pytest.mark.parametrize("hexahedra", [True, False], ids=["hexahedra", "tetrahedra"])
POINTS, WEIGHTS = np.polynomial.legendre.leggauss(40)


def law(mu: float) -> dict[str, Any]:
    return {"law": "isochoric-neo-hookean", "mu": mu, "kappa": "incompressible"}


def wall(divisions: int, *, hexahedra: bool, geometry: int = 2, **changes: Any) -> Any:
    """An octant of the sphere, whose divisions meet at the interface."""
    size = {"inner": INNER, "outer": OUTER, "radial": divisions, "along": divisions, "hexahedra": hexahedra}
    data: dict[str, Any] = {
        "mesh": {"file": "../meshes/thick_sphere.py", "parameters": size, "geometry_degree": geometry},
        "regions": {"core": f"norm(x, y, z) < {MIDDLE + 1e-4}"},
        "material": {region: law(of_region) for region, of_region in MU.items()},
        "effects": [{"effect": "pressure", "region": "inner", "pressure": PRESSURE}],
        "supports": [{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"],
        "quantities": [
            {"name": name, "of": "norm(X, Y, Z)", "on": on, "reduce": "mean"}
            for name, on in (("A", "inner"), ("B", "outer"))
        ],
        "certificate": ESTIMATE,
    }
    return job(**data | changes)


def radii(
    stretch: Mapping[str, float] = NONE, mu: Mapping[str, float] = MU, *, direction: str = "inverse"
) -> dict[str, float]:
    """Radii of the other body, of layers with isotropic stress-free stretches ``g``, by quadrature of the stress.

    A layer has ``r³ = r₀³ + g³ (R³ - R₀³)``, the elastic hoop stretch ``λ = r/(g R)`` and the stress
    ``dσ_r/dr = 2 (σ_t - σ_r)/r``, with ``σ_t - σ_r = μ (λ² - λ⁻⁴)``; σ_r rises by the pressure from inside to outside.
    """
    layers = [(INNER, MIDDLE, "core"), (MIDDLE, OUTER, "elsewhere")]

    def carried(other: float) -> tuple[float, float]:
        total = 0.0
        for low, high, region in layers:
            g = stretch[region]
            given = low + (high - low) * (1 + POINTS) / 2
            if direction == "inverse":
                r, R = given, np.cbrt(other**3 + (given**3 - low**3) / g**3)
                slope, end = 1.0, np.cbrt(other**3 + (high**3 - low**3) / g**3)
            else:
                R, r = given, np.cbrt(other**3 + (given**3 - low**3) * g**3)
                slope, end = g**3 * R**2 / r**2, np.cbrt(other**3 + (high**3 - low**3) * g**3)
            hoop = r / (g * R)
            total += float(WEIGHTS @ (2 * mu[region] * (hoop**2 - hoop**-4) / r * slope)) * (high - low) / 2
            other = float(end)
        return total, other

    inner = root(lambda other: PRESSURE - carried(other)[0], 0.3, 0.9)
    return {"A": inner, "B": carried(inner)[1]}


def effectivity(result: Result, exact: Mapping[str, float]) -> tuple[float, float]:
    """The larger error of the two radii, and the estimated one over it."""
    assert result.estimate is not None
    error, name = max((abs(exact[name] - result.quantities[name]), name) for name in exact)
    estimated = result.estimate.quantities[name]
    assert isinstance(estimated, float)
    return error, estimated / (exact[name] - result.quantities[name])


def test_the_closed_form_has_published_radii() -> None:
    closed_radii = radii()
    assert [closed_radii["A"], closed_radii["B"]] == pytest.approx([A, B], abs=1e-10)


@pytest.mark.everyday("hexahedra")
@CELLS
def test_layers_converge_as_one_material_and_the_estimate_shows_their_error(
    hexahedra: bool, comm: MPI.Intracomm
) -> None:
    """One material has the orders 3.2 and 2.6 (`test_thick_sphere`); a continuous pressure has 1."""
    ratios = [effectivity(hpcinv.run(wall(n, hexahedra=hexahedra), comm), {"A": A, "B": B}) for n in (2, 4)]
    order = np.log2(ratios[0][0] / ratios[1][0])
    print(f"errors and effectivities {digits(ratios)}, order {order:.2f}")
    assert order > (3.2 if hexahedra else 2.6)
    assert all(0.5 < ratio < 2 for _, ratio in ratios)


@pytest.mark.everyday("hexahedra")
@CELLS
def test_forward_radii_of_layers_and_their_estimated_error(hexahedra: bool, comm: MPI.Intracomm) -> None:
    data = wall(
        2,
        hexahedra=hexahedra,
        analysis="forward",
        quantities=[
            {"name": name, "of": "norm(x, y, z)", "on": on, "reduce": "mean"}
            for name, on in (("A", "inner"), ("B", "outer"))
        ],
    )
    error, ratio = effectivity(hpcinv.run(data, comm), radii(direction="forward"))
    print(f"error {error:.1e}, effectivity {ratio:.2f}")
    assert error < 2e-4
    assert 0.5 < ratio < 2


GROWN = {"core": 1.06, "elsewhere": 0.97}


@pytest.mark.everyday("prestrain")
@pytest.mark.parametrize(
    "effect",
    [
        {"effect": "growth", "stretch": GROWN},
        {"effect": "thermal-expansion", "coefficient": 1e-3, "temperature_change": {"core": 60, "elsewhere": -30}},
        {
            "effect": "prestrain",
            "given_on": "reference",
            "tensor": {region: [g, g, g] for region, g in GROWN.items()},
        },
    ],
    ids=lambda effect: effect["effect"],
)
def test_layers_of_one_material_that_grow_differently(effect: dict[str, Any], comm: MPI.Intracomm) -> None:
    mu = dict.fromkeys(MU, 50e3)
    pressure = {"effect": "pressure", "region": "inner", "pressure": PRESSURE}
    data = wall(2, hexahedra=True, material=law(50e3), effects=[pressure, effect])
    error, ratio = effectivity(hpcinv.run(data, comm), radii(GROWN, mu))
    print(f"error {error:.1e}, effectivity {ratio:.2f}")
    assert error < 2e-4
    assert 0.5 < ratio < 2


@pytest.mark.everyday("tetrahedra")
@pytest.mark.parallel(2)
@CELLS
def test_ranks_agree_and_the_return_solve_closes(hexahedra: bool, comm: MPI.Intracomm) -> None:
    """Also for pressures that another rank owns, since only that has cells of the layer there."""
    pressures: list[list[float]] = []
    for some in (comm, MPI.COMM_SELF):
        solved = Solved(wall(2, hexahedra=hexahedra, analysis="round_trip"), some)
        unknowns = solved.model.unknowns
        u, p = unknowns.geometry_values(unknowns.displacement()), unknowns.pressure()
        assert p is not None
        owned = p.x.array[: p.function_space.dofmap.index_map.size_local]
        sums = [float(np.sum(values**power)) for values in (owned,) for power in (1, 2)]
        norms = [solved.integral(ufl.inner(unknowns.u, unknowns.u)), solved.integral(unknowns.p**2)]
        size = some.allreduce(float(np.abs(u).max()), op=MPI.MAX)
        back = some.allreduce(float(np.abs(solved.again() - u).max()), op=MPI.MAX) / size
        assert back < 1e-9
        pressures.append([unknowns.pressure_size, *norms, *(some.allreduce(entry, op=MPI.SUM) for entry in sums)])
    print(f"{pressures[0][0]} pressures, among them {'; '.join(digits(entry, '.16g') for entry in pressures)}")
    assert pressures[0] == pytest.approx(pressures[1], rel=1e-9)


@pytest.mark.release
@pytest.mark.parametrize("mu", [MU, dict.fromkeys(MU, 50e3)], ids=["different", "the same"])
def test_slopes_by_the_modulus_of_a_layer(mu: Mapping[str, float], comm: MPI.Intracomm) -> None:
    """Also where layers are the same now: then the derivative of the pressure jumps, and not the pressure."""
    material = {region: law(of_region) for region, of_region in mu.items()}
    result = hpcinv.run(
        wall(2, hexahedra=True, material=material, sensitivities=[f"material.{region}.mu" for region in mu]), comm
    )
    assert result.sensitivities is not None
    for region, of_region in mu.items():
        step = 1e-3 * of_region
        ahead, other = (radii(mu={**mu, region: of_region + change})["A"] for change in (step, -step))
        slope, exact = result.sensitivities.slopes["A"][f"material.{region}.mu"], (ahead - other) / (2 * step)
        print(f"{region}: slope {slope:.5g}, exact {exact:.5g}")
        assert slope == pytest.approx(exact, rel=1e-2)
