"""Which case a group takes next: the nearest one that is left, and lines of many cases, of thousands as of few."""

from __future__ import annotations

import numpy as np
import pytest

from hpcinv.studies.sweep.case_lines import CaseLines
from hpcinv.studies.sweep.nearest_case import NearestCase

LEAST = 5


def on_lines_with(numbers: np.ndarray, case: int) -> set[frozenset[int]]:
    """All lines through a case with many others, found one by one."""
    scaled = numbers / np.where(np.ptp(numbers, axis=0) > 0, np.ptp(numbers, axis=0), 1.0)
    lines: set[frozenset[int]] = set()
    for other in range(len(numbers)):
        way = scaled[other] - scaled[case]
        if other != case and (length := np.linalg.norm(way)) > 0:
            offsets = scaled - scaled[case]
            beside = offsets - np.outer(offsets @ way, way) / length**2
            line = frozenset(np.flatnonzero(np.linalg.norm(beside, axis=1) < 1e-8).tolist())
            lines |= {line} if len(line) >= LEAST else set()
    return lines


def grid(*axes: list[float]) -> np.ndarray:
    return np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], axis=1)


@pytest.mark.parametrize(
    "numbers",
    [
        grid([1e3, 2e3, 5e3, 7e3, 8e3, 20e3], [0.3, 0.35, 0.4, 0.41, 0.45]),
        grid([0.0, 1.0, 2.5, 3.0, 7.0], [1.0, 2.0], [10.0, 20.0, 35.0, 36.0, 99.0]),
        np.stack([np.linspace(1e3, 2e3, 9), np.linspace(0.45, 0.3, 9), np.full(9, 4.0)], axis=1),
    ],
    ids=["two axes", "three axes, one of them short", "axes that run together"],
)
def test_lines_of_a_plan_agree_with_a_search_among_all_pairs(numbers: np.ndarray) -> None:
    lines = CaseLines(numbers, LEAST)
    for case in range(len(numbers)):
        found = {frozenset(line.tolist()) for line in lines.through(case)}
        assert found == on_lines_with(numbers, case)
        assert all(np.all(np.diff(line) > 0) for line in lines.through(case))


def test_the_axes_of_a_regular_grid_are_among_its_many_lines() -> None:
    numbers = grid(np.linspace(0, 1, 10).tolist(), np.linspace(3, 4, 10).tolist())
    found = {frozenset(line.tolist()) for line in CaseLines(numbers, LEAST).through(34)}
    assert {frozenset(range(30, 40)), frozenset(range(4, 100, 10))} <= found <= on_lines_with(numbers, 34)


@pytest.mark.parametrize("shape", [(300, 3), (4, 2), (40, 0)])
def test_drawn_and_few_and_equal_cases_have_no_lines(shape: tuple[int, int]) -> None:
    lines = CaseLines(np.random.default_rng(3).uniform(size=shape), LEAST)
    assert not [*lines.through(0), *lines.through(shape[0] - 1)]


@pytest.mark.parametrize("dimensions", [0, 1, 3])
def test_the_nearest_case_is_found_until_none_is_left(dimensions: int) -> None:
    """Cases leave one by one; some come back, as the ones of a process that has died."""
    random = np.random.default_rng(8)
    points = random.uniform(size=(400, dimensions))
    search, eligible, point = NearestCase(points), np.ones(400, dtype=bool), points[7]
    eligible[random.choice(400, 50, replace=False)] = False
    for step in range(450):
        found = search.among(eligible, point)
        if found is None:
            break
        distances = np.where(eligible, np.linalg.norm(points - point, axis=1), np.inf)
        assert distances[found] == pytest.approx(distances.min(), abs=1e-12)
        eligible[found], point = False, points[found]
        if step == 200:
            eligible[random.choice(400, 90, replace=False)] = True
    assert found is None
    assert step > 350
