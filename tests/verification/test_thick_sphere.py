"""A thick sphere with a pressure inside, incompressible: how large was it before?

The volume is kept, ``b³ - B³ = a³ - A³``, and the pressure is what the stresses of the wall carry: with ``λ = r/R``,

    p = g(λ_b) - g(λ_a),      g(λ) = c1 (4/λ + 1/λ⁴) + c2 (2/λ² - 4λ)      (Mooney–Rivlin).

A neo-Hookean wall carries the more, the smaller its cavity was, but never more than as ``A → 0``: 2.0919 Pa here.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.closed_forms import root
from helpers.thick_sphere import INNER, OUTER, PRESSURE, carried, outer_radius
from helpers.verification import HERE, digits, job

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import SolveError
from hpcinv.output.result import Result


def recovered(pressure: float, c2: float, comm: MPI.Intracomm, mesh: dict[str, Any], **solver: Any) -> Result:
    """The octant at rest, its shear modulus 1 Pa."""
    return hpcinv.run(
        job(
            mesh={
                "file": "../meshes/thick_sphere.py",
                "parameters": {"inner": INNER, "outer": OUTER, **mesh},
                "geometry_degree": 2,
            },
            material={"law": "mooney-rivlin", "c1": 0.5 - c2, "c2": c2, "d1": "incompressible"},
            effects=[{"effect": "pressure", "region": "inner", "pressure": pressure}],
            supports=[{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"],
            solver=solver,
            quantities=[
                {"name": name, "of": "norm(X, Y, Z)", "on": name, "reduce": "mean"} for name in ("inner", "outer")
            ],
        ),
        comm,
    )


def errors(c2: float, divisions: int, hexahedra: bool, comm: MPI.Intracomm) -> list[float]:
    """Relative errors of the inner and the outer radius."""
    mesh = {"radial": divisions, "along": divisions, "hexahedra": hexahedra}
    A = root(lambda A: carried(A, 0.5 - c2, c2) - PRESSURE, 0.5, 1.0)
    quantities = recovered(PRESSURE, c2, comm, mesh).quantities
    return [quantities["inner"] / A - 1, quantities["outer"] / outer_radius(A) - 1]


def test_the_closed_form_has_published_radii() -> None:
    A = root(lambda A: carried(A, 0.5, 0.0) - PRESSURE, 0.5, 1.0)
    assert [round(A, 7), round(outer_radius(A), 7)] == [0.9254360, 1.4686181]


@pytest.mark.everyday("False")
@pytest.mark.parametrize(("hexahedra", "order", "best", "finest"), [(True, 3.2, 6e-7, 6), (False, 2.6, 6e-5, 4)])
def test_radii_converge(hexahedra: bool, order: float, best: float, finest: int, comm: MPI.Intracomm) -> None:
    divisions = np.array([2, 4, 6])
    divisions = divisions[divisions <= finest]
    magnitudes = np.abs([errors(0.0, n, hexahedra, comm) for n in divisions.tolist()])
    largest = magnitudes.max(axis=1)
    orders = np.log(largest[:-1] / largest[1:]) / np.log(divisions[1:] / divisions[:-1])
    cells = "hexahedra" if hexahedra else "tetrahedra"
    print(f"{cells}: errors {digits(magnitudes)}, orders of the larger {orders.round(2).tolist()}")
    assert orders.min() > order
    assert largest[-1] < best


@pytest.mark.release
def test_a_mooney_rivlin_wall(comm: MPI.Intracomm) -> None:
    quantities = errors(0.1, 4, True, comm)
    print(f"c2 = 0.1 Pa: errors {digits(quantities)}")
    assert np.abs(quantities).max() < 3e-6


@pytest.mark.release
def test_the_job_that_comes_with_the_project(comm: MPI.Intracomm) -> None:
    quantities = hpcinv.run(hpcinv.load(HERE.parents[1] / "jobs" / "thick-sphere.yaml"), comm).quantities
    assert quantities["inner-radius"] == pytest.approx(0.9254360, abs=3e-6)
    assert quantities["outer-radius"] == pytest.approx(1.4686181, abs=3e-6)


@pytest.mark.everyday("default")
@pytest.mark.parametrize("solver", [{}, {"initial_step": 0.1}], ids=["default", "small steps"])
def test_a_pressure_that_no_wall_carries_ends_with_a_diagnosis(solver: dict[str, float], comm: MPI.Intracomm) -> None:
    """A large step can lead to a wall that went through the centre, inside out, with det F > 0: it must not count."""
    limit = carried(1e-12, 0.5, 0.0) / 2.5
    with pytest.raises(SolveError, match="stopped at load factor") as caught:
        recovered(2.5, 0.0, comm, {"radial": 2, "along": 2, "hexahedra": True}, **solver)
    print(f"limit at load factor {limit:.4f}: {caught.value}")
    reached = float(str(caught.value).split("load factor ")[1].split(" of")[0])
    assert 0.75 * limit < reached < limit  # where the inner radius vanishes, two cells no longer keep the volume
    assert caught.value.exit_code == 3
