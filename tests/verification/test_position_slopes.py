"""Slopes of quantities of positions along many changes at once, next to slopes of any quantity."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.verification import box, job

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.job.sensitivities import Parameter
from hpcinv.solver.equations import Equations
from hpcinv.trust.intervals.position_slopes import is_of_positions, position_slopes
from hpcinv.trust.sensitivity.slopes import Change, slopes

SMOOTH: list[dict[str, Any]] = [
    {"name": "point", "of": "X**2 / (1 m) + uy", "at": [0.3, 0.4, 0.9]},
    {"name": "mean", "of": "Z * x", "on": "z1", "reduce": "mean"},
    {"name": "rms", "of": "norm(ux, uy, uz)", "on": "z1", "reduce": "rms"},
]
OTHERS: list[dict[str, Any]] = [
    {"name": "largest", "of": "Z", "on": "z1", "reduce": "max"},
    {"name": "stress", "of": "szz", "on": "z1", "reduce": "mean"},
    {"name": "kinked", "of": "abs(ux)", "on": "z1", "reduce": "mean"},
    {"name": "area", "of": "1 + 0*Z/(1 m)", "on": "z1", "reduce": "integral", "over": "reference"},
]


@pytest.mark.parallel([2, 1])
def test_slopes_of_positions_are_those_of_all_quantities(comm: MPI.Intracomm) -> None:
    posed = job(
        analysis="inverse",
        mesh=box((1, 1, 1)),
        material={"law": "neo-hookean", "mu": 1.0, "lam": 2.0},
        discretisation={"displacement": 1},
        effects=[{"effect": "gravity", "acceleration": [0.1, 0, -0.2], "density": 1.0}],
        supports=[{"region": "z0", "fix": ["x", "y", "z"]}],
        quantities=SMOOTH + OTHERS,
    )
    result = hpcinv.run(posed, comm)
    assert [q.name for q in posed.quantities if is_of_positions(q)] == ["point", "mean", "rms"]
    equations, solution = Equations(posed, result.body, Timings()), result.solutions[0]
    rate = solution.displacement.copy()
    rate.interpolate(lambda x: np.stack([x[2], 0.3 * x[0] * x[2], -x[2]]))
    unchanged = equations.weak_form("inverse").parameters.direction({})
    nodes = equations.unknowns.geometry_values(rate)
    change = Change(unchanged, rate, nodes, None)
    expected = slopes(equations, solution, [(Parameter("k", "k", None, (), 0.0, None), change)])
    for quantity in filter(is_of_positions, posed.quantities):
        (slope,) = position_slopes(quantity, result.body, solution, [(rate, nodes)])
        assert slope == pytest.approx(expected[quantity.name]["k"], rel=1e-8)
        assert slope != 0.0
    equations.destroy()
