"""Spheres under pressure before and beyond their largest, and other roots of their equilibrium."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.closed_forms import LAM, MU, NEO_HOOKEAN, root
from helpers.paths import INNER, OCTANT, OUTER, SPHERE
from helpers.verification import job

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import SolveError
from hpcinv.output.result import Result

# A thick balloon, incompressible: its pressure has a maximum.


def pressure(a: float) -> float:
    """Of a neo-Hookean balloon (μ = 1 Pa) with the undeformed radii, inflated to the inner radius ``a``."""

    def g(stretch: float) -> float:
        return 0.5 * (4 / stretch + stretch**-4)

    return g((OUTER**3 - INNER**3 + a**3) ** (1 / 3) / OUTER) - g(a / INNER)


A_LIMIT = root(lambda a: pressure(a + 1e-5) - pressure(a - 1e-5), 1.2, 2.5)


def balloon(comm: MPI.Intracomm, share: float, *, hexahedra: bool, **solver: Any) -> Result:
    return hpcinv.run(
        job(
            analysis="forward",
            mesh=SPHERE | {"parameters": SPHERE["parameters"] | {"hexahedra": hexahedra}},
            material={"law": "mooney-rivlin", "c1": 0.5, "c2": 0.0, "d1": "incompressible"},
            effects=[{"effect": "pressure", "region": "inner", "pressure": share * pressure(A_LIMIT)}],
            supports=OCTANT,
            solver={"strategy": "arc-length"} | solver,
            quantities=[{"name": "radius", "of": "norm(x, y, z)", "on": "inner", "reduce": "mean"}],
        ),
        comm,
    )


@pytest.mark.everyday("hexes before")
@pytest.mark.parametrize(
    ("hexahedra", "limit_points", "radius_within", "limit_within"),
    [(True, 0, 1e-3, 0.0), (True, 1, 1e-3, 3e-4), (False, 1, 8e-3, 3e-3)],
    ids=["hexes before", "hexes beyond", "tets beyond"],
)
def test_balloon_before_and_beyond_its_largest_pressure(
    hexahedra: bool, limit_points: int, radius_within: float, limit_within: float, comm: MPI.Intracomm
) -> None:
    low, high = (A_LIMIT, 6.0) if limit_points else (1.0, A_LIMIT)
    a = root(lambda a: pressure(a) - 0.9 * pressure(A_LIMIT), low, high)
    result = balloon(comm, 0.9, hexahedra=hexahedra, limit_points=limit_points)
    value = result.quantities["radius"]
    print(f"{limit_points} limit points: inner radius {value:.6f}, closed form {a:.6f}")
    assert value == pytest.approx(a, rel=radius_within)
    turned = [solve.load for solve in result.solutions[0].solves if solve.limit_point]
    assert len(turned) == limit_points
    for load in turned:
        print(f"largest pressure: {0.9 * load:.6f} of the closed form's")
        assert 0.9 * load == pytest.approx(1.0, abs=limit_within)


# A thick sphere that softens: two cavities at rest lead to the one that is seen.

C1, C2 = 1.0, -0.25
SOFTENING = {"law": "mooney-rivlin", "c1": C1, "c2": C2, "d1": "incompressible"}


def soft_pressure(A: float) -> float:
    """That made the sphere as large as it is seen, from the inner radius ``A`` at rest."""

    def g(stretch: float) -> float:
        return C1 * (4 / stretch + stretch**-4) + C2 * (2 / stretch**2 - 4 * stretch)

    return g(OUTER / (OUTER**3 - INNER**3 + A**3) ** (1 / 3)) - g(INNER / A)


A_SOFT_LIMIT = root(lambda A: soft_pressure(A + 1e-5) - soft_pressure(A - 1e-5), 0.3, 0.9)
SOFT_LIMIT = soft_pressure(A_SOFT_LIMIT)  # 1.0540177 Pa, at 0.5290292
ELLIPTIC_FROM = (-C2 / C1) ** 0.5  # inner radius at rest, 0.5: below it c1 + c2 λ² < 0 at the inner wall


def soft_sphere(comm: MPI.Intracomm, n: int, p: float, *, hexahedra: bool, **solver: Any) -> Result:
    parameters = {"radial": n, "along": n, "hexahedra": hexahedra}
    return hpcinv.run(
        job(
            mesh=SPHERE | {"parameters": SPHERE["parameters"] | parameters},
            material=SOFTENING,
            effects=[{"effect": "pressure", "region": "inner", "pressure": p}],
            supports=OCTANT,
            solver={"strategy": "arc-length"} | solver,
            quantities=[
                {"name": name, "of": "norm(X, Y, Z)", "on": "inner", "reduce": reduce}
                for name, reduce in (("radius", "mean"), ("least", "min"), ("largest", "max"))
            ],
        ),
        comm,
    )


def out_of_round(sphere: Result) -> float:
    """How much the inner radii at rest differ, relative to their mean."""
    quantities = sphere.quantities
    return (quantities["largest"] - quantities["least"]) / quantities["radius"]


@pytest.mark.everyday("hexes")
@pytest.mark.parametrize(
    ("hexahedra", "radius_within", "limit_within"), [(False, 3e-4, 0.015), (True, 5e-5, 0.02)], ids=["tets", "hexes"]
)
def test_first_root_and_largest_pressure_of_a_sphere_that_softens(
    hexahedra: bool, radius_within: float, limit_within: float, comm: MPI.Intracomm
) -> None:
    """The limit is approached from above on hexahedra and from below on tetrahedra, two cells being few."""
    first = root(lambda A: soft_pressure(A) - 0.3, A_SOFT_LIMIT, 1.0)
    A = soft_sphere(comm, 2, 0.3, hexahedra=hexahedra).quantities["radius"]
    print(f"inner radius at rest {A:.7f}, closed form {first:.7f}")
    assert pytest.approx(first, rel=radius_within) == A
    with pytest.raises(SolveError, match=r"the load reaches its maximum on this path \(limit point\)") as caught:
        soft_sphere(comm, 2, 1.2, hexahedra=hexahedra)
    assert "limit_points: 1" not in str(caught.value)  # beyond one limit point the load only falls
    reached = 1.2 * float(str(caught.value).split("load factor ")[1].split(" of")[0])
    print(f"largest pressure {reached:.5f} Pa, closed form {SOFT_LIMIT:.7f}")
    assert reached == pytest.approx(SOFT_LIMIT, rel=limit_within)


@pytest.mark.release
def test_second_root_of_a_sphere_that_softens_where_it_is_elliptic(comm: MPI.Intracomm) -> None:
    """Compared at the same share of the largest pressure: next to it, its own error decides on the radius.

    At lower pressures, such as 1.058 Pa, steps meet a path of wrinkles, whose pressure has a minimum above.
    """
    p = 1.0595
    result = soft_sphere(comm, 3, p, hexahedra=True, limit_points=1)
    (limit,) = (p * solve.load for solve in result.solutions[0].solves if solve.limit_point)
    second = root(lambda A: soft_pressure(A) - p / limit * SOFT_LIMIT, ELLIPTIC_FROM, A_SOFT_LIMIT)
    A = result.quantities["radius"]
    print(f"largest pressure {limit:.5f} Pa, closed form {SOFT_LIMIT:.5f}")
    print(
        f"at {p / limit:.5f} of it: radius {A:.5f}, closed form {second:.5f},"
        f" out of round by {out_of_round(result):.4f}"
    )
    assert limit == pytest.approx(SOFT_LIMIT, rel=0.01)
    assert pytest.approx(second, rel=0.03) == A
    assert A < A_SOFT_LIMIT  # the first root is larger
    assert out_of_round(result) < 0.02


@pytest.mark.release
def test_wrinkles_are_not_taken_for_the_second_root(comm: MPI.Intracomm) -> None:
    """On coarse tetrahedra the path is lost just beyond the limit, at 1.0445 Pa."""
    result, said = None, ""
    try:
        result = soft_sphere(comm, 2, 1.04, hexahedra=False, limit_points=1)
    except SolveError as error:
        said = str(error)
    if result is None:
        assert "beyond the first solution at full load, no other was reached" in said
    else:
        assert out_of_round(result) < 0.05


@pytest.mark.release
def test_an_unreachable_second_solution_is_reported_with_valid_advice(comm: MPI.Intracomm) -> None:
    """Beyond a radius of 0.5 the equations are not elliptic; a coarse mesh does not come to the second root there."""
    with pytest.raises(SolveError, match="beyond the first solution at full load, no other was reached") as caught:
        soft_sphere(comm, 2, 0.3, hexahedra=True, limit_points=1)
    assert "lower the load" not in str(caught.value).lower()
    assert "'limit_points: 0'" in str(caught.value)


# A thick sphere, compressible: how large was it, before a pressure made it as large as the balloon?


def radius_before(p: float, steps: int = 50) -> float:
    """Inner radius at rest of the neo-Hookean sphere that now has the radii `INNER` and `OUTER`.

    ``dσ_r/dr = 2 (σ_θ - σ_r)/r``, ``dR/dr = 1/λ_r``, ``λ_θ = r/R``, ``σ_r(INNER) = -p``, ``σ_r(OUTER) = 0``: by
    shooting with Runge and Kutta's method.
    """

    def slope(r: float, y: np.ndarray) -> np.ndarray:
        R, radial = y
        hoop = r / R

        def stress(stretch: float) -> float:
            J = stretch * hoop**2
            return float((MU * (stretch**2 - 1) + LAM * np.log(J)) / J)

        along = root(lambda stretch: stress(stretch) - radial, 0.05, 3.0)
        J = along * hoop**2
        return np.array([1 / along, 2 * MU * (hoop**2 - along**2) / (J * r)])

    def outside(A: float) -> float:
        y, h = np.array([A, -p]), (OUTER - INNER) / steps
        for r in INNER + np.arange(steps) * h:
            a = slope(r, y)
            b = slope(r + h / 2, y + h / 2 * a)
            c = slope(r + h / 2, y + h / 2 * b)
            y = y + h / 6 * (a + 2 * b + 2 * c + slope(r + h, y + h * c))
        return float(y[1])

    low, high = 0.5, 1.0
    for _ in range(24):  # to 1e-7
        middle = (low + high) / 2
        low, high = (low, middle) if outside(middle) < 0 else (middle, high)
    return low


@pytest.mark.release
def test_a_compressible_sphere_at_rest(comm: MPI.Intracomm) -> None:
    p = 0.5 * MU
    result = hpcinv.run(
        job(
            mesh=SPHERE | {"parameters": SPHERE["parameters"] | {"radial": 3, "along": 3}},
            material=NEO_HOOKEAN,
            effects=[{"effect": "pressure", "region": "inner", "pressure": p}],
            supports=OCTANT,
            solver={"strategy": "arc-length", "initial_step": 0.3},
            quantities=[{"name": "radius", "of": "norm(X, Y, Z)", "on": "inner", "reduce": "mean"}],
        ),
        comm,
    )
    A = radius_before(p)
    print(f"inner radius at rest {result.quantities['radius']:.6f}, by quadrature {A:.6f}")
    assert result.quantities["radius"] == pytest.approx(A, rel=1e-4)
    assert len(result.solutions[0].solves) > 2
