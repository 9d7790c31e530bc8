"""A thick tube with a pressure inside, incompressible and in plane strain: how wide was it before?

Neo-Hookean: ``b² - B² = a² - A²``, and with ``λ = r/R``

    p = μ (ln(λ_a/λ_b) + ½ (1/λ_b² - 1/λ_a²)).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.thick_cylinder import INNER, OUTER, PRESSURE, A, B
from helpers.verification import digits, job

import hpcinv
from hpcinv.base.parallel.runtime import MPI


def radii(direction: str, divisions: int, hexahedra: bool, comm: MPI.Intracomm) -> list[float]:
    """Radii of the tube that is looked for, from the exact ones of the other."""
    inner, outer = (A, B) if direction == "forward" else (INNER, OUTER)
    mesh = {"radial": divisions, "around": 2 * divisions, "along": 1, "length": 0.5 / divisions, "hexahedra": hexahedra}
    radius = "norm(x, y)" if direction == "forward" else "norm(X, Y)"
    quantities: dict[str, Any] = dict(
        hpcinv.run(
            job(
                analysis=direction,
                mesh={
                    "file": "../meshes/thick_cylinder.py",
                    "parameters": {"inner": inner, "outer": outer, **mesh},
                    "geometry_degree": 2,
                },
                material={"law": "neo-hookean", "mu": 1.0, "lam": "incompressible"},
                effects=[{"effect": "pressure", "region": "inner", "pressure": PRESSURE}],
                supports=[
                    {"region": "x0", "fix": ["x"]},
                    {"region": "y0", "fix": ["y"]},
                    {"region": "z0", "fix": ["z"]},
                    {"region": "z1", "fix": ["z"]},
                ],
                quantities=[{"name": name, "of": radius, "on": name, "reduce": "mean"} for name in ("inner", "outer")],
            ),
            comm,
        ).quantities
    )
    return [quantities["inner"], quantities["outer"]]


def test_the_closed_form_has_published_radii() -> None:
    assert [round(A, 7), round(B, 7)] == [0.8286610, 1.3916461]


@pytest.mark.everyday("False-2.6-4e-06-8-inverse")
@pytest.mark.parametrize("direction", ["inverse", "forward"])
@pytest.mark.parametrize(("hexahedra", "order", "best", "finest"), [(True, 3.2, 1e-7, 16), (False, 2.6, 4e-6, 8)])
def test_radii_converge(
    hexahedra: bool, order: float, best: float, finest: int, direction: str, comm: MPI.Intracomm
) -> None:
    exact = [A, B] if direction == "inverse" else [INNER, OUTER]
    errors = np.abs(np.array([radii(direction, n, hexahedra, comm) for n in (4, 8, 16) if n <= finest]) / exact - 1)
    largest = errors.max(axis=1)
    orders = np.log2(largest[:-1] / largest[1:])
    cells = "hexahedra" if hexahedra else "tetrahedra"
    print(f"{direction}, {cells}: errors {digits(errors)}, orders of the larger {orders.round(2).tolist()}")
    assert orders.min() > order
    assert largest[-1] < best
