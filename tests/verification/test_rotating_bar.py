"""A bar along x that rotates about z, held on the axis and kept from moving sideways: one-dimensional.

With ``P = dW/dλ``, ``λ = dx/dX``, and the end ``x = l`` free, balance of forces on the body at rest and on the rotating
one, for a density ``rho`` per reference or per current volume, reads

    dP/dX = -rho ω² x      or      dP/dx = -rho ω² x.

It is integrated here by Runge and Kutta's method, and checked by its first integral, which for a density per reference
volume is ``λ P - W + rho ω² x²/2``, and ``P + rho ω² x²/2`` for one per current volume.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.closed_forms import LAM, MU, NEO_HOOKEAN
from helpers.resultants import Loaded
from helpers.rotating_bar import DENSITY, LENGTH, SPIN, lengthening, rest_length
from helpers.verification import HERE, box, digits, job

import hpcinv
from hpcinv.base.parallel.runtime import MPI

DIRECTIONS = ("forward", "inverse")


def rotated(direction: str, divisions: int, comm: MPI.Intracomm, *, hexahedra: bool = True, **load: Any) -> Any:
    """Displacements in the middle and at the end of a bar that is 1 m long as it is given, by the solver.

    The axis goes along the middle of the bar. There the forces along y pull no node of one layer of hexahedra; in
    tetrahedra they do, but hardly in a thin bar.
    """
    width = 0.1 if hexahedra else 0.01
    result = hpcinv.run(
        job(
            analysis=direction,
            mesh=box((divisions, 1, 1), lx=LENGTH, ly=width, lz=width, hexahedra=hexahedra),
            material=NEO_HOOKEAN,
            effects=[
                {
                    "effect": "centrifugal",
                    "angular_velocity": SPIN,
                    "axis": [0, 0, 2],
                    "centre": [0, width / 2, 7],
                    "density": DENSITY,
                }
                | load
            ],
            supports=[{"region": "boundary", "fix": ["y", "z"]}, {"region": "x0", "fix": ["x"]}],
            quantities=[
                {"name": "middle", "of": "ux", "at": [LENGTH / 2, 0, 0]},
                {"name": "end", "of": "ux", "on": "x1", "reduce": "mean"},
            ],
        ),
        comm,
    )
    return result.quantities


@pytest.mark.everyday("inverse-reference", "forward-current")
@pytest.mark.parametrize("density_in", ["reference", "current"])
@pytest.mark.parametrize("direction", DIRECTIONS)
def test_lengthening_converges_with_order_four(direction: str, density_in: str, comm: MPI.Intracomm) -> None:
    exact = lengthening(direction, density_in)
    errors = [rotated(direction, n, comm, density_in=density_in)["end"] / exact - 1 for n in (8, 16)]
    orders = np.log2(np.abs(errors[:-1]) / np.abs(errors[1:]))
    title = f"{direction}, density per {density_in} volume"
    print(f"{title}: {exact:.7f} m, errors {digits(errors)}, orders {orders.round(2)}")
    assert orders.min() > 3.9
    assert abs(errors[-1]) < 1.6e-7


@pytest.mark.release
def test_the_job_that_comes_with_the_project(comm: MPI.Intracomm) -> None:
    quantities = hpcinv.run(hpcinv.load(HERE.parents[1] / "jobs" / "rotating-bar.yaml"), comm).quantities
    assert quantities["length-at-rest"] == pytest.approx(rest_length(LENGTH, "reference"), abs=1e-8)


@pytest.mark.everyday("inverse")
@pytest.mark.parametrize("direction", DIRECTIONS)
def test_a_thin_bar_of_tetrahedra(direction: str, comm: MPI.Intracomm) -> None:
    error = rotated(direction, 32, comm, hexahedra=False)["end"] / lengthening(direction, "reference") - 1
    print(f"{direction}, tetrahedra: error {error:.1e}")
    assert abs(error) < 1e-6


@pytest.mark.everyday("forward")
@pytest.mark.parametrize("direction", DIRECTIONS)
def test_a_slow_bar_agrees_with_linear_elasticity(direction: str, comm: MPI.Intracomm) -> None:
    """``u = rho ω²/M (L² X/2 - X³/6)``, ``M = lam + 2 mu``, which quadratic elements have exactly at their ends."""
    spin, M = 1e-6, LAM + 2 * MU

    def linear(X: float) -> float:
        return DENSITY * spin**2 / M * (LENGTH**2 * X / 2 - X**3 / 6)

    result = rotated(direction, 4, comm, angular_velocity=spin)
    errors = [result["middle"] / linear(LENGTH / 2) - 1, result["end"] / linear(LENGTH) - 1]
    print(f"{direction}, 1e-6 rad/s: errors {digits(errors)}")
    assert np.abs(errors).max() < 1e-12


@pytest.mark.parametrize("density_in", ["reference", "current"])
@pytest.mark.parametrize("direction", DIRECTIONS)
def test_force_about_an_oblique_axis_is_that_on_the_whole_mass_in_its_centre(direction: str, density_in: str) -> None:
    """Of a unit cube, deformed by ``x = F X`` or from that shape."""
    axis, centre, H = np.array([1.0, 2, -2]), np.array([0.3, -1, 2]), np.diag([0.2, -0.1, 0.3])
    load = {"effect": "centrifugal", "angular_velocity": SPIN, "axis": axis.tolist(), "centre": centre.tolist()}
    cube = job(
        mesh=box((1, 1, 1)),
        material=NEO_HOOKEAN,
        effects=[load | {"density": DENSITY, "density_in": density_in}],
        supports=[{"region": "z0", "fix": ["x", "y", "z"]}],
    )
    F = np.eye(3) + H
    J, given = np.linalg.det(F), np.full(3, 0.5)
    if direction == "forward":
        loaded = Loaded(cube, direction, lambda X: X @ H)
        mass_centre, volumes = F @ given, {"reference": 1, "current": J}
    else:
        loaded = Loaded(cube, direction, lambda x: x - x @ np.linalg.inv(F))
        mass_centre, volumes = given, {"reference": 1 / J, "current": 1}
    unit = axis / np.linalg.norm(axis)
    arm = mass_centre - centre
    force = DENSITY * volumes[density_in] * SPIN**2 * (arm - (arm @ unit) * unit)
    np.testing.assert_allclose(loaded.force, force, rtol=0, atol=1e-13 * np.linalg.norm(force))
