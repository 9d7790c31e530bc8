"""Quadrature rules over cells: symmetric, exact to their degree, with positive weights, and few points."""

import math
from itertools import permutations, product

import numpy as np
import pytest

from hpcinv.mesh.cells import quadrature

DEGREES = range(1, 21)  # all that a job may ask for
# Of the symmetric rules of Witherden & Vincent (2015), doi:10.1016/j.camwa.2015.03.017, table 3.
POINTS = {1: 1, 2: 4, 3: 8, 5: 14, 6: 24, 7: 35, 8: 46, 9: 59, 10: 81}


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
            total = weights @ (points[:, 0] ** a * points[:, 1] ** b * points[:, 2] ** c)
            assert total == pytest.approx(integral(kind, a, b, c), rel=1e-13)


@pytest.mark.parametrize("kind", ["tetrahedron", "triangle"])
@pytest.mark.parametrize("degree", DEGREES)
def test_points_and_weights_do_not_depend_on_the_order_of_the_vertices(kind: str, degree: int) -> None:
    points, weights = quadrature(kind, degree)
    barycentric = np.column_stack([1 - points.sum(axis=1), points])
    for order in permutations(range(barycentric.shape[1])):
        distance = np.linalg.norm(barycentric[:, None, list(order)] - barycentric[None], axis=2)
        assert distance.min(axis=1).max() < 3e-15
        assert np.abs(weights[distance.argmin(axis=1)] - weights).max() < 1e-15


@pytest.mark.parametrize("degree", POINTS)
def test_tetrahedra_have_no_more_points_than_the_best_known_symmetric_rules(degree: int) -> None:
    assert len(quadrature("tetrahedron", degree)[1]) <= POINTS[degree]
