"""Derivatives by the rigid motion of a support against central differences of whole runs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.verification import box, job

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.keys import assigned
from hpcinv.solver.workspace import Workspace

PLACE = "supports[1].motion"
KEYS = {f"{PLACE}.rotate": 0.3, f"{PLACE}.move[2]": 0.05, f"{PLACE}.about[0]": 0.2}
TWIST = {"rotate": 0.3, "axis": [0, 0, 1], "about": [0.2, 0, 0], "move": [0, 0, 0.05]}
BLOCK: dict[str, Any] = {
    "mesh": box((1, 1, 2)),
    "material": {"law": "neo-hookean", "mu": 1e4, "lam": 4e4},
    "supports": [{"region": "z0", "fix": ["x", "y", "z"]}, {"region": "z1", "motion": TWIST}],
    "quantities": [
        {"name": "middle", "of": "displacement", "at": [0.5, 0.5, 0.5]},
        {"name": "stress", "of": "von_mises", "on": "z1", "reduce": "mean"},
    ],
}


@pytest.mark.everyday("inverse")
@pytest.mark.parametrize("analysis", ["inverse", "forward"])
def test_slopes_by_a_motion_are_differences_of_whole_runs(analysis: str, comm: MPI.Intracomm) -> None:
    with Workspace(comm) as workspace:

        def found(**changes: Any) -> Any:
            return hpcinv.run(job(**BLOCK | {"analysis": analysis} | changes), comm, workspace=workspace)

        sensitivities = found(sensitivities=list(KEYS)).sensitivities
        for key, value in KEYS.items():
            ahead, behind = (found(**assigned(BLOCK, {key: value + shift})).quantities for shift in (1e-4, -1e-4))
            for name in ahead:
                expected = (np.array(ahead[name]) - behind[name]) / 2e-4
                size = np.abs(expected).max()
                assert size > 1e-3
                assert sensitivities.slopes[name][key] == pytest.approx(
                    expected.tolist(), rel=0, abs=1e-5 * size
                )  # differences to second order
