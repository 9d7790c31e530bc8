"""Generalised shear u = (k y², 0, 0) on the whole boundary, without body force.

It is in equilibrium if the material keeps its volume: with F01 = 2 k y the deviatoric stresses s(y) of simple shear by
2 k y are balanced by the pressure p = 4 k (C1 + C2) x + s11(y) + const, with x in the current body.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import ufl
from helpers.verification import Solved, box, digits, job

from hpcinv.base.parallel.runtime import MPI

C1, C2, K = 1.0e5, 1.5e5, 0.3


def stress_errors(direction: str, n: int, hexahedra: bool, comm: MPI.Intracomm) -> tuple[float, float]:
    """Relative L² errors of the pointwise stress, and of its deviator."""
    solved = Solved(
        job(
            analysis=direction,
            mesh=box((n, n, n), hexahedra=hexahedra),
            material={"law": "mooney-rivlin", "c1": C1, "c2": C2, "d1": 1e8 * (C1 + C2)},
            supports=[{"region": "boundary", "displacement": ["k*y*y", "0", "0"], "constants": {"k": f"{K} m^-1"}}],
        ),
        comm,
    )
    x, y, _ = solved.x
    g = 2 * K * y
    s = [g**2 * (2 * C2 + 4 * C1) / 3, -(g**2) * (4 * C2 + 2 * C1) / 3, g**2 * (2 * C2 - 2 * C1) / 3]
    x_current = x + K * y**2 if direction == "forward" else x
    p = 4 * K * (C1 + C2) * x_current + s[1]
    t = g * 2 * (C1 + C2)
    exact = ufl.as_tensor([[s[0] - p, t, 0], [t, s[1] - p, 0], [0, 0, s[2] - p]])
    stress_values = solved.cauchy_stress
    # The pressure is known up to a constant, which the nearly incompressible material chooses.
    volume = solved.integral(1 + 0 * x)
    shift = solved.integral(ufl.tr(stress_values - exact)) / 3 / volume
    assert solved.strain_energy == pytest.approx(4 * K**2 * (C1 + C2) / 3, rel=1e-3)
    whole = solved.relative_error(stress_values - solved.constant(shift) * ufl.Identity(3), exact)
    return whole, solved.relative_error(ufl.dev(stress_values), ufl.dev(exact))


def orders(errors: list[float]) -> list[float]:
    """Order of convergence from each mesh to the next, twice as fine."""
    return [float(np.log2(coarse / fine)) for coarse, fine in itertools.pairwise(errors)]


@pytest.mark.release
@pytest.mark.parametrize("direction", [pytest.param("forward", marks=pytest.mark.release), "inverse"])
def test_stress_converges_with_order_two_on_hexahedra(direction: str, comm: MPI.Intracomm) -> None:
    errors = [stress_errors(direction, n, True, comm)[0] for n in (1, 2, 4)]
    print(f"{direction}, hexahedra: errors {digits(errors)}, orders {digits(orders(errors), '.2f')}")
    assert orders(errors)[-1] > 1.95
    assert errors[-1] < 3e-3


@pytest.mark.release
@pytest.mark.parametrize("direction", ["forward", pytest.param("inverse", marks=pytest.mark.release)])
def test_stress_converges_on_tetrahedra(direction: str, comm: MPI.Intracomm) -> None:
    """The pressure loses half an order: in corners of this regular mesh, cells have all vertices on the boundary."""
    errors = [stress_errors(direction, n, False, comm) for n in (2, 4, 8)]
    whole, deviator = zip(*errors, strict=True)
    by_part = digits([orders(list(whole)), orders(list(deviator))], ".2f")
    print(f"{direction}, tetrahedra: errors {digits(errors)}, orders {by_part}")
    assert orders(list(whole))[-1] > 1.4
    assert orders(list(deviator))[-1] > 2
