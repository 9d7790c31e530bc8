"""Bodies of fewer cells than there are ranks."""

from __future__ import annotations

import pytest
from helpers.verification import box, job

import hpcinv
from hpcinv.base.parallel.runtime import MPI


@pytest.mark.parallel([1, 2, 3])
def test_one_incompressible_cell_doubles_its_length_and_goes_back(comm: MPI.Intracomm) -> None:
    """Under a dead pull ``P = mu (s - 1/s²)`` neo-Hookean material has the stretch s: 17.5 kPa for s = 2."""
    pull = {"effect": "traction", "region": "x1", "traction": ["17.5 kPa", 0, 0], "area_in": "reference"}
    forward = job(
        analysis="forward",
        mesh=box((1, 1, 1), hexahedra=True),
        material={"law": "isochoric-neo-hookean", "mu": "10 kPa", "kappa": "incompressible"},
        effects=[pull],
        supports=[{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"],
        quantities=[{"name": "corner", "of": "displacement", "at": [1, 1, 1]}],
        certificate={"level": "quick", "round_trip": "path"},
    )
    result = hpcinv.run(forward, comm, progress=False)
    assert result.quantities["corner"] == pytest.approx([1.0, 0.5**0.5 - 1, 0.5**0.5 - 1], abs=1e-10)
    [back] = [line.value for line in result.certificate.lines if line.name.startswith("round trip")]
    assert back == pytest.approx(0.0, abs=1e-9)
