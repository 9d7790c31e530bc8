"""Ends of quantities over all contact pressures that a given shape admits."""

from typing import Any

import numpy as np
import pytest

from hpcinv.trust.intervals.admissible_tractions import (
    AdmissibleTractions,
    NoPressure,
    UnboundedEnd,
    settled_end,
)
from hpcinv.trust.intervals.friction_cones import FrictionCones


def near(
    pressures: list[float],
    gaps: list[float],
    compliance: np.ndarray,
    greatest: float = np.inf,
    widest: float = np.inf,
    force: tuple[float, float] | None = None,
) -> AdmissibleTractions:
    forces = [] if force is None else [(np.array([1.0, 3.0]), *force)]
    bounds = np.full(len(pressures), greatest), np.full(len(gaps), widest)
    return AdmissibleTractions(np.array(pressures), np.array(gaps), compliance, *bounds, forces)


def bar(gap: float = 0.5, **known: Any) -> AdmissibleTractions:
    """Two springs of compliance 1 and 2 that press on each other without coupling; without pressure they are apart."""
    return near([0.0, 0.0], [gap, gap], -np.diag([1.0, 2.0]), **known)


def test_pressure_is_between_none_and_where_the_undeformed_bodies_touch() -> None:
    forces = np.array([1.0, 3.0])
    assert bar().end(forces, 1.0) == pytest.approx([0.5, 0.25])
    assert bar().end(forces, -1.0) == pytest.approx([0.0, 0.0])


def test_gaps_at_a_solution_with_pressures_are_those_there() -> None:
    moved = near([0.5, 0.0], [0.0, 0.5], -np.diag([1.0, 2.0]))
    assert moved.end(np.ones(2), 1.0) == pytest.approx([0.5, 0.25])


@pytest.mark.parametrize(
    ("known", "expected"),
    [
        ({"greatest": 0.3}, [0.3, 0.25]),
        ({"force": (0.0, 0.75)}, [0.0, 0.25]),
        ({"force": (0.6, 0.6)}, [0.0, 0.2]),
    ],
)
def test_what_is_known_narrows_the_interval(known: dict[str, Any], expected: list[float]) -> None:
    assert bar(**known).end(np.array([1.0, 100.0]), 1.0) == pytest.approx(expected)


def test_bound_of_the_undeformed_gap_raises_the_lower_end() -> None:
    assert bar(widest=0.1).end(np.ones(2), -1.0) == pytest.approx([0.4, 0.2])


def test_bodies_that_overlap_without_pressure_admit_none() -> None:
    with pytest.raises(NoPressure) as raised:
        bar(gap=-0.04).end(np.ones(2), 1.0)
    assert raised.value.gap == pytest.approx(-0.04)


def test_bounds_that_exclude_all_pressures_are_no_overlap() -> None:
    with pytest.raises(NoPressure) as raised:
        bar(force=(9.0, 10.0)).end(np.ones(2), 1.0)
    assert raised.value.gap == pytest.approx(0.0, abs=1e-12)


def test_quantity_without_bound_is_said_to_have_none() -> None:
    free = near([0.0, 0.0], [0.0, 0.0], np.zeros((2, 2)))
    with pytest.raises(UnboundedEnd):
        free.end(np.array([0.0, 1.0]), 1.0)


def test_end_of_a_curved_quantity_settles_where_the_bodies_touch() -> None:
    """One spring whose gap is ``0.5 - p - p²/2``: it closes at √2 - 1; the quantity is p³ + p."""

    def solve(p: np.ndarray) -> tuple[float, AdmissibleTractions, np.ndarray]:
        here = near(p.tolist(), (0.5 - p - p**2 / 2).tolist(), -np.diag(1 + p))
        return float(p[0] ** 3 + p[0]), here, 3 * p**2 + 1

    value, pressures, has_settled = settled_end(
        solve, lambda here, slopes, reach: here.end(slopes, 1.0, reach), np.zeros(1), 1e-9, 1e-9
    )
    p = 2**0.5 - 1
    assert has_settled
    assert pressures == pytest.approx([p])
    assert value == pytest.approx(p**3 + p)
    least, _, _ = settled_end(
        solve, lambda here, slopes, reach: here.end(slopes, -1.0, reach), np.full(1, 0.3), 1e-9, 1e-9
    )
    assert least == pytest.approx(0.0)


def test_end_settles_where_programs_alternate_between_corners() -> None:
    """The quantity is largest within what is admissible, and each program alone would jump to a corner."""

    def solve(p: np.ndarray) -> tuple[float, AdmissibleTractions, np.ndarray]:
        here = near(p.tolist(), [1.0], np.zeros((1, 1)), greatest=3.0)
        return -float((p[0] - 1.2) ** 2), here, -2 * (p - 1.2)

    value, pressures, has_settled = settled_end(
        solve, lambda here, slopes, reach: here.end(slopes, 1.0, reach), np.zeros(1), 1e-5, 1e-9
    )
    assert has_settled
    assert pressures == pytest.approx([1.2], abs=1e-2)
    assert value == pytest.approx(0.0, abs=1e-4)


def test_bodies_that_overlap_at_an_end_have_not_settled() -> None:
    def solve(p: np.ndarray) -> tuple[float, AdmissibleTractions, np.ndarray]:
        return 0.0, near(p.tolist(), [-0.1], np.zeros((1, 1)), greatest=1.0), np.zeros(1)

    _, _, has_settled = settled_end(solve, lambda *_: np.zeros(1), np.zeros(1), 1e-3, 1e-9)
    assert not has_settled


def wedge(tangent: float, friction: float) -> AdmissibleTractions:
    """A weight of 1 on a wedge whose side has one pressure p and tractions t: ``p tan + t = 1`` per cosine."""
    cone = FrictionCones(friction, np.array([0]), np.array([[1, 2]]))
    balance = np.array([-1.0]), np.array([[tangent, 1.0, 0.0]])
    free = np.full(3, np.inf)
    lowest = np.array([0.0, -np.inf, -np.inf])
    return AdmissibleTractions(
        np.zeros(3), np.zeros(1), np.zeros((1, 3)), free, np.full(1, np.inf), (), lowest, [cone], balance
    )


def test_balance_and_friction_bound_the_pressure_of_a_wedge() -> None:
    force = np.array([1.0, 0.0, 0.0])
    assert wedge(0.5, 0.2).end(force, -1.0)[0] == pytest.approx(1 / 0.7)
    assert wedge(0.5, 0.2).end(force, 1.0)[0] == pytest.approx(1 / 0.3)
    assert not wedge(0.5, 0.2).is_locked


def test_a_wedge_locks_where_friction_exceeds_its_slope() -> None:
    with pytest.raises(UnboundedEnd):
        wedge(0.2, 0.3).end(np.array([1.0, 0.0, 0.0]), 1.0)
    assert wedge(0.2, 0.3).is_locked


def test_too_little_friction_is_said_with_what_would_do() -> None:
    """A side that overhangs: friction alone carries the weight."""
    with pytest.raises(NoPressure) as raised:
        wedge(-0.5, 0.25).end(np.array([1.0, 0.0, 0.0]), 1.0)
    assert raised.value.friction == pytest.approx(2.0, rel=2e-3)
