"""Predictions from neighbours: polynomials exactly, other fields with the order of moving least squares; distances."""

from __future__ import annotations

import numpy as np
import pytest

from hpcinv.solver.methods.method import Guess
from hpcinv.studies.sweep.neighbours import Neighbour, Neighbours, ParameterSpace


def known(points: np.ndarray, field: object, signs: list[int] | None = None) -> Neighbours:
    neighbours = Neighbours()
    for i, point in enumerate(points):
        values = Guess(field(point), field(point)[:1], signs[i] if signs else 1)  # type: ignore[operator]
        neighbours.add(Neighbour(str(i), point, values), largest=16)
    return neighbours


def quadratic(p: np.ndarray) -> np.ndarray:
    return np.array([1 + 2 * p[0] - p[1] + 3 * p[0] * p[1] - p[1] ** 2, p[0] ** 2 - 5])


def test_polynomials_are_continued_exactly() -> None:
    points = np.random.default_rng(1).random((16, 2))
    guess, _ = known(points[:15], quadratic).guess(points[15]) or pytest.fail("nothing is known")
    assert guess.displacement == pytest.approx(quadratic(points[15]), rel=1e-9)
    assert guess.pressure == pytest.approx(quadratic(points[15])[:1], rel=1e-9)


def test_the_error_falls_with_the_cube_of_the_distance() -> None:
    def smooth(p: np.ndarray) -> np.ndarray:
        return np.array([np.exp(p[0] - p[1]), np.sin(3 * p[1])])

    offsets = np.random.default_rng(2).uniform(-1, 1, (30, 2))
    errors = []
    for h in (0.1, 0.05, 0.025):
        guess, _ = known(h * offsets, smooth).guess(np.zeros(2)) or pytest.fail("nothing is known")
        errors.append(np.abs(guess.displacement - smooth(np.zeros(2))).max())
    orders = np.log2(errors[:-1] / np.array(errors[1:]))
    assert orders.min() > 2.7


def test_few_neighbours_give_the_nearest() -> None:
    points = np.array([[0.1, 0.0], [0.9, 0.0]])
    guess, key = known(points, quadratic).guess(np.zeros(2)) or pytest.fail("nothing is known")
    assert key == "0"
    assert np.array_equal(guess.displacement, quadratic(points[0]))
    assert Neighbours().guess(np.zeros(2)) is None


def test_neighbours_on_a_line_predict_nothing_off_the_line() -> None:
    line = np.stack([np.linspace(0, 1, 12), np.zeros(12)], axis=1)
    guess, key = known(line, quadratic).guess(np.array([0.5, 0.8])) or pytest.fail("nothing is known")
    assert np.array_equal(guess.displacement, quadratic(line[int(key)]))


def test_solutions_beyond_a_branching_point_are_left_out() -> None:
    points = np.random.default_rng(3).random((20, 1)) + np.repeat([[0.0], [2.0]], 10, axis=0)
    guess, _ = known(points, lambda p: np.sign(p - 1.5), [1] * 10 + [-1] * 10).guess(np.array([1.2])) or pytest.fail(
        "nothing is known"
    )
    assert guess.sign == 1
    assert guess.displacement == pytest.approx([-1.0])


def test_memory_is_bounded() -> None:
    neighbours = Neighbours()
    for i in range(10):
        neighbours.add(Neighbour(str(i), np.array([i / 10]), Guess(np.zeros(2), None)), largest=100_000_000)
        assert len(neighbours) <= 2
    _, key = neighbours.guess(np.array([1.0])) or pytest.fail("nothing is known")
    assert key == "9"


def test_distances_know_logarithms_and_ranges() -> None:
    space = ParameterSpace([(1e3, 5.0, 2.0), (1e5, 5.0, 3.0), (1e4, 5.0, 2.5)])
    assert space.point((1e4, 5.0, 2.5)) == pytest.approx([0.5, 0.5])
    assert space.point((1e3, 5.0, 3.0)) == pytest.approx([0.0, 1.0])
    negative = ParameterSpace([(-1e3,), (-1e5,)])
    assert abs(negative.point((-1e4,)) - 0.5) < 1e-12
    assert ParameterSpace([(1.0, 2.0)]).point((1.0, 2.0)).shape == (0,)
