"""An elastic layer in the way of the undeformed body grows with the load: small steps then begin in equilibrium."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.verification import box, job

import hpcinv
from hpcinv.base.parallel.runtime import MPI

LAYER: dict[str, Any] = {
    "effect": "contact",
    "region": "y1",
    "obstacle": {"shape": "sphere", "centre": [0.07, 0.10, 0.02], "radius": 0.05},
    "stiffness": "60 kPa/m",
    "stand_off": "2 mm",
}
BLOCK: dict[str, Any] = {
    "mesh": {**box((2, 1, 1), lx=0.1, ly=0.06, lz=0.05, hexahedra=True), "geometry_degree": 2},
    "material": {"law": "fung-demiray", "mu": "3 kPa", "b": 2, "kappa": "9 kPa"},
    "effects": [LAYER, {"effect": "gravity", "acceleration": [0, 1, 1], "density": 500}],
    "supports": [{"region": "x0", "fix": ["x", "y", "z"]}],
    "discretisation": {"displacement": 2, "formulation": "displacement"},
}


@pytest.mark.everyday("arc-length")
@pytest.mark.parallel([2, 1])
@pytest.mark.parametrize("strategy", ["adaptive", "arc-length"])
def test_a_body_that_the_inverse_found_is_loaded_again(strategy: str, comm: MPI.Intracomm) -> None:
    """Without a rescue: at load 0 the layer would press with half a newton on a body of three newtons' stiffness."""
    solver = {"strategy": strategy, "rescue": []}
    result = hpcinv.run(job(**BLOCK, analysis="round_trip", first="inverse", solver=solver), comm)
    there, back = result.solutions
    size = there.largest_displacement
    print(f"{back.factorizations} factorizations, largest displacement {size:.4f} m, {result.errors['round_trip']}")
    assert size > 0.03
    assert result.errors["round_trip"]["max"] < 1e-11 * size
    assert {solve.strategy for solve in back.solves} == {"load steps" if strategy == "adaptive" else strategy}


def test_intermediate_loads_leave_nothing_behind(comm: MPI.Intracomm) -> None:
    """A solve in one step, from a state near the solution, finds the same as one along the path."""
    single_step, many = (
        hpcinv.run(job(**BLOCK, analysis="forward", solver={"initial_step": step}, certificate="quick"), comm)
        for step in (1.0, 0.25)
    )
    assert len(many.solutions[0].solves) > 2
    assert np.abs(single_step.solutions[0].u - many.solutions[0].u).max() < 1e-10
    lines = {line.name: line.value for line in many.certificate.lines}
    assert lines["equilibrium residual, relative to the load"] < 1e-10
