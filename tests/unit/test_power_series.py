"""Ranges and Padé approximants of a power series with a known sum."""

from __future__ import annotations

import numpy as np
import pytest

from hpcinv.base.parallel.runtime import MPI
from hpcinv.solver.power_series import Coefficients, PowerSeries

ORDERS = 12
POLES = np.concatenate([np.linspace(2.0, 7.0, 40), -np.linspace(3.0, 8.0, 40)])  # one of each unknown


def states(a: float) -> np.ndarray:
    return 1 / (1 - a / POLES) - 1


def summed(coefficients: np.ndarray, load: float = 0.0) -> PowerSeries:
    """The series of coefficients under the load ``load + a``."""
    rows = Coefficients(ORDERS, coefficients.shape[1], load, 1.0, MPI.COMM_SELF)
    for number, row in enumerate(coefficients):
        rows.add(row, float(number == 0))
    return rows.series()


@pytest.fixture
def series() -> PowerSeries:
    """States `states` under the load ``a``."""
    return summed(np.array([POLES ** -float(k) for k in range(1, ORDERS + 1)]))


def test_polynomials_are_accurate_at_the_end_of_their_range(series: PowerSeries) -> None:
    accuracy = 1e-6
    a = (accuracy * np.linalg.norm(series.factors[0]) / np.linalg.norm(series.factors[-1])) ** (1 / (ORDERS - 1))
    weights = series.weights(a, pade=False)
    assert series.load_at(weights) == pytest.approx(a, rel=1e-12)
    error = np.linalg.norm(weights @ series.states - states(a)) / np.linalg.norm(states(a))
    print(f"polynomials: {error:.1e} at {a:.3f}")
    assert error < 3 * accuracy
    assert series.error(a, pade=False) < accuracy


def test_pade_approximants_reach_farther(series: PowerSeries) -> None:
    a, is_pade = series.range(1e-6)
    polynomial = (1e-6 * np.linalg.norm(series.factors[0]) / np.linalg.norm(series.factors[-1])) ** (1 / (ORDERS - 1))
    assert is_pade
    assert 1.3 * polynomial < a < 2.0
    weights = series.weights(a, pade=True)
    assert series.load_at(weights) == pytest.approx(a, rel=1e-6)
    error = np.linalg.norm(weights @ series.states - states(a)) / np.linalg.norm(states(a))
    print(f"Padé: {error:.1e} at {a:.3f}")
    assert error < 3e-6


def test_straight_path_has_no_end() -> None:
    coefficients = np.zeros((ORDERS, 2))
    coefficients[0] = 1.0, 2.0
    a, is_pade = summed(coefficients).range(1e-6)
    assert (a, is_pade) == (np.inf, False)


def test_bifurcation_is_the_ratio_of_a_progression(series: PowerSeries) -> None:
    assert series.bifurcation() is None
    k = np.arange(1, ORDERS + 1)[:, None]
    mode, smooth = np.eye(len(POLES))[:2]
    coefficients = 100.0**-k * smooth + 1e-14 * 0.8 ** -(k - 1) * mode  # rounding errors along the mode
    a, load = summed(coefficients, 0.1).bifurcation() or (0.0, 0.0)
    assert a == pytest.approx(0.8, rel=1e-9)
    assert load == pytest.approx(0.9, rel=1e-9)


def test_states_at_loads_in_both_directions(series: PowerSeries) -> None:
    for load in (-1.2, -0.5, 0.0, 0.5, 1.0):
        weights, error = series.at_load(load, 1e-6) or pytest.fail("out of range")
        assert series.load_at(weights) == pytest.approx(load, abs=1e-12)
        assert np.linalg.norm(weights @ series.states - states(load)) <= 3e-6 * np.linalg.norm(states(load)) + 1e-14
        assert error <= 1e-6
    assert series.at_load(1.9, 1e-9) is None
    assert series.at_load(-5.0, 1e-6) is None
