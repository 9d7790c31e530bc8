"""Springs hold a body without supports: the key may be left out, and what then holds nothing is refused."""

from __future__ import annotations

from typing import Any

import pytest
from helpers.verification import box, job

from hpcinv import run
from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import JobError, MeshError

BLOCK: dict[str, Any] = {
    "analysis": "forward",
    "mesh": box((2, 2, 2)),
    "material": {"law": "neo-hookean", "mu": "10 kPa", "lam": "40 kPa"},
    "discretisation": {"displacement": 1},
}
WEIGHT = {"effect": "gravity", "acceleration": [0, 0, -10], "density": 100}


def springs(**stiffness: Any) -> dict[str, Any]:
    return {"effect": "elastic-foundation", "region": "z0", **stiffness}


def test_a_foundation_alone_holds_the_body(comm: MPI.Intracomm) -> None:
    result = run(job(**BLOCK, effects=[WEIGHT, springs(normal="100 kPa/m", tangential="100 kPa/m")]), comm)
    sunk = -result.solutions[0].u[:, 2][result.solutions[0].reference_nodes[:, 2] < 1e-9].mean()
    assert sunk == pytest.approx(1000 / 100e3, rel=0.1)  # weight per area over stiffness, but for what it bends


def test_springs_that_leave_a_motion_free_do_not(comm: MPI.Intracomm) -> None:
    with pytest.raises(MeshError, match="leave the body free to move"):
        run(job(**BLOCK, effects=[WEIGHT, springs(normal="100 kPa/m")]), comm)


def test_without_springs_supports_are_needed() -> None:
    with pytest.raises(JobError, match="supports: leave the body free to move along x and y and z"):
        job(**BLOCK, effects=[WEIGHT])
