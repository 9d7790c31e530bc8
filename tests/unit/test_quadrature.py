"""Quadrature rules over cells: exact to their degree, with positive weights, and few points."""

import math
from itertools import product

import pytest

from hpcinv.mesh.cells import quadrature

DEGREES = range(1, 21)  # all that a job may ask for
DEFAULT_POINTS = {3: 5, 4: 14, 5: 15, 6: 24, 7: 31, 8: 45}  # of Basix's default on tetrahedra


def integral(kind: str, a: int, b: int, c: int) -> float:
    """Return the integral of ``x^a y^b z^c`` over the reference cell."""
    if kind == "hexahedron":
        return 1 / ((a + 1) * (b + 1) * (c + 1))
    return math.factorial(a) * math.factorial(b) * math.factorial(c) / math.factorial(a + b + c + 3)


@pytest.mark.parametrize("kind", ["tetrahedron", "hexahedron"])
@pytest.mark.parametrize("degree", DEGREES)
def test_weights_are_positive_and_polynomials_of_the_degree_are_integrated_exactly(kind: str, degree: int) -> None:
    points, weights = quadrature(kind, degree)
    assert (weights > 0).all()
    assert (points >= 0).all()
    for a, b, c in product(range(degree + 1), repeat=3):
        if a + b + c <= degree:
            found = weights @ (points[:, 0] ** a * points[:, 1] ** b * points[:, 2] ** c)
            assert found == pytest.approx(integral(kind, a, b, c), rel=1e-10)


@pytest.mark.parametrize("degree", DEFAULT_POINTS)
def test_tetrahedra_have_no_more_points_than_by_default_but_for_one_of_degree_3(degree: int) -> None:
    assert len(quadrature("tetrahedron", degree)[1]) <= DEFAULT_POINTS[degree] + (degree == 3)
