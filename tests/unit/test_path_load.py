"""The load factor of a path as a constraint among others."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import pytest
from helpers.small_systems import SmallSystem

from hpcinv.mesh.source import Floats
from hpcinv.model.constraint_report import ConstraintReport
from hpcinv.solver.border import Border, kinds_of_borders
from hpcinv.solver.bordered_solver import BorderedSolver
from hpcinv.solver.constraints.path_load import PathLoad


class TwiceTheLoad(Border):
    """``q = 2 λ``, which a spring feels: ``x = q + λ``."""

    count, order = 1, 9

    def __init__(self) -> None:
        self.number = 0.0

    @classmethod
    def of_job(cls, job: Any, equations: Any, system: Any) -> Iterable[Border]:
        return []

    def reports(self, load: float) -> Sequence[ConstraintReport]:
        return []

    def put(self, load: float) -> None:
        """Nothing is left to do: the spring has the number."""

    def kept_numbers(self) -> float:
        return self.number

    def restore(self, numbers: float) -> None:
        self.number = numbers

    def change(self, change: Floats) -> None:
        self.number += float(change[0])

    def recover(self, load: float) -> None:
        self.number = 2 * load

    def equations(self, load: float) -> Floats:
        return np.array([self.number - 2 * load])

    def set_columns(self, columns: Any, r: Any, load: float) -> None:
        columns[0].set(-1.0)

    def linearise(self, load: float) -> Floats:
        return np.ones((1, 1))

    def slopes(self, direction: Any) -> Floats:
        return np.zeros(1)


def test_load_factor_of_a_path_is_the_last_registered_constraint() -> None:
    assert PathLoad in kinds_of_borders()


def test_other_constraints_follow_the_load_of_a_path() -> None:
    border = TwiceTheLoad()
    system = SmallSystem(1, lambda x, load: np.array([x[0] - border.number - load]), lambda _: np.eye(1))
    equilibrium = system.equilibrium()
    others = BorderedSolver(equilibrium.system, equilibrium.linear, [border])
    plane = PathLoad(equilibrium.system, others, cases=1)
    numbers = BorderedSolver(equilibrium.system, equilibrium.linear, [border, plane])
    assert numbers.linearise(0.0)
    assert numbers.path().array == pytest.approx([3.0])
    numbers.change(np.array([1.0, 0.5]))
    assert (numbers.load_of(0.0), numbers.equations(0.5).tolist()) == (0.5, [0.0, 0.0])
    assert numbers.size(np.array([1.0, 0.5])) == 0.5
    for solver in (numbers, others):
        solver.destroy()
