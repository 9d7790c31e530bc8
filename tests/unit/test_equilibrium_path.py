"""The engine of load paths, by a policy of a few lines: reports, effort, returns, and continued paths."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from helpers.small_systems import SmallSystem

from hpcinv.model.outcome import Outcome
from hpcinv.solver.equilibrium_path import EquilibriumPath, Policy, Solves


def cubic() -> SmallSystem:
    """``λ = x + x³``."""
    return SmallSystem(1, lambda x, load: x + x**3 - load, lambda x: np.array([[1 + 3 * x[0] ** 2]]))


@dataclass
class Pauses(Policy):
    """A path through given loads."""

    loads: tuple[float, ...]

    def solves(self, path: EquilibriumPath) -> Solves:
        path.begin()
        for load in self.loads:
            if load > path.load:
                yield path.report(path.solve(load, 1e-10), "pauses")


def test_a_policy_is_where_to_go_next() -> None:
    system = cubic()
    path = EquilibriumPath(system.equilibrium(), 1e-12)
    solves = list(path.follow(Pauses((0.25, 0.5, 1.0))))
    assert [(solve.load, solve.strategy) for solve in solves] == [(load, "pauses") for load in (0.25, 0.5, 1.0)]
    assert path.load == 1.0
    assert path.last == solves[-1]
    assert system.x.array[0] + system.x.array[0] ** 3 == pytest.approx(1.0, rel=1e-12)


def test_a_path_goes_on_where_another_has_come() -> None:
    system = cubic()
    list(EquilibriumPath(system.equilibrium(), 1e-12).follow(Pauses((0.5,))))
    resumed = EquilibriumPath(system.equilibrium(), 1e-12, load=0.5)
    assert [solve.load for solve in resumed.follow(Pauses((0.5, 1.0)))] == [1.0]


def test_a_path_ends_after_too_many_factorizations() -> None:
    path = EquilibriumPath(cubic().equilibrium(), 1e-12)
    first, last = path.follow(Pauses((0.25, 0.5, 1.0)), effort=0)
    assert first.outcome.accepted
    assert (last.outcome, last.load) == (Outcome.STEP_LIMIT, 0.25)
    assert path.last == last
    assert path.load == 0.25


def test_a_report_has_all_factorizations_since_the_last_one() -> None:
    path = EquilibriumPath(cubic().equilibrium(), 1e-12)
    path.spent = 3
    solve = path.solve(1.0, 1e-10)
    assert path.report(solve).factorizations == solve.factorizations + 3
    assert path.spent == 0


def test_a_path_returns_to_an_earlier_state() -> None:
    system = cubic()
    path = EquilibriumPath(system.equilibrium(), 1e-12)
    place = path.place()
    assert path.solve(1.0, 1e-10).outcome.accepted
    path.return_to(place)
    assert (system.x.array[0], system.load, path.load) == (0.0, 0.0, 0.0)


def test_no_step_crosses_the_end_of_a_load_case() -> None:
    path = EquilibriumPath(cubic().equilibrium(), 1e-12, cases=2, load=0.4)
    assert [path.target(step) for step in (0.05, 0.1, 1.0)] == [pytest.approx(0.45), 0.5, 0.5]
