"""Shells through a job: published benchmarks and closed forms, and back to the unloaded surface."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

import hpcinv
from hpcinv.output.result import Result
from tests.helpers.sheets import flat, save_sheet

LINEAR = {"law": "st-venant-kirchhoff", "young": 1.2e6, "poisson": 0.0}
CLAMPED = {"region": "x0", "fix": ["x", "y", "z"]}
CHECKS = {"level": "quick"}


def solve(path: Path, thickness: float, comm: MPI.Intracomm = MPI.COMM_SELF, **data: Any) -> Result:
    job: dict[str, Any] = {"mesh": {"file": str(path), "shell": {"thickness": thickness}}, "certificate": CHECKS} | data
    return hpcinv.run(job, comm, progress=False)


@pytest.mark.parametrize("thickness", [0.1, 0.01])
def test_end_shear_of_a_cantilever_both_ways(tmp_path: Path, thickness: float) -> None:
    """Sze, Liu & Lo 2004, doi:10.1016/j.finel.2003.11.001, §3.1: tip 6.698 and 3.286 for P L²/(E I) = 4."""
    path = save_sheet(tmp_path / "sheet.msh", 16, 1, flat(10, 1))
    traction = [0, 0, 4 * thickness**2 * LINEAR["young"] / 12 / 100]
    result = solve(
        path,
        thickness,
        analysis="round_trip",
        first="forward",
        material=LINEAR,
        effects=[{"effect": "traction", "region": "x1", "traction": traction, "area_in": "reference"}],
        supports=[CLAMPED],
        quantities=[{"name": "tip", "of": "displacement", "at": [10, 0.5, 0]}],
    )
    ux, _, uz = result.quantities["tip"]
    assert uz == pytest.approx(6.698, rel=1e-3)
    assert -ux == pytest.approx(3.286, rel=2e-3)
    assert result.certificate.verdict.value == "pass"
    assert np.abs(result.solutions[1].u - result.solutions[0].u).max() < 1e-9 * 10
