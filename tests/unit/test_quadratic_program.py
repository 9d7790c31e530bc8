"""Convex quadratic programs against their conditions of optimality."""

import numpy as np
import pytest

from hpcinv.trust.intervals.quadratic_program import solve_quadratic


@pytest.mark.parametrize("seed", range(6))
def test_the_solution_is_optimal(seed: int) -> None:
    """The gradient is a sum of active rows with factors from 0 on, and of equations; found by nonnegative squares."""
    from scipy.optimize import nnls

    random = np.random.default_rng(seed)
    n, m, k = 12, 30, 2
    root = random.normal(size=(n, n - seed % 3))  # singular for some
    H, g = root @ root.T + (1e-6 * np.eye(n)), random.normal(size=n)
    inside, A, E = random.normal(size=n), random.normal(size=(m, n)), random.normal(size=(k, n))
    b = A @ inside + random.uniform(0, 1, m)
    E = np.vstack([E, E.sum(axis=0)])  # one of them depends on the others
    z = solve_quadratic(H, g, (A, b), (E, E @ inside))
    assert z is not None
    assert (A @ z - b).max() < 1e-6
    assert np.abs(E @ (z - inside)).max() < 1e-8
    active = A[A @ z - b > -1e-4]
    rows = np.vstack([active, E, -E])
    _, left = nnls(rows.T, -(H @ z + g))
    assert left < 1e-3 * np.abs(g).max()


def test_contradicting_inequalities_have_no_solution() -> None:
    A, b = np.array([[1.0], [-1.0]]), np.array([-1.0, -1.0])
    assert solve_quadratic(np.eye(1), np.zeros(1), (A, b), (np.zeros((0, 1)), np.zeros(0))) is None
